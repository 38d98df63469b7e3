/* What kernels are made of: exact arithmetic, eight numbers at once, whole numbers.

   Each operation rounds once, in the order in which it is written. Compile with -ffp-contract=off: a compiler must not
   fuse a multiplication and an addition by itself. Compile with -fno-strict-aliasing and -fwrapv: records lie in arrays
   of numbers, and whole numbers wrap. No function of C's library is called by name. */
#ifndef ADAPTRACK_HEAD_H
#define ADAPTRACK_HEAD_H
#include <stdbool.h>
#include <stdint.h>
#ifndef __GNUC__
#include <math.h>
#endif

/* The kernels leave unused what they leave unused in Python. */
#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#pragma GCC diagnostic ignored "-Wunused-variable"
#pragma GCC diagnostic ignored "-Wunused-but-set-variable"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#pragma GCC diagnostic ignored "-Wtautological-compare"
#pragma GCC diagnostic ignored "-Wbitwise-instead-of-logical"
#endif

/* Functions are inlined by force, unless the program is to be small. */
#if defined(__GNUC__) && !defined(__OPTIMIZE_SIZE__)
#define INLINED static inline __attribute__((always_inline))
#else
#define INLINED static inline
#endif
#ifndef ADAPTRACK_SHARED
#define EXPORTED /* a part of the program that calls it */
#elif defined(_WIN32)
#define EXPORTED __attribute__((dllexport))
#else
#define EXPORTED __attribute__((visibility("default")))
#endif
/* an address takes a word of 8 bytes, on processors with shorter ones too */
#if UINTPTR_MAX < UINT64_MAX
#define ADAPTRACK_POINTER_PADDING int32_t padding;
#else
#define ADAPTRACK_POINTER_PADDING
#endif
/* A processor without an instruction takes kernels that compute the same bits. */
#if !(defined(__FMA__) || defined(__aarch64__) || (defined(__ARM_FEATURE_FMA) && __ARM_FP & 8) || \
      (defined(__riscv_flen) && __riscv_flen >= 64))
#define SOFT_FMA
#endif
#if !defined(__GNUC__) || (defined(__x86_64__) && !defined(__SSE4_1__)) || (defined(__arm__) && !(__ARM_FP & 8)) || \
      (defined(__riscv) && !defined(__riscv_zfa))
#define SOFT_ROUNDING
#endif
#if !defined(__GNUC__) || (defined(__arm__) && !(__ARM_FP & 8))
#define SOFT_SQRT
#endif

typedef union {
    double number;
    int64_t whole;
} adaptrack_word;

/* -- one number ---------------------------------------------------------------------------------------------------- */
/* the bits of a number, and the number of these bits */
INLINED int64_t bits_of1(double x) {
    adaptrack_word word;
    word.number = x;
    return word.whole;
}
INLINED double float_of1(int64_t bits) {
    adaptrack_word word;
    word.whole = bits;
    return word.number;
}
#ifdef __GNUC__
#define NOT_A_NUMBER __builtin_nan("")
#define INFINITE __builtin_inf()
INLINED double abs1(double x) { return __builtin_fabs(x); }
INLINED double copysign1(double x, double y) { return __builtin_copysign(x, y); }
#else
#define NOT_A_NUMBER NAN
#define INFINITE INFINITY
INLINED double abs1(double x) { return float_of1(bits_of1(x) & INT64_MAX); }
INLINED double copysign1(double x, double y) { return float_of1((bits_of1(x) & INT64_MAX) | (bits_of1(y) & INT64_MIN)); }
#endif
#ifdef SOFT_FMA
EXPORTED double adaptrack_soft_fma(double a, double b, double c);
EXPORTED void adaptrack_soft_fma8(double *a, int64_t a_0, double *b, int64_t b_0, double *c, int64_t c_0, double *y,
                                  int64_t y_0);
