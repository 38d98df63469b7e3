/* adaptrack: constants of a controller as a block of bytes, laid into memory of the caller.

   A block holds no address. A memory is what the caller gives: a head, then 8-byte words, those of a record of the
   kernels first, then its arrays: FIXED (constant), RENEWED (follow from constants, written to), KEPT (state). */
#ifndef ADAPTRACK_BLOCK_H
#define ADAPTRACK_BLOCK_H
#include "adaptrack_error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A kernel whose address blocks may hold: CRC-32 of its name. */
typedef struct {
    uint32_t name;
    void (*function)(void);
} adaptrack_function;

/* A block whose tables lie within it. */
typedef struct {
    uint64_t kernels;
    uint32_t size, kind, layout, words, record, renewed, kept;
    uint32_t places, links, starts, runs, resets; /* how many */
    const unsigned char *place, *link, *start, *run, *reset, *data;
} adaptrack_block;

/* A place among its words. */
typedef struct {
    const adaptrack_block *b;
    const unsigned char *data;
    uint32_t run, begin, end, at;
} adaptrack_cursor;

/* What a reader takes. */
typedef struct {
    uint64_t kernels; /* hash of the kernels */
    uint32_t kind;    /* CRC-32 of the record's name */
    const adaptrack_function *functions;
    size_t count;                                      /* of them */
    adaptrack_error (*check)(const adaptrack_block *); /* of sizes, counts and numbers of this kind; null: none */
} adaptrack_reader;

typedef struct {
    uint64_t mark; /* says that the rest is there */
    uint32_t busy;
    uint32_t constants; /* CRC-32 of the block */
    uint32_t layout;
    uint32_t words;   /* of the memory behind the head */
    uint32_t renewed; /* first word of the RENEWED arrays */
    uint32_t kept;    /* first word of the KEPT arrays */
    uint32_t path;    /* CRC-32 of path and plan, 0: none */
    uint32_t points;  /* CRC-32 of the path's points alone */
    uint64_t reserved[3];
} adaptrack_head; /* 64 bytes, a cache line */

enum { ADAPTRACK_SAVED_HEAD = 48 }; /* bytes of a saved state before its words */

/* Bytes of memory that the constants need, 0 for no block; the block is not proved. */
size_t adaptrack_block_memory(const void *constants, size_t size);
/* Prove a block whole and of this reader. */
adaptrack_error adaptrack_block_check(const adaptrack_reader *, const void *constants, size_t size);
/* Lay a block into a memory; nothing is written unless it is proved. The memory must be aligned to 8 bytes. */
adaptrack_error adaptrack_block_lay(const adaptrack_reader *, void *memory, size_t memory_size, const void *constants,
                                     size_t size);
/* Other constants under a state that stays; nothing is written unless they are proved and of the same sizes. */
adaptrack_error adaptrack_block_renew(const adaptrack_reader *, void *memory, const void *constants, size_t size);
/* Bytes of a saved state; 0 for a memory that is not ready. */
size_t adaptrack_block_state_size(const void *memory);
adaptrack_error adaptrack_block_save(const adaptrack_reader *, const void *memory, void *state, size_t size);
adaptrack_error adaptrack_block_restore(const adaptrack_reader *, void *memory, const void *state, size_t size);
/* ADAPTRACK_OK where rounding is to nearest and subnormal numbers are numbers. */
adaptrack_error adaptrack_arithmetic(void);
/* Take a memory for a call, ADAPTRACK_BUSY where another call has it; give it back. */
adaptrack_error adaptrack_block_take(void *memory);
void adaptrack_block_give(void *memory);
/* The record at the beginning of the words. */
void *adaptrack_block_record(void *memory);
/* The words of the memory as a block has them, one after the other. */
adaptrack_cursor adaptrack_block_from(const adaptrack_block *, uint32_t first);
uint64_t adaptrack_block_next(adaptrack_cursor *);
/* Number i of a table of a block. */
uint32_t adaptrack_block_number(const unsigned char *table, size_t i);
/* CRC-32 (IEEE 802.3) of some bytes. */
uint32_t adaptrack_crc32(const void *bytes, size_t size);

#ifdef __cplusplus
}
#endif
#endif
