/* adaptrack: files of constants and states, and what every memory of the caller begins with. */
#ifndef ADAPTRACK_MEMORY_H
#define ADAPTRACK_MEMORY_H
#include "adaptrack_error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Words of 8 bytes: magic, format, CRC-32 of what follows, kernels, id, count, then so many words. In a file, and in a
   saved state, they are little-endian. */
typedef struct {
    const unsigned char *bytes;
    int is_big_endian;
    uint32_t checksum;
    uint64_t id; /* of constants: CRC-32 of their layout; of a state: the checksum of its constants, then its path's */
    size_t count;
} adaptrack_file;
enum { ADAPTRACK_FILE_HEAD = 6 }; /* words */

typedef struct {
    uint64_t mark; /* says that the rest is there */
    uint32_t busy;
    uint32_t constants; /* their checksum */
    uint32_t path;      /* CRC-32 of path and plan, 0: none */
    uint32_t points;    /* CRC-32 of the path's points alone */
    uint32_t state;     /* words of the memory before the state */
    uint32_t count;     /* of the state */
    uint64_t kernels;
    uint64_t planner; /* address of its memory, 0: none */
    uint64_t reserved[2];
} adaptrack_head; /* 64 bytes, a cache line */

/* What words of constants may be: as exported, any number but NaN, from least to most, as another word, anything. */
typedef enum { EXACT, NUMBER, BETWEEN, SAME, ANY } adaptrack_rule;
typedef struct {
    uint32_t first, count; /* words */
    adaptrack_rule rule;
    uint32_t twin; /* the other word */
    double least, most;
} adaptrack_bounds;

/* Read the head of constants: ADAPTRACK_DAMAGED, or ADAPTRACK_OTHER_VERSION. */
adaptrack_error adaptrack_read_constants(adaptrack_file *, const void *bytes, size_t size, uint64_t kernels);
/* A word of a file, its head included. */
uint64_t adaptrack_file_word(const adaptrack_file *, size_t i);
/* Let a memory be ready whose state begins after so many words and has so many. */
void adaptrack_begin(adaptrack_head *, const adaptrack_file *, uint64_t kernels, size_t state, size_t count);
int adaptrack_is_ready(const void *memory);
/* Bytes of a saved state; 0 for a memory that is not ready. */
size_t adaptrack_saved_size(const void *memory);
adaptrack_error adaptrack_save_state(const void *memory, void *state, size_t size);
/* Nothing is written unless the state is whole, and of these kernels, constants and path. */
adaptrack_error adaptrack_restore_state(void *memory, const void *state, size_t size);
/* ADAPTRACK_OK where rounding is to nearest, subnormal numbers are numbers and no operation is fused or reordered. */
adaptrack_error adaptrack_arithmetic(void);
adaptrack_error adaptrack_compiled_exactly(void);
/* Take a memory for a call, ADAPTRACK_BUSY where another call has it; give it back. */
adaptrack_error adaptrack_take(void *memory);
void adaptrack_give(void *memory);
/* CRC-32 (IEEE 802.3) of some bytes. */
uint32_t adaptrack_crc32(const void *bytes, size_t size);

#ifdef __cplusplus
}
#endif
#endif