INLINED double fma1(double a, double b, double c) { return adaptrack_soft_fma(a, b, c); }
#else
INLINED double fma1(double a, double b, double c) { return __builtin_fma(a, b, c); }
#endif
#ifdef SOFT_ROUNDING
EXPORTED double adaptrack_soft_floor(double x);
EXPORTED double adaptrack_soft_ceil(double x);
INLINED double floor1(double x) { return adaptrack_soft_floor(x); }
INLINED double ceil1(double x) { return adaptrack_soft_ceil(x); }
#else
INLINED double floor1(double x) { return __builtin_floor(x); }
INLINED double ceil1(double x) { return __builtin_ceil(x); }
#endif
#ifdef SOFT_SQRT
EXPORTED double adaptrack_soft_sqrt(double x);
INLINED double sqrt1(double x) { return adaptrack_soft_sqrt(x); }
#else
INLINED double sqrt1(double x) { return __builtin_sqrt(x); }
#endif
INLINED bool isnan1(double x) { return x != x; }
INLINED bool isfinite1(double x) { return abs1(x) < INFINITE; }
INLINED bool isinf1(double x) { return abs1(x) == INFINITE; }
INLINED double min_real(double a, double b) { return b < a ? b : a; }
INLINED double max_real(double a, double b) { return b > a ? b : a; }
INLINED double larger1(double x, double y) { return x > y ? x : y; }
INLINED double lesser1(double x, double y) { return x < y ? x : y; }

/* -- whole numbers ------------------------------------------------------------------------------------------------- */
INLINED int64_t min_whole(int64_t a, int64_t b) { return b < a ? b : a; }
INLINED int64_t max_whole(int64_t a, int64_t b) { return b > a ? b : a; }
INLINED int64_t abs_whole(int64_t a) { return a < 0 ? -a : a; }
INLINED int64_t shifted_left(int64_t a, int64_t count) { return (int64_t)((uint64_t)a << count); }
/* a / b rounded down, and what it leaves, of the sign of b; 0 for b = 0 */
INLINED int64_t floor_divided(int64_t a, int64_t b) {
    if (b == 0) return 0;
    if (b == -1) return (int64_t)(0 - (uint64_t)a);
    return a / b - (a % b != 0 && (a < 0) != (b < 0));
}
INLINED int64_t remainder_of(int64_t a, int64_t b) {
    if (b == 0 || b == -1) return 0;
    const int64_t remainder = a % b;
    return remainder != 0 && (remainder < 0) != (b < 0) ? remainder + b : remainder;
}
/* a bound of a slice of so many elements: a negative one counts from the end */
INLINED int64_t slice_bound(int64_t i, int64_t size) {
    if (i < 0) i += size;
    return i < 0 ? 0 : i > size ? size : i;
}
#ifdef __GNUC__
/* an index, or an end of the process where it is beyond the array */
INLINED int64_t checked_index(int64_t i, int64_t size) {
    if (i < 0 || i >= size) __builtin_trap();
    return i;
}
INLINED int64_t checked_span(int64_t i, int64_t count, int64_t size) {
    if (i < 0 || i + count > size) __builtin_trap();
    return i;
}
#endif

/* a column of a matrix, whose numbers lie a row apart */
struct column {
    double *data;
    int64_t size[1];
    int64_t stride;
};
/* a number of a column of a matrix; the last one for the rows behind it */
INLINED double row_at(const double *p, int64_t width, int64_t last, int64_t row, int64_t j) {
    return p[(row < last ? row : last) * width + j];
}

/* -- parts of a fused multiply-add in software, see maths/exact.py ------------------------------------------------- */
INLINED double upper_half1(double x) {
    return float_of1((int64_t)(((uint64_t)bits_of1(x) + (UINT64_C(1) << 26)) & ~((UINT64_C(1) << 27) - 1)));
}
INLINED double to_odd1(double x, double remainder) {
    const int64_t bits = bits_of1(x), step = ((bits ^ bits_of1(remainder)) >> 63) | 1;
    return remainder != 0.0 && (bits & 1) == 0 && remainder == remainder ? float_of1(bits + step) : x;
}
INLINED bool usual_sum1(double a, double b, double c, double y, double beyond) {
    const bool is_small = abs1(a) + abs1(b) + abs1(c) < 0x1p500;
    const bool is_usual = abs1(a * b) >= 0x1p-960 || a == 0.0 || b == 0.0;
    return is_small && is_usual && y + beyond * (1.0 + 0x1p-52) == y;
}

