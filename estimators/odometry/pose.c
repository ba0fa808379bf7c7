/* Robust motion of a stereo pair from n points, as by NumPy in pose.py. Matrices of one entry a point are kept in
   columns of N numbers, N the next multiple of LANES; what is beyond n weighs nothing. What is in capitals is
   defined there. */
#include <math.h>

typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

typedef struct {
  double *point, *image, *information, *r, *error, *J, *weighted;
} columns;

/* k-th smallest of n values, which are put in order so far that smaller ones come before it */
static double ranked(double *values, long n, long k) {
  for (long low = 0, high = n - 1; low < high;) {
    const double pivot = values[(low + high) / 2];
    long i = low, j = high;
    while (i <= j) {
      while (i < high && values[i] < pivot) i++;
      while (j > low && values[j] > pivot) j--;
      if (i > j) break;
      const double swapped = values[i];
      values[i++] = values[j], values[j--] = swapped;
    }
    if (k <= j) high = j;
    else if (k >= i) low = i;
    else break;
  }
  return values[k];
}

static double median(double *values, long n) {
  const double upper = ranked(values, n, n / 2);
  double lower = n % 2 ? upper : values[0];
  for (long m = 1; m < n / 2 && n % 2 == 0; m++) lower = fmax(lower, values[m]);
  return 0.5 * (lower + upper);
}

/* derivative of the images by a point, turned into the axes of P, and by the rotation of C (both 3 axes by 3 images) */
static inline void slopes(const double *R, const double *camera, double x, double y, double depth, double shift[3][3],
                          double turn[3][3]) {
  const double scale = camera[0] / depth, across[3] = {x, y, x - camera[3]};
  for (int i = 0; i < 3; i++) {
    const double s0 = i == 1 ? 0.0 : scale, s1 = i == 1 ? scale : 0.0, s2 = -across[i] * scale / depth;
    const double t0 = s1 * depth - s2 * y, t1 = s2 * x - s0 * depth, t2 = s0 * y - s1 * x;
    for (int k = 0; k < 3; k++) {
      turn[k][i] = R[3 * k] * t0 + R[3 * k + 1] * t1 + R[3 * k + 2] * t2;
      shift[k][i] = R[3 * k] * s0 + R[3 * k + 1] * s1 + R[3 * k + 2] * s2;
    }
  }
}

static inline void seen_from(const double *motion, const double *point, long N, long m, double seen[3]) {
  const double d[3] = {point[m] - motion[9], point[N + m] - motion[10], point[2 * N + m] - motion[11]};
  for (int k = 0; k < 3; k++) seen[k] = motion[k] * d[0] + motion[3 + k] * d[1] + motion[6 + k] * d[2];
  seen[2] = fmax(seen[2], NEAREST);
}

/* inverse covariances of the residuals: of the images, and of the points carried into them */
static void inform(long n, long N, const double *motion, const double *camera, const double *covariance,
                   const double *variance, columns at) {
  for (long m = 0; m < n; m++) {
    double seen[3], shift[3][3], turn[3][3], S[3][3], C[3][3], carried[3][3];
    seen_from(motion, at.point, N, m, seen);
    slopes(motion, camera, seen[0], seen[1], seen[2], shift, turn);
    for (int l = 0; l < 3; l++)
      for (int i = 0; i < 3; i++) {
        const double *of = covariance + 9 * m + l;
        carried[l][i] = shift[0][i] * of[0] + shift[1][i] * of[3] + shift[2][i] * of[6];
      }
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        S[i][j] = carried[0][i] * shift[0][j] + carried[1][i] * shift[1][j] + carried[2][i] * shift[2][j] +
                  (i == j ? variance[3 * m + i] : 0.0);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) {
        const int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, d = (j + 2) % 3;
        C[i][j] = S[a][c] * S[b][d] - S[a][d] * S[b][c];
      }
    const double determinant = S[0][0] * C[0][0] + S[0][1] * C[0][1] + S[0][2] * C[0][2];
    for (int i = 0; i < 9; i++) at.information[i * N + m] = C[i / 3][i % 3] / determinant;
  }
}

/* residuals and their root mean square after a motion; if whole, the Jacobian too, and that times the information */
static void linearise(long n, long N, int whole, const double *motion, const double *camera, columns at) {
  const double c[3] = {camera[1], camera[2], camera[1]}, *restrict point = at.point, *restrict image = at.image;
  const double *restrict information = at.information;
  double *restrict found = at.r, *restrict error = at.error, *restrict J = at.J, *restrict weighted = at.weighted;
  for (long m = 0; m < n; m++) {
    double seen[3], r[3], shift[3][3], turn[3][3], square = 0.0;
    seen_from(motion, point, N, m, seen);
    const double scale = camera[0] / seen[2], across[3] = {seen[0], seen[1], seen[0] - camera[3]};
    for (int i = 0; i < 3; i++) found[i * N + m] = r[i] = image[i * N + m] - across[i] * scale - c[i];
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) square += r[i] * r[j] * information[(3 * i + j) * N + m];
    error[m] = sqrt(square / 3.0);
    if (!whole) continue;
    slopes(motion, camera, seen[0], seen[1], seen[2], shift, turn);
    for (int k = 0; k < 6; k++)
      for (int i = 0; i < 3; i++) {
        double sum = 0.0;
        for (int j = 0; j < 3; j++)
          sum += (k < 3 ? turn[k][j] : -shift[k - 3][j]) * information[(3 * i + j) * N + m];
        J[(3 * k + i) * N + m] = k < 3 ? turn[k][i] : -shift[k - 3][i];
        weighted[(3 * k + i) * N + m] = sum;
      }
  }
}

