/* Grey levels of n RGBA pixels plus noise, saturated: bit by bit as by OpenCV, in one pass. */
#include <stdint.h>

void noisy_grey(long n, const uint32_t *restrict rgba, const int16_t *restrict noise, uint8_t *restrict grey) {
  for (long k = 0; k < n; k++) {
    const int32_t red = rgba[k] & 255, green = rgba[k] >> 8 & 255, blue = rgba[k] >> 16 & 255;
    const int32_t level = ((9798 * red + 19235 * green + 3735 * blue + (1 << 14)) >> 15) + noise[k];
    grey[k] = level < 0 ? 0 : level > 255 ? 255 : level;
  }
}
