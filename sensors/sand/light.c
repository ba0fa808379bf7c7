/* Light on sand in one pass: as by NumPy in field.py. */
#include <math.h>
#include <stdint.h>

static float clipped(float x, float low, float high) { return fminf(fmaxf(x, low), high); }

/* Light (rows, columns, 2) of sun and sky as in field.encoded. The rows of height and its means over narrow and broad
   surroundings are step apart, those of the rest tile, those of past_rocks rock. Rays: rows, columns and rise. */
void bake(long rows, long columns, long step, long tile, long rock, long rays, const float *ray, const float *sun,
          const float *height, const float *narrow, const float *broad, const uint8_t *albedo, const uint8_t *packed,
          const uint8_t *past_rocks, uint8_t *light) {
  float over[columns]; /* the highest ray of the sun that is blocked */
  for (long row = 0; row < rows; row++, height += step, narrow += step, broad += step) {
    for (long k = 0; k < columns; k++) over[k] = -1e6f;
    for (long n = 0; n < rays; n++) {
      const float *from = height + (long)ray[3 * n] * step + (long)ray[3 * n + 1], rise = ray[3 * n + 2];
      for (long k = 0; k < columns; k++) over[k] = fmaxf(over[k], from[k] - rise);
    }
    for (long k = 0; k < columns; k++) {
      const float here = height[k];
      const float slope_x = (height[k + 1] - height[k - 1]) * (0.5f / TEXEL);
      const float slope_y = (height[k + step] - height[k - step]) * (0.5f / TEXEL);
      const float upright = 1.0f / sqrtf(1.0f + slope_x * slope_x + slope_y * slope_y);
      const float facing = fmaxf((sun[2] - sun[0] * slope_x - sun[1] * slope_y) * upright, 0.0f);
      const float shown = 1.0f - clipped((over[k] - here) / PENUMBRA + 0.5f, 0.0f, 1.0f);
      const float hollow = 60.0f * fmaxf(narrow[k] - here, 0.0f) + 22.0f * fmaxf(broad[k] - here, 0.0f);
      const float sky = clipped(1.0f - hollow, 0.35f, 1.0f) * (0.75f + 0.25f * upright);
      const float pressed = COVERED * packed[k] / 255.0f;
      const float share = (albedo[k] + (PACKED_ALBEDO - albedo[k]) * pressed) * (0.5f / ALBEDO);
      light[2 * k] = fminf(255.0f * sqrtf(share * facing * shown * (past_rocks[k] / 255.0f)), 255.0f);
      light[2 * k + 1] = fminf(255.0f * sqrtf(share * sky), 255.0f);
    }
    albedo += tile, packed += tile, past_rocks += rock, light += 2 * tile;
  }
}
