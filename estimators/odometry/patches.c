/* Location of warped patches to sub-pixels, as by NumPy in warped_matching.py, one patch after the other in the cache.
   HALF, ITERATIONS, DONE, LONGEST_STEP, QUIETEST, FLATTEST, LEAST_CONTRAST and NOISE_SHARE are defined there. */
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { SIDE = 2 * HALF + 1, LANES = SIDE + 1, WIDE = SIDE + 2, ALL = WIDE * WIDE };
typedef float row __attribute__((vector_size(4 * LANES)));  /* of a patch, and one pixel more that weighs nothing */
typedef row row_anywhere __attribute__((aligned(4)));
typedef uint32_t word __attribute__((aligned(1), may_alias));
typedef float half_row __attribute__((vector_size(2 * LANES)));
typedef float quarter_row __attribute__((vector_size(LANES)));
typedef uint8_t pixels __attribute__((vector_size(LANES)));

typedef uint16_t words __attribute__((vector_size(2 * LANES)));
typedef int32_t integers __attribute__((vector_size(4 * LANES)));

/* step by step: GCC 12 takes the direct way pixel by pixel */
static inline row levels(pixels grey) {
  return __builtin_convertvector(__builtin_convertvector(__builtin_convertvector(grey, words), integers), row);
}

static inline float total(row all) {
  half_row half[2];
  memcpy(half, &all, sizeof half);
  half[0] += half[1];
  quarter_row quarter[2];
  memcpy(quarter, half, sizeof quarter);
  quarter[0] += quarter[1];
  return (quarter[0][0] + quarter[0][1]) + (quarter[0][2] + quarter[0][3]);
}

static inline float limited(float x, float most) { return fminf(fmaxf(x, -most), most); }

static inline long inside(long x, long size) { return x < 0 ? 0 : x < size ? x : size - 1; }

/* grey levels around a centre, at offsets A times those of the patch; outside the image those near its edge */
static void warp(const uint8_t *image, int width, int height, const float *centre, const float *A, float *grey) {
  /* four pixels are read at once, of which two count */
  const float most_u = width - 3.001f, most_v = height - 1.001f;
  for (int k = 0; k < ALL; k++) {
    const float x = k % WIDE - (HALF + 1), y = k / WIDE - (HALF + 1);
    const float u = fminf(fmaxf(centre[0] + A[0] * x + A[1] * y, 0.0f), most_u);
    const float v = fminf(fmaxf(centre[1] + A[2] * x + A[3] * y, 0.0f), most_v);
    const int column = (int)u, line = (int)v, place = line * width + column;
    const float share_u = u - column, share_v = v - line;
    const uint32_t above = *(const word *)(image + place), below = *(const word *)(image + width + place);
    const float top = (float)(int)(above & 255), top_right = (float)(int)(above >> 8 & 255);
    const float low = (float)(int)(below & 255), low_right = (float)(int)(below >> 8 & 255);
    const float up = top + share_u * (top_right - top), down = low + share_u * (low_right - low);
    grey[k] = up + share_v * (down - up);
  }
}

/* grey levels of the unwarped patch around (u, v), less a level */
static inline void sample(const uint8_t *image, long width, long height, float u, float v, float level, row *grey) {
  const float low_u = floorf(u), low_v = floorf(v);
  const long column = (long)low_u - HALF, line = (long)low_v - HALF;
  const int whole = column >= 0 && line >= 0 && column + LANES < width && line + SIDE < height;
  row above;
  for (int i = 0; i <= SIDE; i++) {
    pixels one, next;
    if (whole) {
      const uint8_t *at = image + (line + i) * width + column;
      memcpy(&one, at, sizeof one), memcpy(&next, at + 1, sizeof next);
    } else {
      const uint8_t *at = image + inside(line + i, height) * width;
      for (int j = 0; j < LANES; j++) one[j] = at[inside(column + j, width)], next[j] = at[inside(column + j + 1, width)];
    }
    const row a = levels(one), b = levels(next);
    const row below = a + (u - low_u) * (b - a);
    if (i > 0) grey[i - 1] = above + (v - low_v) * (below - above) - level;
    above = below;
  }
}

