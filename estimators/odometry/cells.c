#include <stdint.h>

/* Sums over cells (rows, columns) of height x width pixels, as by OpenCV in exposure.py: of grey levels, and then of the
   number of those outside low to high. */
void add_up(long rows, long columns, long height, long width, const uint8_t *image, long stride, long low, long high,
            int32_t *sums) {
  const int16_t least = low, most = high;
  const long all = columns * width;
  for (long i = 0; i < rows; i++) {
    uint16_t level[all], outside[all];  /* of a column; 257 rows at most have such a level */
    for (long x = 0; x < all; x++) level[x] = outside[x] = 0;
    for (long y = 0; y < height; y++, image += stride)
      for (long x = 0; x < all; x++) level[x] += image[x], outside[x] += (image[x] < least) | (image[x] > most);
    for (long j = 0; j < columns; j++, sums++) {
      int32_t grey = 0, number = 0;
      for (long x = j * width; x < (j + 1) * width; x++) grey += level[x], number += outside[x];
      sums[0] = grey, sums[rows * columns] = number;
    }
  }
}