/* -- eight numbers ------------------------------------------------------------------------------------------------- */
/* clang's vectors, or a struct of C99's: the same bits */
#if defined(__clang__) && !defined(ADAPTRACK_PLAIN_C)
typedef double eight __attribute__((vector_size(64)));
typedef int64_t eight_whole __attribute__((vector_size(64)));
typedef double eight_anywhere __attribute__((vector_size(64), aligned(8)));
typedef double four __attribute__((vector_size(32)));
typedef double two __attribute__((vector_size(16)));
typedef bool eight_bits __attribute__((ext_vector_type(8)));

INLINED eight load8(const double *p) { return *(const eight_anywhere *)p; }
INLINED void store8(double *p, eight x) { *(eight_anywhere *)p = x; }
INLINED eight splat8(double x) { return (eight){x, x, x, x, x, x, x, x}; }
INLINED eight_whole splat_whole8(int64_t x) { return (eight_whole){x, x, x, x, x, x, x, x}; }
INLINED eight zeros8(void) { return splat8(0.0); }
INLINED eight add8(eight a, eight b) { return a + b; }
INLINED eight sub8(eight a, eight b) { return a - b; }
INLINED eight mul8(eight a, eight b) { return a * b; }
INLINED eight div8(eight a, eight b) { return a / b; }
/* entries of a where all bits of the mask are set, of b elsewhere */
INLINED eight chosen8(eight_whole mask, eight a, eight b) {
    return (eight)((mask & (eight_whole)a) | (~mask & (eight_whole)b));
}
INLINED eight lesser8(eight a, eight b) { return chosen8(a < b, a, b); }
INLINED eight larger8(eight a, eight b) { return chosen8(a > b, a, b); }
INLINED eight where_positive8(eight a, eight b, eight c) { return chosen8(a > zeros8(), b, c); }
INLINED eight_whole places8(void) { return (eight_whole){0, 1, 2, 3, 4, 5, 6, 7}; }
INLINED eight keep_first8(eight a, int64_t count) { return (eight)((eight_whole)a & (places8() < splat_whole8(count))); }
INLINED eight keep_last8(eight a, int64_t start) { return (eight)((eight_whole)a & (places8() >= splat_whole8(start))); }
INLINED eight with_entry8(eight a, int64_t i, double x) {
    return chosen8(places8() == splat_whole8(i), splat8(x), a);
}
INLINED int truths8(eight_whole mask) {
    const eight_bits bits = __builtin_convertvector(mask, eight_bits);
    unsigned char truths;
    __builtin_memcpy(&truths, &bits, 1);
    return truths;
}
INLINED bool all_below_infinity8(eight a) { return truths8(a < splat8(INFINITE)) == 255; }
INLINED int64_t first_equal8(eight a, double x) { return __builtin_ctz((unsigned)truths8(a == splat8(x)) | 256u); }

/* entries 0+4, 1+5, 2+6, 3+7, then 0+2, 1+3, then 0+1 */
INLINED double total8(eight a) {
    const four f = __builtin_shufflevector(a, a, 0, 1, 2, 3) + __builtin_shufflevector(a, a, 4, 5, 6, 7);
    const two t = __builtin_shufflevector(f, f, 0, 1) + __builtin_shufflevector(f, f, 2, 3);
    return t[0] + t[1];
}
INLINED double largest8(eight a) {
    return larger1(larger1(larger1(a[0], a[4]), larger1(a[2], a[6])), larger1(larger1(a[1], a[5]), larger1(a[3], a[7])));
}
INLINED double smallest8(eight a) {
    return lesser1(lesser1(lesser1(a[0], a[4]), lesser1(a[2], a[6])), lesser1(lesser1(a[1], a[5]), lesser1(a[3], a[7])));
}
/* numbers of a column of a matrix, zero for the rows from count on */
INLINED eight column8(const double *p, int64_t width, int64_t count, int64_t first, int64_t j) {
    const int64_t last = count - 1;
    const eight y = {
        row_at(p, width, last, first, j),     row_at(p, width, last, first + 1, j),
        row_at(p, width, last, first + 2, j), row_at(p, width, last, first + 3, j),
        row_at(p, width, last, first + 4, j), row_at(p, width, last, first + 5, j),
        row_at(p, width, last, first + 6, j), row_at(p, width, last, first + 7, j),
    };
    return keep_first8(y, count - first);
}

