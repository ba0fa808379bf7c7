#include <math.h>
#include <stdint.h>

/* For each of n queries the index of the candidate of its kind with the most similar descriptor in its window, or -1;
   among equals the first one. As by SciPy in viso2_matching.py, where CELL [px] and LENGTH of a descriptor are defined.

   The candidates are sorted by cells: those of cell k of a kind's rows x columns are order[start[k]] to before
   order[start[k + 1]]. window: reach to the left, to the right, and up and down. */

static inline long cell(float x, long count) {
  const long k = (int)fminf(fmaxf(x / CELL, 0.0f), count - 1.0f);
  return k < 0 ? 0 : k;  /* of a number that is none */
}

void most_similar(long n, const float *queries, const int64_t *kinds, const uint8_t *descriptors,
                  const float *candidates, const uint8_t *theirs, long rows, long columns, const int64_t *start,
                  const int64_t *order, const float *window, int64_t *best) {
  const float left = window[0], right = window[1], high = window[2];
  for (long i = 0; i < n; i++, queries += 2, descriptors += LENGTH) {
    const float u = queries[0], v = queries[1];
    const long first = cell(u - left, columns), last = cell(u + right, columns);
    const long bottom = cell(v + high, rows);
    int least = 256 * LENGTH;
    best[i] = -1;
    for (long row = cell(v - high, rows); row <= bottom; row++) {
      const int64_t *cells = start + (kinds[i] * rows + row) * columns;
      for (long k = cells[first]; k < cells[last + 1]; k++) {
        const long j = order[k];
        const float across = candidates[2 * j] - u, down = candidates[2 * j + 1] - v;
        if (across < -left || across > right || fabsf(down) > high) continue;
        int difference = 0;
        for (int d = 0; d < LENGTH; d++) {
          const int apart = descriptors[d] - theirs[LENGTH * j + d];
          difference += apart < 0 ? -apart : apart;
        }
        if (difference < least || (difference == least && j < best[i])) least = difference, best[i] = j;
      }
    }
  }
}