static inline double total(lanes x) { return ((x[0] + x[1]) + (x[2] + x[3])) + ((x[4] + x[5]) + (x[6] + x[7])); }

/* matrix (6, 6) and right-hand side (6) of a Gauss-Newton step */
static void normal_equations(long N, const double *weight, columns at, double normal[6][6], double *gradient) {
  double trace = 0.0;
  for (int k = 0; k < 6; k++) {
    lanes sum[7] = {0};
    for (int i = 0; i < 3; i++)
      for (long m = 0; m < N; m += LANES) {
        const lanes row = *(const lanes *)(weight + m) * *(const lanes *)(at.weighted + (3 * k + i) * N + m);
        for (int l = 0; l < 6; l++) sum[l] += row * *(const lanes *)(at.J + (3 * l + i) * N + m);
        sum[6] += row * *(const lanes *)(at.r + i * N + m);
      }
    for (int l = 0; l < 6; l++) normal[k][l] = total(sum[l]);
    gradient[k] = total(sum[6]), trace += normal[k][k];
  }
  for (int k = 0; k < 6; k++) normal[k][k] += DAMPING * trace;
}

/* A x = b of a positive definite matrix (6, 6), which is overwritten by its Cholesky factor; 0 if it is not */
static int solve(double A[6][6], const double *b, double *x) {
  for (int i = 0; i < 6; i++) {
    double sum = b[i];
    for (int j = 0; j <= i; j++) {
      double entry = A[i][j];
      for (int k = 0; k < j; k++) entry -= A[i][k] * A[j][k];
      if (i == j && !(entry > 0.0)) return 0;
      A[i][j] = i == j ? sqrt(entry) : entry / A[j][j];
      if (j < i) sum -= A[i][j] * x[j];
    }
    x[i] = sum / A[i][i];
  }
  for (int i = 5; i >= 0; i--) {
    for (int j = i + 1; j < 6; j++) x[i] -= A[j][i] * x[j];
    x[i] /= A[i][i];
  }
  return 1;
}

/* R becomes exp(skew(w)) R */
static void turn_by(const double *w, double *R) {
  const double square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], angle = sqrt(square);
  const double a = angle < 1e-8 ? 1.0 : sin(angle) / angle, b = angle < 1e-8 ? 0.5 : (1.0 - cos(angle)) / square;
  for (int j = 0; j < 3; j++) {
    const double v[3] = {R[j], R[3 + j], R[6 + j]}, dot = w[0] * v[0] + w[1] * v[1] + w[2] * v[2];
    for (int i = 0; i < 3; i++) {
      const int k = (i + 1) % 3, l = (i + 2) % 3;
      R[3 * i + j] = v[i] + a * (w[k] * v[l] - w[l] * v[k]) + b * (w[i] * dot - square * v[i]);
    }
  }
}

/* Motion: R (3, 3) and p (3) of C in P; it is refined, and so are the inliers. Columns (55 N): point, image, inverse
   covariance, and as found residual, error, Jacobian and its weighted form. Returns the squared length of the last step
   in standard deviations, less than 0 if there is none, and the scatter of the inliers' errors. */
void refine(long n, const double *points, const double *covariance, const double *z, const double *variance,
            const double *camera, double *motion, unsigned char *inliers, double *all, double *result) {
  const long N = (n + LANES - 1) / LANES * LANES;
  const columns at = {all, all + 3 * N, all + 6 * N, all + 15 * N, all + 18 * N, all + 19 * N, all + 37 * N};
  double *weight = all + 55 * N, *sorted = all + 56 * N, sigma = 0.0, length = -1.0;
  for (long i = 0; i < 3; i++)
    for (long m = 0; m < n; m++) at.point[i * N + m] = points[3 * m + i], at.image[i * N + m] = z[3 * m + i];
  inform(n, N, motion, camera, covariance, variance, at);
  for (int narrow = 0; narrow < 2; narrow++) {
    int whole = 1;
    for (int turn = 0; turn < ITERATIONS; turn++) {
      double normal[6][6], gradient[6], step[6];
      long count = 0;
      linearise(n, N, whole, motion, camera, at);
      for (long m = 0; m < n; m++)
        if (inliers[m]) sorted[count++] = at.error[m];
      sigma = fmax(FINEST, median(sorted, count) / MEDIAN);
      for (long m = 0; m < n; m++) {
        const double u = at.error[m] / ((narrow ? NARROW : WIDE) * sigma), v = 1.0 + u * u;
        weight[m] = inliers[m] / (v * v);
      }
      normal_equations(N, weight, at, normal, gradient);
      length = -1.0;
      if (!solve(normal, gradient, step)) break;
      turn_by(step, motion);
      length = 0.0;
      for (int k = 0; k < 6; k++) length += step[k] * gradient[k] / (sigma * sigma);
      for (int k = 0; k < 3; k++) motion[9 + k] += step[3 + k];
      if (length < CONVERGED * CONVERGED) break;
      whole = length > FAR * FAR;
    }
    long agreeing = 0;
    for (long m = 0; m < n; m++) agreeing += inliers[m] = at.error[m] < CUT * sigma;
    if (agreeing < FEWEST) break;
  }
  result[0] = length, result[1] = sigma;
}
