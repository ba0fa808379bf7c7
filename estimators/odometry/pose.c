/* Residuals of n points after a motion, as by NumPy in pose.py, in columns: of the observed ones the point (3), its
   image (3) and the inverse covariance (9) of the residuals; in found the residuals (3), their normalised root mean
   square (1), the derivative of the image by rotation and translation (6, 3), and that times the inverse covariance.
   The motion: R (3, 3), p (3), and of the camera focal length, cx, cy and baseline. */
#include <math.h>

void linearise(long n, long whole, const double *restrict motion, const double *restrict observed,
               double *restrict found) {
  const double *R = motion, *p = motion + 9, *camera = motion + 12, *information = observed + 6 * n;
  const double f = camera[0], c[3] = {camera[1], camera[2], camera[1]};
  double *error = found + 3 * n, *J = found + 4 * n, *weighted = found + 22 * n;
  for (long m = 0; m < n; m++) {
    const double d[3] = {observed[m] - p[0], observed[n + m] - p[1], observed[2 * n + m] - p[2]};
    const double x = R[0] * d[0] + R[3] * d[1] + R[6] * d[2], y = R[1] * d[0] + R[4] * d[1] + R[7] * d[2];
    const double depth = fmax(R[2] * d[0] + R[5] * d[1] + R[8] * d[2], NEAREST), scale = f / depth;
    const double across[3] = {x, y, x - camera[3]};
    double r[3], by[6][3], square = 0.0;
    for (int i = 0; i < 3; i++) found[i * n + m] = r[i] = observed[(3 + i) * n + m] - across[i] * scale - c[i];
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) square += r[i] * r[j] * information[(3 * i + j) * n + m];
    error[m] = sqrt(square / 3.0);
    if (!whole) continue;
    for (int i = 0; i < 3; i++) {
      /* the image by the point's place in C, which turns and moves against the camera */
      const double s0 = i == 1 ? 0.0 : scale, s1 = i == 1 ? scale : 0.0, s2 = -across[i] * scale / depth;
      const double t0 = s1 * depth - s2 * y, t1 = s2 * x - s0 * depth, t2 = s0 * y - s1 * x;
      for (int k = 0; k < 3; k++) {
        by[k][i] = R[3 * k] * t0 + R[3 * k + 1] * t1 + R[3 * k + 2] * t2;
        by[3 + k][i] = -(R[3 * k] * s0 + R[3 * k + 1] * s1 + R[3 * k + 2] * s2);
      }
    }
    for (int i = 0; i < 3; i++)
      for (int k = 0; k < 6; k++) {
        double sum = 0.0;
        for (int j = 0; j < 3; j++) sum += by[k][j] * information[(3 * i + j) * n + m];
        J[(3 * k + i) * n + m] = by[k][i];
        weighted[(3 * k + i) * n + m] = sum;
      }
  }
}
