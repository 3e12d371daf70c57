/* Correctly rounded binary32 of a function: its binary64 value where that decides, else MPFR's.

   A binary64 value y whose error is below 64 units in the last place is enough wherever y (1 - 2^-46) and y (1 + 2^-46)
   round to the same binary32. glibc's functions are closer than that by a factor of ten. Of all 2^32 inputs some
   hundreds stay, and of pairs one in 2^21, for which MPFR computes the correctly rounded value. */
#define _GNU_SOURCE /* exp10, M_PI */
#include <math.h>
#include <mpfr.h>
#include <string.h>

#define BLOCK 1024

#define FUNCTIONS(F)                                                                                           \
    F(exp) F(exp2) F(log) F(log2) F(log10) F(sin) F(cos) F(tan) F(asin) F(acos) F(atan) F(sinh) F(cosh) F(tanh) \
    F(asinh) F(acosh) F(atanh) F(expm1) F(log1p) F(cbrt) F(erf) F(erfc) F(exp10)

#define DECLARE(name) void near_##name(long n, const double *x, double *y);
FUNCTIONS(DECLARE)

static void near_rsqrt(long n, const double *x, double *y) {
    for (long i = 0; i < n; i++) y[i] = 1 / sqrt(x[i]);
}

/* The sign of a zero is that of x (IEEE 754-2019 section 9.2.1). */
static void near_sinpi(long n, const double *x, double *y) {
    for (long i = 0; i < n; i++) {
        double k = rint(x[i]), f = x[i] - k, s = sin(M_PI * f);
        y[i] = f == 0 ? copysign(0, x[i]) : k * 0.5 != rint(k * 0.5) ? -s : s;
    }
}

/* All zeros are positive. */
static void near_cospi(long n, const double *x, double *y) {
    for (long i = 0; i < n; i++) {
        double k = rint(x[i]), g = 0.5 - fabs(x[i] - k);
        y[i] = sin(M_PI * (k * 0.5 != rint(k * 0.5) && g != 0 ? -g : g));
    }
}

typedef struct {
    const char *name;
    void (*near)(long, const double *, double *);
    int (*exactly)(mpfr_t, const mpfr_t, mpfr_rnd_t);
} Function;

#define ROW(name) {#name, near_##name, mpfr_##name},
static const Function TABLE[] = {
    FUNCTIONS(ROW) ROW(sinpi) ROW(cospi){"rsqrt", near_rsqrt, mpfr_rec_sqrt}};

/* A function of two arguments. */
typedef struct {
    const char *name;
    void (*near)(long, const double *, const double *, double *);
    int (*exactly)(mpfr_t, const mpfr_t, const mpfr_t, mpfr_rnd_t);
} OfTwo;

#define PAIRS(F) F(pow) F(atan2) F(hypot)
#define DECLARE_PAIR(name) void near_##name(long n, const double *a, const double *b, double *y);
PAIRS(DECLARE_PAIR)
static const OfTwo OF_TWO[] = {PAIRS(ROW)};

static const Function *found(const char *name) {
    for (unsigned k = 0; k < sizeof TABLE / sizeof *TABLE; k++)
        if (!strcmp(TABLE[k].name, name)) return &TABLE[k];
    return 0;
}

/* The exponents of binary32, its denormals too. */
static void as_binary32(void) {
    mpfr_set_emin(-148);
    mpfr_set_emax(128);
}

/* The binary32 of a y of 24 bits that MPFR rounded: a denormal where it is one. */
static float as_float(mpfr_t y, int inexact) {
    inexact = mpfr_check_range(y, inexact, MPFR_RNDN);
    mpfr_subnormalize(y, inexact, MPFR_RNDN);
    return mpfr_get_flt(y, MPFR_RNDN);
}

static float exactly(const Function *f, float x) {
    mpfr_t given, y;
    mpfr_inits2(24, given, y, (mpfr_ptr)0);
    mpfr_set_flt(given, x, MPFR_RNDN);
    float rounded = as_float(y, f->exactly(y, given, MPFR_RNDN));
    mpfr_clears(given, y, (mpfr_ptr)0);
    return rounded;
}