/* eight sums of eight numbers: neighbours first, then pairs, then fours */
INLINED eight neighbours8(eight x, eight y) {
    return __builtin_shufflevector(x, y, 0, 8, 2, 10, 4, 12, 6, 14) +
           __builtin_shufflevector(x, y, 1, 9, 3, 11, 5, 13, 7, 15);
}
INLINED eight pairs8(eight x, eight y) {
    return __builtin_shufflevector(x, y, 0, 1, 8, 9, 4, 5, 12, 13) +
           __builtin_shufflevector(x, y, 2, 3, 10, 11, 6, 7, 14, 15);
}
INLINED eight fours8(eight x, eight y) {
    return __builtin_shufflevector(x, y, 0, 1, 2, 3, 8, 9, 10, 11) +
           __builtin_shufflevector(x, y, 4, 5, 6, 7, 12, 13, 14, 15);
}
INLINED eight totals8(eight a, eight b, eight c, eight d, eight e, eight f, eight g, eight h) {
    return fours8(pairs8(neighbours8(a, b), neighbours8(c, d)), pairs8(neighbours8(e, f), neighbours8(g, h)));
}
#ifdef SOFT_FMA
static __attribute__((noinline, unused)) eight fma8(eight a, eight b, eight c) {
    double places[4][8] __attribute__((aligned(64)));
    store8(places[0], a);
    store8(places[1], b);
    store8(places[2], c);
    adaptrack_soft_fma8(places[0], 8, places[1], 8, places[2], 8, places[3], 8);
    return load8(places[3]);
}
#else
INLINED eight fma8(eight a, eight b, eight c) { return __builtin_elementwise_fma(a, b, c); }
#endif
INLINED eight upper_half8(eight x) {
    return (eight)(((eight_whole)x + splat_whole8(1 << 26)) & splat_whole8(-(1 << 27)));
}
INLINED eight to_odd8(eight x, eight remainder) {
    const eight_whole bits = (eight_whole)x, step = ((bits ^ (eight_whole)remainder) >> 63) | 1;
    const eight_whole is_inexact = (remainder < zeros8()) | (remainder > zeros8());
    return (eight)(bits + (step & ((bits & 1) - 1) & is_inexact));
}
INLINED eight abs8(eight x) { return (eight)((eight_whole)x & splat_whole8(INT64_MAX)); }
INLINED bool usual_sum8(eight a, eight b, eight c, eight y, eight beyond) {
    const eight_whole is_small = abs8(a) + abs8(b) + abs8(c) < splat8(0x1p500);
    const eight_whole is_usual = (abs8(a * b) >= splat8(0x1p-960)) | (a == zeros8()) | (b == zeros8());
    return truths8(is_small & is_usual & (y + beyond * splat8(1.0 + 0x1p-52) == y)) == 255;
}
/* an array of zeros; it is written eight numbers at a time, so that no function of C's is called */
INLINED double *filled_with_zeros(double *p, int64_t count) {
    int64_t i = 0;
    for (; i + 8 <= count; i += 8) store8(p + i, zeros8());
    for (; i < count; i++) p[i] = 0.0;
    return p;
}
#else
typedef struct {
    double of[8];
} eight;

