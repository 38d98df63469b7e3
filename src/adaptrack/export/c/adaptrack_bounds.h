/* adaptrack: the sizes, counts and numbers that constants of one kind may have. */
#ifndef ADAPTRACK_BOUNDS_H
#define ADAPTRACK_BOUNDS_H
#include "adaptrack_block.h"

enum { ADAPTRACK_FIXED, ADAPTRACK_RENEWED, ADAPTRACK_KEPT, ADAPTRACK_SIZES = 4 };

/* An array of the record. */
typedef struct {
    uint32_t word;  /* of the record, of its address; its sizes follow */
    uint32_t sizes; /* how many */
    uint32_t entry; /* words of an entry */
    uint32_t role;
    uint32_t other; /* 0: doubles, none of them NaN; 1: whole numbers, rows, or doubles with NaN among them */
    uint32_t open;  /* 1: the sizes follow from numbers, 0: they are `size` */
    uint32_t size[ADAPTRACK_SIZES];
} adaptrack_array;

/* Bounds of a number. */
typedef struct {
    uint32_t array; /* in which it lies; beyond the last one: the record itself */
    uint32_t word;  /* of the array */
    uint32_t whole; /* 1: a whole number, 0: a double, 2: NaN, a delay that is learned */
    double least, most;
} adaptrack_bound;

/* A number that the block holds twice; an array beyond the last one is the record itself. */
typedef struct {
    uint32_t array, word, other_array, other_word;
} adaptrack_equal;

/* A word of the state that is not zero before the first step; value 0: the period. */
typedef struct {
    uint32_t array;
    uint32_t word;
    uint64_t value;
} adaptrack_initial;

/* Prove that all sizes, counts and numbers of a block are within their bounds. */
adaptrack_error adaptrack_check_bounds(const adaptrack_block *);
#endif