/* n patches around centres (n, 2) of their sources, warped by A (n, 2, 2), located in the target near points (n, 2) */
void match(long n, const uint8_t *const *sources, const float *centres, const float *A, const uint8_t *target,
           long width, long height, const row_anywhere *weight, float *points, float *correlation, float *variance) {
  for (long k = 0; k < n; k++) {
    float wide[ALL];
    row across[SIDE], down[SIDE], pattern[SIDE], grey[SIDE];
    row mean_u = {0}, mean_v = {0}, mean = {0}, uu = {0}, uv = {0}, vv = {0}, of_u = {0}, of_v = {0}, squares = {0};
    warp(sources[k], width, height, centres + 2 * k, A + 4 * k, wide);
    for (int i = 0; i < SIDE; i++) {
      const float *at = wide + (i + 1) * WIDE + 1;
      across[i] = 0.5f * (*(row_anywhere *)(at + 1) - *(row_anywhere *)(at - 1));
      down[i] = 0.5f * (*(row_anywhere *)(at + WIDE) - *(row_anywhere *)(at - WIDE));
      pattern[i] = *(row_anywhere *)at;
      mean_u += weight[i] * across[i], mean_v += weight[i] * down[i], mean += weight[i] * pattern[i];
    }
    const float level = total(mean), slope_u = total(mean_u), slope_v = total(mean_v);
    for (int i = 0; i < SIDE; i++) {
      const row u = across[i] - slope_u, v = down[i] - slope_v, deviation = pattern[i] - level;
      across[i] = weight[i] * u, down[i] = weight[i] * v, pattern[i] = weight[i] * deviation;
      uu += across[i] * u, uv += across[i] * v, vv += down[i] * v;
      of_u += across[i] * deviation, of_v += down[i] * deviation, squares += pattern[i] * deviation;
    }
    const float a = total(uu), b = total(uv), c = total(vv), determinant = fmaxf(a * c - b * b, FLATTEST);
    const float contrast = sqrtf(fmaxf(total(squares), LEAST_CONTRAST * LEAST_CONTRAST));
    const float offset_u = total(of_u), offset_v = total(of_v);
    float u = limited(points[2 * k], 1e6f), v = limited(points[2 * k + 1], 1e6f), alike;
    for (int turn = 0;; turn++) {
      row sum = {0}, square = {0}, by_u = {0}, by_v = {0}, product = {0};
      sample(target, width, height, u, v, level, grey);
      for (int i = 0; i < SIDE; i++) {
        const row weighted = weight[i] * grey[i];
        sum += weighted, square += weighted * grey[i], product += pattern[i] * grey[i];
        by_u += across[i] * grey[i], by_v += down[i] * grey[i];
      }
      const float off = total(sum);
      const float there = sqrtf(fmaxf(total(square) - off * off, LEAST_CONTRAST * LEAST_CONTRAST));
      alike = total(product) / (contrast * there);
      if (turn == ITERATIONS) break;
      const float r_u = contrast / there * total(by_u) - offset_u, r_v = contrast / there * total(by_v) - offset_v;
      const float step_u = (c * r_u - b * r_v) / determinant, step_v = (a * r_v - b * r_u) / determinant;
      u -= limited(step_u, LONGEST_STEP), v -= limited(step_v, LONGEST_STEP);
      if (fmaxf(fabsf(step_u), fabsf(step_v)) <= DONE) break;
    }
    const float noise = fmaxf(contrast * sqrtf(fmaxf(1.0f - alike, 0.0f)), QUIETEST);
    const float scale = NOISE_SHARE * noise * noise / determinant;
    points[2 * k] = u, points[2 * k + 1] = v, correlation[k] = alike;
    variance[2 * k] = scale * c, variance[2 * k + 1] = scale * a;
  }
}