static float exactly_of_two(const OfTwo *f, float a, float b) {
    mpfr_t first, second, y;
    mpfr_inits2(24, first, second, y, (mpfr_ptr)0);
    mpfr_set_flt(first, a, MPFR_RNDN);
    mpfr_set_flt(second, b, MPFR_RNDN);
    float rounded = as_float(y, f->exactly(y, first, second, MPFR_RNDN));
    mpfr_clears(first, second, y, (mpfr_ptr)0);
    return rounded;
}

/* The values of a block, and the binary32 on either side of them. */
static void around(const Function *f, long n, const float *x, double margin, float *low, float *high) {
    double wide[BLOCK], y[BLOCK];
    for (long i = 0; i < n; i++) wide[i] = x[i];
    f->near(n, wide, y);
    for (long i = 0; i < n; i++) low[i] = (float)(y[i] * (1 - margin));
    for (long i = 0; i < n; i++) high[i] = (float)(y[i] * (1 + margin));
}

static int differ(float low, float high) { return low != high && (low == low || high == high); }

/* Write the correctly rounded values. Return how many MPFR computed; -1 for an unknown function. */
long correctly_rounded(const char *name, long n, const float *x, float *result) {
    const Function *f = found(name);
    float high[BLOCK];
    long undecided = 0;
    if (!f) return -1;
    as_binary32();
    for (long first = 0; first < n; first += BLOCK) {
        long count = n - first < BLOCK ? n - first : BLOCK;
        float *low = result + first;
        int any = 0;
        around(f, count, x + first, 0x1p-46, low, high);
        for (long i = 0; i < count; i++) any |= differ(low[i], high[i]);
        for (long i = 0; any && i < count; i++)
            if (differ(low[i], high[i])) {
                low[i] = exactly(f, x[first + i]);
                undecided++;
            }
    }
    return undecided;
}

/* Write the correctly rounded values of pairs. Return how many MPFR computed; -1 for an unknown function. */
long correctly_rounded_pairs(const char *name, long n, const float *a, const float *b, float *result) {
    const OfTwo *f = 0;
    long undecided = 0;
    for (unsigned k = 0; k < sizeof OF_TWO / sizeof *OF_TWO; k++)
        if (!strcmp(OF_TWO[k].name, name)) f = &OF_TWO[k];
    if (!f) return -1;
    as_binary32();
    for (long first = 0; first < n; first += BLOCK) {
        double left[BLOCK], right[BLOCK], y[BLOCK];
        long count = n - first < BLOCK ? n - first : BLOCK;
        for (long i = 0; i < count; i++) left[i] = a[first + i], right[i] = b[first + i];
        f->near(count, left, right, y);
        for (long i = 0; i < count; i++) {
            float low = (float)(y[i] * (1 - 0x1p-46)), high = (float)(y[i] * (1 + 0x1p-46));
            if (differ(low, high)) low = exactly_of_two(f, a[first + i], b[first + i]), undecided++;
            result[first + i] = low;
        }
    }
    return undecided;
}

/* Write the places of the inputs whose values are, relatively, within the margin of a midpoint between two binary32.
   Return how many there are, up to the room; -1 for an unknown function. */
long hard(const char *name, long n, const float *x, double margin, long room, long *places) {
    const Function *f = found(name);
    float low[BLOCK], high[BLOCK];
    long many = 0;
    if (!f) return -1;
    for (long first = 0; first < n; first += BLOCK) {
        long count = n - first < BLOCK ? n - first : BLOCK;
        int any = 0;
        around(f, count, x + first, margin, low, high);
        for (long i = 0; i < count; i++) any |= differ(low[i], high[i]);
        for (long i = 0; any && i < count; i++)
            if (differ(low[i], high[i]) && many < room) places[many++] = first + i;
    }
    return many;
}
