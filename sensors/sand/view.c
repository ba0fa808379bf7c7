/* Sand as a camera sees it, in one pass: as by NumPy in trace_camera.py. */
#include <math.h>
#include <stdint.h>

typedef uint32_t __attribute__((aligned(1), may_alias)) Word;

static float clipped(float x, float low, float high) { return fminf(fmaxf(x, low), high); }

/* Places (3, rays): column and row [texels] and height [m] that rays, x and y at depth 1, meet on ground of a height.
   Numbers: R (3, 3) of the camera, the eye in texels and its height, the plane below it and its slopes. */
void look(long rays, long steps, long rows, long columns, const float *restrict ray, const float *restrict number,
          const float *restrict height, float *restrict place) {
  const float *R = number, ex = number[9], ey = number[10], eye = number[11], below = number[12];
  const float last_u = columns - 1.001f, last_v = rows - 1.001f;
  const int width = columns;
  float *restrict u = place, *restrict v = place + rays, *restrict z = place + 2 * rays;
  for (long k = 0; k < rays; k++) {
    const float x = ray[k], y = ray[rays + k], rise = R[6] * x + R[7] * y + R[8];
    const float kx = (R[0] * x + R[1] * y + R[2]) / rise, ky = (R[3] * x + R[4] * y + R[5]) / rise;
    z[k] = below / (1.0f - number[13] * kx - number[14] * ky);
    u[k] = kx * (1.0f / TEXEL), v[k] = ky * (1.0f / TEXEL);
  }
  for (long step = 0; step < steps; step++)
    for (long k = 0; k < rays; k++) {
      const float at_u = clipped(ex + u[k] * z[k], 0.0f, last_u), at_v = clipped(ey + v[k] * z[k], 0.0f, last_v);
      const int i = at_u, j = at_v, at = j * width + i;
      const float right = at_u - i, under = at_v - j;
      const float top = height[at] + right * (height[at + 1] - height[at]);
      const float bottom = height[at + width] + right * (height[at + width + 1] - height[at + width]);
      z[k] = top + under * (bottom - top) - eye;
    }
  for (long k = 0; k < rays; k++) u[k] = ex + u[k] * z[k], v[k] = ey + v[k] * z[k], z[k] += eye;
}

/* Shares of the light of sun and sky from the places (.., half) between pixels, which begin border pixels earlier. */
void reflect(long rows, long columns, long border, long half, long height, long width, const float *restrict u,
             const float *restrict v, const float *restrict shade, const uint8_t *restrict light,
             float *restrict direct, float *restrict ambient) {
  const float *fields[3] = {u, v, shade}, scale = 2.0f / (255.0f * 255.0f * 65536.0f * 65536.0f);
  const float last_u = width - 1.001f, last_v = height - 1.001f;
  float wide[half], at[3][columns + 1];
  for (long row = 0; row < rows; row++, direct += columns, ambient += columns) {
    const float under = row % 2 ? 0.25f : 0.75f;
    for (int n = 0; n < 3; n++) {
      const float *from = fields[n] + (row + border - 1) / 2 * half;
      for (long k = 0; k < half; k++) wide[k] = from[k] + under * (from[k + half] - from[k]);
      const float *left = wide + border / 2 - 1;
      for (long k = 0; k < (columns + 1) / 2; k++) {
        at[n][2 * k] = left[k] + 0.75f * (left[k + 1] - left[k]);
        at[n][2 * k + 1] = left[k + 1] + 0.25f * (left[k + 2] - left[k + 1]);
      }
    }
    for (long k = 0; k < columns; k++) {
      const float at_u = clipped(at[0][k], 0.0f, last_u), at_v = clipped(at[1][k], 0.0f, last_v);
      const int i = at_u, j = at_v, near = 2 * (j * (int)width + i);
      const uint32_t right = (at_u - i) * 256.0f, down = (at_v - j) * 256.0f; /* two roots of 8 bits in a word */
      const uint32_t top = *(const Word *)(light + near), bottom = *(const Word *)(light + near + 2 * width);
      const uint32_t sun = (top & 0xff00ff) * (256 - down) + (bottom & 0xff00ff) * down;
      const uint32_t sky = (top >> 8 & 0xff00ff) * (256 - down) + (bottom >> 8 & 0xff00ff) * down;
      const float d = (int)((sun & 0xffff) * (256 - right) + (sun >> 16) * right);
      const float a = (int)((sky & 0xffff) * (256 - right) + (sky >> 16) * right);
      direct[k] = scale * d * d * at[2][k];
      ambient[k] = scale * a * a;
    }
  }
}

/* Levels of one colour at n pixels. Numbers: light of sun and sky, albedo of sand, that of stone less it, and white. */
void paint(long n, const float *restrict number, const float *restrict direct, const float *restrict ambient,
           const float *restrict tint, uint8_t *restrict level) {
  for (long k = 0; k < n; k++) {
    const float light = direct[k] * number[0] + ambient[k] * number[1];
    level[k] = (int)fminf(rintf(sqrtf(light * (tint[k] * number[3] + number[2])) * number[4]), 255.0f);
  }
}
