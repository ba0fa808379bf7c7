#include <math.h>
#include <stdint.h>

/* Grey levels of n RGBA pixels plus noise, saturated: bit by bit as by OpenCV, in one pass. */
void noisy_grey(long n, const uint32_t *restrict rgba, const int16_t *restrict noise, uint8_t *restrict grey) {
  for (long k = 0; k < n; k++) {
    const int32_t red = rgba[k] & 255, green = rgba[k] >> 8 & 255, blue = rgba[k] >> 16 & 255;
    const int32_t level = ((9798 * red + 19235 * green + 3735 * blue + (1 << 14)) >> 15) + noise[k];
    grey[k] = level < 0 ? 0 : level > 255 ? 255 : level;
  }
}

/* Levels of n pixels of light, amplified, with noise that grows with it; saturated. Numbers: the gain, and the variance
   in the dark and by level. */
void sensed(long n, const float *restrict number, const float *restrict light, const float *restrict noise,
            uint8_t *restrict grey) {
  for (long k = 0; k < n; k++) {
    const float level = light[k] * number[0];
    const float std = sqrtf(number[1] + number[2] * fminf(fmaxf(level, 0.0f), 255.0f));
    grey[k] = (int)fminf(fmaxf(rintf(level + noise[k] * std), 0.0f), 255.0f);
  }
}
