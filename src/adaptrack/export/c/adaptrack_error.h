/* adaptrack: what every function answers. */
#ifndef ADAPTRACK_ERROR_H
#define ADAPTRACK_ERROR_H

/* GCC and Clang; MSVC with /fp:fast */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)
#error "adaptrack: compile this file and link your program without -Ofast, -ffast-math or -ffinite-math-only (MSVC: \
/fp:fast). They drop NaN, which stands for an unknown number, and make subnormal numbers zero (ADAPTRACK_ARITHMETIC)."
#endif

/* Values stay; a minor version may add some. */
typedef enum {
    ADAPTRACK_OK = 0,
    ADAPTRACK_BAD_ARGUMENT = 1,    /* a null pointer, a size, an address that is no multiple of 8 */
    ADAPTRACK_TOO_SMALL = 2,       /* the memory */
    ADAPTRACK_NOT_READY = 3,       /* the memory has not been initialised, or was overwritten */
    ADAPTRACK_BUSY = 4,            /* another thread, or an interrupted call, is in a step of this memory */
    ADAPTRACK_DAMAGED = 5,         /* constants or the saved state are cut short, a byte of them is another, or a
                                      number of the constants is out of bounds */
    ADAPTRACK_OTHER_VERSION = 6,   /* the format, or the kernels, are of another version of adaptrack */
    ADAPTRACK_OTHER_KIND = 7,      /* of FMUs: constants of another unit */
    ADAPTRACK_OTHER_SIZES = 8,     /* constants of another controller: of other horizons, parts or whole numbers */
    ADAPTRACK_OTHER_CONSTANTS = 9, /* the state was saved under other constants */
    ADAPTRACK_OTHER_PATH = 10,     /* the state was saved on another path */
    ADAPTRACK_ARITHMETIC = 11,     /* rounding is not to nearest, subnormal numbers count as zero, or the compiler has
                                      fused, reordered or replaced operations: see the options in the Makefile */
    ADAPTRACK_BAD_PATH = 12,       /* the points make no path, or the memory holds none */
    ADAPTRACK_OUT_OF_ORDER = 13,   /* a call that has to wait for another one first */
    ADAPTRACK_BAD_PLAN = 14,       /* speeds, slopes or stops make no plan, or the memory holds none */
    ADAPTRACK_BAD_TRAJECTORY = 15, /* times, places, yaws or speeds make no trajectory */
    ADAPTRACK_BAD_FALLBACK = 16    /* the fallback makes no trajectory, or does not end at rest */
} adaptrack_error;

#endif
