/* A number of the program: one per lane, LANES vehicles side by side in one vector register.

   Every operation is written for all lanes at once, so that the compiler has nothing to vectorise by itself; loops over
   the lanes (EACH) are unrolled into vector instructions. With LANES 1 a number is a plain double.
   NaN and infinity pass through sums and products; op_min and op_max may drop a NaN in their first operand. */

#include <math.h>
#include <string.h>

#ifndef LANES
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif
#endif

#if LANES == 1
/* states go through memory from call to call: vector stores between scalar loads would make the processor wait */
#pragma GCC optimize("no-tree-slp-vectorize")
typedef double real;
#define EACH
#define AT(a) a
#else
typedef double real __attribute__((vector_size(8 * LANES)));
#define EACH for (int e = 0; e < LANES; e++)
#define AT(a) a[e]
#endif

#define ALL(a) ((a) - (real){0})
#define OP static inline __attribute__((always_inline)) real
/* a long operation is no faster when inlined at its hundreds of places, and takes twice as long to compile */
#define LONG_OP static __attribute__((noinline)) real

/* operations that the processor has */

OP op_sqrt(real a) { real r; EACH AT(r) = sqrt(AT(a)); return r; }
OP op_abs(real a) { real r; EACH AT(r) = fabs(AT(a)); return r; }
OP op_floor(real a) { real r; EACH AT(r) = floor(AT(a)); return r; }
OP op_ceil(real a) { real r; EACH AT(r) = ceil(AT(a)); return r; }
OP op_copysign(real a, real b) { real r; EACH AT(r) = copysign(AT(a), AT(b)); return r; }
OP op_min(real a, real b) { real r; EACH AT(r) = AT(a) < AT(b) ? AT(a) : AT(b); return r; }
OP op_max(real a, real b) { real r; EACH AT(r) = AT(a) > AT(b) ? AT(a) : AT(b); return r; }
OP op_lt(real a, real b) { real r; EACH AT(r) = AT(a) < AT(b) ? 1.0 : 0.0; return r; }
OP op_le(real a, real b) { real r; EACH AT(r) = AT(a) <= AT(b) ? 1.0 : 0.0; return r; }
OP op_eq(real a, real b) { real r; EACH AT(r) = AT(a) == AT(b) ? 1.0 : 0.0; return r; }
OP op_ne(real a, real b) { real r; EACH AT(r) = AT(a) != AT(b) ? 1.0 : 0.0; return r; }
OP op_not(real a) { real r; EACH AT(r) = AT(a) == 0.0 ? 1.0 : 0.0; return r; }
OP op_sign(real a) { real r; EACH AT(r) = AT(a) > 0.0 ? 1.0 : (AT(a) < 0.0 ? -1.0 : 0.0); return r; }
OP op_if_else_zero(real a, real b) { real r; EACH AT(r) = AT(a) != 0.0 ? AT(b) : 0.0; return r; }
OP op_select(real a, real b, real c) { real r; EACH AT(r) = AT(a) != 0.0 ? AT(b) : AT(c); return r; }
OP op_and(real a, real b) { return op_if_else_zero(a, op_ne(b, ALL(0.0))); }
OP op_or(real a, real b) { return op_select(a, ALL(1.0), op_ne(b, ALL(0.0))); }

/* sine and cosine after Moshier's Cephes: pi/2 in three parts, then polynomials on +-pi/4. Exact to 1e-16 of 1 for
   arguments up to 1e8 */

OP quadrants(real a) { return (a * 0x1.45f306dc9c883p-1 + 0x1.8p52) - 0x1.8p52; } /* a / (pi/2), rounded */

LONG_OP quarter_wave(real a, real ahead) {
  real n = quadrants(a);
  real r = ((a - n * 1.57079625129699707031) - n * 7.54978941586159635336e-8) - n * 5.39030285815811905290e-15;
  real z = r * r;
  real s = 1.58962301576546568060e-10 * z - 2.50507477628578072866e-8;
  s = ((s * z + 2.75573136213857245213e-6) * z - 1.98412698295895385996e-4) * z + 8.33333333332211858878e-3;
  s = r + r * z * (s * z - 1.66666666666666307295e-1);
  real c = 2.08757008419747316778e-9 - 1.13585365213876817300e-11 * z;
  c = ((c * z - 2.75573141792967388112e-7) * z + 2.48015872888517045348e-5) * z - 1.38888888888730564116e-3;
  c = 1.0 - 0.5 * z + z * z * (c * z + 4.16666666666665929218e-2);
  real pairs = op_floor((n + ahead) * 0.5);
  real odd = (n + ahead) - 2.0 * pairs;
  real sign = 1.0 - 2.0 * (pairs - 2.0 * op_floor(pairs * 0.5));
  return sign * op_select(odd, c, s);
}

OP op_sin(real a) { return quarter_wave(a, ALL(0.0)); }
OP op_cos(real a) { return quarter_wave(a, ALL(1.0)); }
OP op_tan(real a) { return op_sin(a) / op_cos(a); }

/* arc tangent after Cephes: three ranges, a rational function on the middle one */

LONG_OP op_atan(real a) {
  real size = op_abs(a);
  real far = op_lt(ALL(2.41421356237309504880), size), near = op_lt(size, ALL(0.66));
  real up = op_select(far, ALL(-1.0), op_select(near, size, size - 1.0));
  real down = op_select(far, size, op_select(near, ALL(1.0), size + 1.0));
  real q = up / down, z = q * q;
  real p = -8.750608600031904122785e-1 * z - 1.615753718733365076637e1;
  p = ((p * z - 7.500855792314704667340e1) * z - 1.228866684490136173410e2) * z - 6.485021904942025371773e1;
  real d = (z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2;
  d = ((d * z + 4.328810604912902668951e2) * z + 4.853903996359136964868e2) * z + 1.945506571482613964425e2;
  real offset = op_select(far, ALL(1.57079632679489661923), op_select(near, ALL(0.0), ALL(0.78539816339744830962)));
  return op_copysign(offset + (q + q * z * p / d), a);
}

/* the rest lane by lane */

#define BY_LANE(name, function) OP name(real a) { real r; EACH AT(r) = function(AT(a)); return r; }
#define BY_LANE_2(name, function) OP name(real a, real b) { real r; EACH AT(r) = function(AT(a), AT(b)); return r; }

BY_LANE(op_asin, asin)
BY_LANE(op_acos, acos)
BY_LANE(op_sinh, sinh)
BY_LANE(op_cosh, cosh)
BY_LANE(op_tanh, tanh)
BY_LANE(op_exp, exp)
BY_LANE(op_log, log)
BY_LANE_2(op_pow, pow)
BY_LANE_2(op_atan2, atan2)
BY_LANE_2(op_hypot, hypot)
