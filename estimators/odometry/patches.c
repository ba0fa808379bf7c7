/* Location of patches to sub-pixels, as by NumPy in warped_matching.py, one patch after the other in the cache.
   HALF, ITERATIONS, DONE, LONGEST_STEP, LANES, QUIETEST, FLATTEST, LEAST_CONTRAST and NOISE_SHARE are defined there. */
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { SIDE = 2 * HALF + 1, WIDE = SIDE + 2, ALL = WIDE * WIDE };
typedef float row __attribute__((vector_size(4 * LANES)));  /* of a patch, and pixels that weigh nothing */
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

static inline int bounded(int x, int most) { return x < 0 ? 0 : x < most ? x : most; }

/* grey levels around a centre, at offsets A times those of the patch; outside the image those near its edge */
static void warp(const uint8_t *image, int width, int height, const float *centre, const float *A, float *grey) {
  /* four pixels are read at once, of which two count */
  const float most_u = width - 3.001f, most_v = height - 1.001f;
  for (int k = 0; k < ALL; k++) {
    const float x = k % WIDE - (HALF + 1), y = k / WIDE - (HALF + 1);
    const float u = fminf(fmaxf(centre[0] + A[0] * x + A[1] * y, 0.0f), most_u);
    const float v = fminf(fmaxf(centre[1] + A[2] * x + A[3] * y, 0.0f), most_v);
    const int column = bounded((int)u, width - 4), line = bounded((int)v, height - 2), place = line * width + column;
    const float share_u = u - column, share_v = v - line;
    const uint32_t above = *(const word *)(image + place), below = *(const word *)(image + width + place);
    const float top = (float)(int)(above & 255), top_right = (float)(int)(above >> 8 & 255);
    const float low = (float)(int)(below & 255), low_right = (float)(int)(below >> 8 & 255);
    const float up = top + share_u * (top_right - top), down = low + share_u * (low_right - low);
    grey[k] = up + share_v * (down - up);
  }
}

/* grey levels of an unwarped patch, less a level: rows from `reach` left of and above (u, v) on */
static inline void sample(const uint8_t *image, long width, long height, float u, float v, int reach, int rows,
                          float level, row *grey) {
  const float low_u = floorf(u), low_v = floorf(v);
  const long column = (long)(int)low_u - reach, line = (long)(int)low_v - reach;  /* in range, whatever u and v are */
  const int whole = column >= 0 && line >= 0 && column + LANES < width && line + rows < height;
  row above;
  for (int i = 0; i <= rows; i++) {
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

struct template {
  row across[SIDE], down[SIDE], pattern[SIDE];  /* weighted gradients and grey levels, less their means */
  float a, b, c, determinant;                   /* of the structure tensor */
  float level, contrast, offset_u, offset_v;
};

/* template of a patch with a border of one pixel, whose rows are `stride` apart */
static inline void prepare(const float *wide, int stride, const row_anywhere *weight, struct template *t) {
  row mean_u = {0}, mean_v = {0}, mean = {0}, uu = {0}, uv = {0}, vv = {0}, of_u = {0}, of_v = {0}, squares = {0};
  for (int i = 0; i < SIDE; i++) {
    const float *at = wide + (i + 1) * stride + 1;
    t->across[i] = 0.5f * (*(row_anywhere *)(at + 1) - *(row_anywhere *)(at - 1));
    t->down[i] = 0.5f * (*(row_anywhere *)(at + stride) - *(row_anywhere *)(at - stride));
    t->pattern[i] = *(row_anywhere *)at;
    mean_u += weight[i] * t->across[i], mean_v += weight[i] * t->down[i], mean += weight[i] * t->pattern[i];
  }
  const float level = total(mean), slope_u = total(mean_u), slope_v = total(mean_v);
  for (int i = 0; i < SIDE; i++) {
    const row u = t->across[i] - slope_u, v = t->down[i] - slope_v, deviation = t->pattern[i] - level;
    t->across[i] = weight[i] * u, t->down[i] = weight[i] * v, t->pattern[i] = weight[i] * deviation;
    uu += t->across[i] * u, uv += t->across[i] * v, vv += t->down[i] * v;
    of_u += t->across[i] * deviation, of_v += t->down[i] * deviation, squares += t->pattern[i] * deviation;
  }
  t->level = level, t->a = total(uu), t->b = total(uv), t->c = total(vv);
  t->determinant = fmaxf(t->a * t->c - t->b * t->b, FLATTEST);
  t->contrast = sqrtf(fmaxf(total(squares), LEAST_CONTRAST * LEAST_CONTRAST));
  t->offset_u = total(of_u), t->offset_v = total(of_v);
}

/* moves a point to where the target is like the template; its correlation there, before the last step */
static inline float settle(const struct template *t, const row_anywhere *weight, const uint8_t *target, long width,
                           long height, float *point) {
  float u = limited(point[0], 1e6f), v = limited(point[1], 1e6f), alike;
  for (int turn = 0;; turn++) {
    row grey[SIDE], sum = {0}, square = {0}, by_u = {0}, by_v = {0}, product = {0};
    sample(target, width, height, u, v, HALF, SIDE, t->level, grey);
    for (int i = 0; i < SIDE; i++) {
      const row weighted = weight[i] * grey[i];
      sum += weighted, square += weighted * grey[i], product += t->pattern[i] * grey[i];
      by_u += t->across[i] * grey[i], by_v += t->down[i] * grey[i];
    }
    const float off = total(sum);
    const float there = sqrtf(fmaxf(total(square) - off * off, LEAST_CONTRAST * LEAST_CONTRAST));
    alike = total(product) / (t->contrast * there);
    if (turn == ITERATIONS) break;
    const float gain = t->contrast / there;
    const float r_u = gain * total(by_u) - t->offset_u, r_v = gain * total(by_v) - t->offset_v;
    const float step_u = (t->c * r_u - t->b * r_v) / t->determinant;
    const float step_v = (t->a * r_v - t->b * r_u) / t->determinant;
    u -= limited(step_u, LONGEST_STEP), v -= limited(step_v, LONGEST_STEP);
    if (fmaxf(fabsf(step_u), fabsf(step_v)) <= DONE) break;
  }
  point[0] = u, point[1] = v;
  return alike;
}

/* n patches around centres (n, 2) of their sources, warped by A (n, 2, 2), located in the target near points (n, 2);
   without A patches are not warped, and HALF is at most 6 */
void match(long n, const uint8_t *const *sources, const float *centres, const float *A, const uint8_t *target,
           long width, long height, const row_anywhere *weight, float *points, float *correlation, float *variance) {
  for (long k = 0; k < n; k++) {
    row wide[WIDE + 2] = {0};  /* more is read than weighs */
    struct template t;
    if (A)
      warp(sources[k], width, height, centres + 2 * k, A + 4 * k, (float *)wide);
    else
      sample(sources[k], width, height, centres[2 * k], centres[2 * k + 1], HALF + 1, WIDE, 0.0f, wide);
    prepare((const float *)wide, A ? WIDE : LANES, weight, &t);
    const float alike = settle(&t, weight, target, width, height, points + 2 * k);
    const float noise = fmaxf(t.contrast * sqrtf(fmaxf(1.0f - alike, 0.0f)), QUIETEST);
    const float scale = NOISE_SHARE * noise * noise / t.determinant;
    correlation[k] = alike;
    variance[2 * k] = scale * fmaxf(t.c, sqrtf(FLATTEST)), variance[2 * k + 1] = scale * fmaxf(t.a, sqrtf(FLATTEST));
  }
}
