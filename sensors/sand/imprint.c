/* The imprint of a wheel in sand, texel by texel in one pass: as by NumPy in grid.py. */
#include <math.h>
#include <stdint.h>
#include <string.h>

static float clipped(float x, float low, float high) { return fminf(fmaxf(x, low), high); }
static float square(float x) { return x * x; }
static float bell(float x) { return expf(-x * x); }

typedef struct { /* grid.Imprint */
  float ax, ay, bx, by, tax, tay, tbx, tby, reach;
  float edge, wall, brink, sinkage, turned, rolled, skew, lugs, lug_width, smeared, depth, left, right;
} Imprint;

static float lug_mark(const Imprint *p, float along, float across, float fine, float broad, float *slot) {
  const float ends = clipped((p->edge - 0.002f - fabsf(across)) / p->smeared, 0.0f, 1.0f);
  *slot = 0.0f;
  if (ends == 0.0f) return 0.0f;
  const float turned = p->turned + (along - across * p->skew) * p->rolled;
  const float count = turned * p->lugs + 0.03f * broad + 0.022f * fine;
  const float number = floorf(count), phase = count - number;
  float odd = sinf(number * 12.9898f) * 43758.5453f;
  odd -= floorf(odd);
  const float narrow = expf(-square(square((phase - 0.28f) / p->lug_width)));
  const float ridges = bell((phase - 0.50f) / 0.085f) + 0.3f * bell((phase - 0.05f) / 0.055f);
  *slot = narrow * ends;
  return p->depth * ends *
         (0.5f * ridges * (0.7f + 0.5f * odd) * (1.0f + 0.2f * fine) - narrow * (0.75f + 0.5f * odd));
}

static float berm(const Imprint *p, float across, float fine, float broad) {
  const float crest = across > 0.0f ? p->left : p->right, outside = fabsf(across) - p->brink;
  if (outside < -0.006f) return 0.0f;
  const float profile = bell((outside - 0.013f) / BERM) * clipped((outside + 0.006f) / 0.006f, 0.0f, 1.0f);
  const float height = fminf(crest * profile * clipped(1.0f + 0.4f * broad + 0.2f * fine, 0.15f, 2.2f), 0.014f);
  if (outside <= 0.012f || fine <= 1.0f) return height;
  return height + 0.25f * crest * expf(-(outside - 0.012f) / 0.012f) * clipped(fine - 1.0f, 0.0f, 2.0f);
}

/* Height and packing of a window after a wheel rolled over it, and the sand removed from its rut [m3]. */
void imprint(long rows, long columns, long sweeps, const float *numbers, const float *large, const float *fine,
             const float *broad, float *height, uint8_t *packed, uint8_t *inside, double *removed) {
  const Imprint *p = (const Imprint *)numbers;
  double sum = 0.0;
  float before[columns];          /* before: what slid from the texels before */
  long first[rows], beyond[rows]; /* columns inside */
  for (long k = 0, row = 0; row < rows; row++) {
    first[row] = columns, beyond[row] = 0;
    for (long column = 0; column < columns; column++, k++) {
      const float x = column * TEXEL, y = row * TEXEL;
      const float from_a = (x - p->ax) * p->tax + (y - p->ay) * p->tay;
      const float to_b = (p->bx - x) * p->tbx + (p->by - y) * p->tby;
      inside[k] = 0;
      if (from_a < 0.0f || to_b <= 0.0f) continue;
      const float along = from_a / fmaxf(from_a + to_b, 1e-9f);
      const float tx = p->tax + along * (p->tbx - p->tax), ty = p->tay + along * (p->tby - p->tay);
      const float dx = x - p->ax - along * (p->bx - p->ax), dy = y - p->ay - along * (p->by - p->ay);
      const float straight = dy * tx - dx * ty;
      if (fabsf(straight) >= p->reach) continue;
      inside[k] = 1;
      first[row] = first[row] < column ? first[row] : column, beyond[row] = column + 1;
      const float across = straight + 0.0011f * fine[k] + 0.0014f * broad[k];
      const float share = clipped((p->brink + 0.5f * p->wall - fabsf(across)) / p->wall, 0.0f, 1.0f);
      const float cut = share * share * (3.0f - 2.0f * share);
      float slot, rut = height[k];
      if (cut > 0.0f) {
        const float mark = lug_mark(p, along, straight, fine[k], broad[k], &slot);
        const float relief = KEPT * clipped(height[k] - large[k], LOWEST, HIGHEST);
        const float floor = large[k] - p->sinkage + relief + 0.0006f * broad[k] + 0.00012f * fine[k] + mark;
        rut += (fminf(floor, height[k] + 0.002f) - height[k]) * cut;
        sum += fmaxf(height[k] - rut, 0.0f);
        const uint8_t pressed = 255.0f * cut * (0.75f + 0.25f * slot);
        if (pressed > packed[k]) packed[k] = pressed;
      }
      height[k] = rut + berm(p, across, fine[k], broad[k]) * (1.0f - cut);
    }
  }
  *removed = sum * TEXEL * TEXEL;
  for (long sweep = 0; sweep < 2 * sweeps; sweep++) {
    const long sideways = sweep % 2, next = sideways ? 1 : columns;
    memset(before, 0, sizeof before);
    for (long row = 0; row < rows; row++)
      for (long column = first[row], k = row * columns + column; column < beyond[row]; column++, k++) {
        float *from = before + (sideways ? 0 : column), slide = 0.0f;
        if (inside[k] && (sideways ? column : row) + 1 < (sideways ? columns : rows) && inside[k + next]) {
          const float rise = height[k + next] - height[k];
          slide = (rise - clipped(rise, -STEEPEST, STEEPEST)) * SHARE;
        }
        height[k] = height[k] + slide - *from;
        *from = slide;
      }
  }
}
