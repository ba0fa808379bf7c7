/* Pebbles on sand, one after the other: as by NumPy in relief.py. */
#include <stdint.h>

/* Places (n, 4): row and column of the middle, half the size of the shape, and where it begins in shapes and inside.
   Looks (n, 2): albedo and tint. */
void lay(long n, long rows, long columns, const int64_t *place, const float *look, const float *shape,
         const uint8_t *inside, float *height, float *albedo, float *tint) {
  for (long pebble = 0; pebble < n; pebble++, place += 4, look += 2) {
    const long top = place[0] - place[2], left = place[1] - place[2], side = 2 * place[2] + 1;
    for (long i = 0; i < side * side; i++) {
      const long row = top + i / side, column = left + i % side, k = row * columns + column;
      if (row < 0 || row >= rows || column < 0 || column >= columns || !inside[place[3] + i]) continue;
      const float raised = 0.5f * height[k] + shape[place[3] + i];
      if (raised > height[k]) height[k] = raised;
      albedo[k] = look[0], tint[k] = look[1];
    }
  }
}
