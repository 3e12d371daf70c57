/* The functions in binary64, many at a time: within a few units in the last place of the exact values.

   Compiled with -ffast-math, by which gcc takes glibc's vector functions (libmvec, errors below 4 ULP) where there are
   any. Nothing else is computed here, so that fast math changes nothing else. */
#define _GNU_SOURCE /* exp10 */
#include <math.h>

#define EACH(name)                                          \
    void near_##name(long n, const double *x, double *y) {  \
        for (long i = 0; i < n; i++) y[i] = name(x[i]);      \
    }

EACH(exp) EACH(exp2) EACH(log) EACH(log2) EACH(log10)
EACH(sin) EACH(cos) EACH(tan) EACH(asin) EACH(acos) EACH(atan)
EACH(sinh) EACH(cosh) EACH(tanh) EACH(asinh) EACH(acosh) EACH(atanh)
EACH(expm1) EACH(log1p) EACH(cbrt) EACH(erf) EACH(erfc) EACH(exp10)

#define PAIR(name)                                                            \
    void near_##name(long n, const double *a, const double *b, double *y) {   \
        for (long i = 0; i < n; i++) y[i] = name(a[i], b[i]);                  \
    }

PAIR(pow) PAIR(atan2) PAIR(hypot)