#define FOR_EACH8 for (int i = 0; i < 8; i++)
INLINED eight load8(const double *p) {
    eight y;
    FOR_EACH8 y.of[i] = p[i];
    return y;
}
INLINED void store8(double *p, eight x) { FOR_EACH8 p[i] = x.of[i]; }
INLINED eight splat8(double x) {
    eight y;
    FOR_EACH8 y.of[i] = x;
    return y;
}
INLINED eight zeros8(void) { return splat8(0.0); }
INLINED eight add8(eight a, eight b) {
    FOR_EACH8 a.of[i] += b.of[i];
    return a;
}
INLINED eight sub8(eight a, eight b) {
    FOR_EACH8 a.of[i] -= b.of[i];
    return a;
}
INLINED eight mul8(eight a, eight b) {
    FOR_EACH8 a.of[i] *= b.of[i];
    return a;
}
INLINED eight div8(eight a, eight b) {
    FOR_EACH8 a.of[i] /= b.of[i];
    return a;
}
#ifdef SOFT_FMA
INLINED eight fma8(eight a, eight b, eight c) {
    eight y;
    adaptrack_soft_fma8(a.of, 8, b.of, 8, c.of, 8, y.of, 8);
    return y;
}
#else
INLINED eight fma8(eight a, eight b, eight c) {
    FOR_EACH8 c.of[i] = fma1(a.of[i], b.of[i], c.of[i]);
    return c;
}
#endif
INLINED eight lesser8(eight a, eight b) {
    FOR_EACH8 a.of[i] = lesser1(a.of[i], b.of[i]);
    return a;
}
INLINED eight larger8(eight a, eight b) {
    FOR_EACH8 a.of[i] = larger1(a.of[i], b.of[i]);
    return a;
}
INLINED eight where_positive8(eight a, eight b, eight c) {
    FOR_EACH8 a.of[i] = a.of[i] > 0.0 ? b.of[i] : c.of[i];
    return a;
}
INLINED eight keep_first8(eight a, int64_t count) {
    FOR_EACH8 a.of[i] = i < count ? a.of[i] : 0.0;
    return a;
}
INLINED eight keep_last8(eight a, int64_t start) {
    FOR_EACH8 a.of[i] = i >= start ? a.of[i] : 0.0;
    return a;
}
INLINED eight with_entry8(eight a, int64_t at, double x) {
    FOR_EACH8 a.of[i] = i == at ? x : a.of[i];
    return a;
}
INLINED bool all_below_infinity8(eight a) {
    int count = 0;
    FOR_EACH8 count += a.of[i] < INFINITE;
    return count == 8;
}
INLINED int64_t first_equal8(eight a, double x) {
    int64_t first = 8;
    for (int i = 7; i >= 0; i--) first = a.of[i] == x ? i : first;
    return first;
}
/* entries 0+4, 1+5, 2+6, 3+7, then 0+2, 1+3, then 0+1 */
INLINED double total8(eight a) {
    return ((a.of[0] + a.of[4]) + (a.of[2] + a.of[6])) + ((a.of[1] + a.of[5]) + (a.of[3] + a.of[7]));
}
INLINED double largest8(eight a) {
    return larger1(larger1(larger1(a.of[0], a.of[4]), larger1(a.of[2], a.of[6])),
                 larger1(larger1(a.of[1], a.of[5]), larger1(a.of[3], a.of[7])));
}
INLINED double smallest8(eight a) {
    return lesser1(lesser1(lesser1(a.of[0], a.of[4]), lesser1(a.of[2], a.of[6])),
                 lesser1(lesser1(a.of[1], a.of[5]), lesser1(a.of[3], a.of[7])));
}
INLINED eight column8(const double *p, int64_t width, int64_t count, int64_t first, int64_t j) {
    eight y;
    FOR_EACH8 y.of[i] = row_at(p, width, count - 1, first + i, j);
    return keep_first8(y, count - first);
}
/* eight sums of eight numbers: neighbours first, then pairs, then fours */
INLINED double total_of_neighbours8(eight a) {
    return ((a.of[0] + a.of[1]) + (a.of[2] + a.of[3])) + ((a.of[4] + a.of[5]) + (a.of[6] + a.of[7]));
}
INLINED eight totals8(eight a, eight b, eight c, eight d, eight e, eight f, eight g, eight h) {
    const eight y = {{total_of_neighbours8(a), total_of_neighbours8(b), total_of_neighbours8(c),
                      total_of_neighbours8(d), total_of_neighbours8(e), total_of_neighbours8(f),
                      total_of_neighbours8(g), total_of_neighbours8(h)}};
    return y;
}
INLINED eight upper_half8(eight x) {
    FOR_EACH8 x.of[i] = upper_half1(x.of[i]);
    return x;
}
INLINED eight to_odd8(eight x, eight remainder) {
    FOR_EACH8 x.of[i] = to_odd1(x.of[i], remainder.of[i]);
    return x;
}
INLINED bool usual_sum8(eight a, eight b, eight c, eight y, eight beyond) {
    int count = 0;
    FOR_EACH8 count += usual_sum1(a.of[i], b.of[i], c.of[i], y.of[i], beyond.of[i]);
    return count == 8;
}
INLINED double *filled_with_zeros(double *p, int64_t count) {
    for (int64_t i = 0; i < count; i++) p[i] = 0.0;
    return p;
}
#endif
#endif
