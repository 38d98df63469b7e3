/* adaptrack: reads the blocks that adaptrack.export.block writes. C99, no library, nothing static that is written. */
#include "adaptrack_block.h"

#include <float.h>

enum { PRELUDE = 16, HEADER = 56, FORMAT = 1 };
static const unsigned char MAGIC[8] = {'A', 'D', 'T', 'R', 'A', 'C', 'K', 0};
static const unsigned char STATE[8] = {'A', 'D', 'S', 'T', 'A', 'T', 'E', 0};
static const uint64_t MARK = 0x6b63617274706461u; /* "adptrack" */

/* -- bytes -------------------------------------------------------------------------------------------------------- */
static uint32_t four(const unsigned char *p) {
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static uint64_t eight(const unsigned char *p) { return (uint64_t)four(p) | (uint64_t)four(p + 4) << 32; }

static void put_four(unsigned char *p, uint32_t value) {
    for (int i = 0; i < 4; i++) p[i] = (unsigned char)(value >> (8 * i) & 0xffu);
}

static void put_eight(unsigned char *p, uint64_t value) {
    put_four(p, (uint32_t)(value & 0xffffffffu));
    put_four(p + 4, (uint32_t)(value >> 32));
}

static int same(const unsigned char *a, const unsigned char *b, size_t size) {
    unsigned char differs = 0;
    for (size_t i = 0; i < size; i++) differs = (unsigned char)(differs | (a[i] ^ b[i]));
    return differs == 0;
}

static uint32_t crc_on(uint32_t crc, const unsigned char *bytes, size_t size) {
    static const uint32_t TABLE[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
        0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu, 0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu};
    for (size_t i = 0; i < size; i++) {
        crc = TABLE[(crc ^ bytes[i]) & 15u] ^ crc >> 4;
        crc = TABLE[(crc ^ (uint32_t)bytes[i] >> 4) & 15u] ^ crc >> 4;
    }
    return crc;
}

uint32_t adaptrack_crc32(const void *bytes, size_t size) {
    return ~crc_on(0xffffffffu, (const unsigned char *)bytes, size);
}

/* -- what a block says -------------------------------------------------------------------------------------------- */
static uint64_t tables(const adaptrack_block *b) {
    uint64_t bytes = 8u * ((uint64_t)b->places + b->links + b->runs) + 12u * (uint64_t)b->starts;
    return bytes + (8u - bytes % 8u) % 8u;
}

/* Read the numbers and find the tables; ADAPTRACK_DAMAGED where they do not fit. */
static adaptrack_error read_block(const unsigned char *p, size_t size, adaptrack_block *b) {
    uint32_t counts[12];
    uint64_t bytes, behind;
    b->kernels = eight(p + PRELUDE);
    for (int i = 0; i < 12; i++) counts[i] = four(p + PRELUDE + 8 + 4 * i);
    b->size = counts[0], b->kind = counts[1], b->layout = counts[2], b->words = counts[3], b->record = counts[4];
    b->renewed = counts[5], b->kept = counts[6], b->places = counts[7], b->links = counts[8], b->starts = counts[9];
    b->runs = counts[10], b->resets = counts[11];
    if (b->size != size || b->record > b->renewed || b->renewed > b->kept) return ADAPTRACK_DAMAGED;
    if (b->kept > b->words) return ADAPTRACK_DAMAGED;
    bytes = tables(b) + 16u * (uint64_t)b->resets;
    if (bytes > size - PRELUDE - HEADER) return ADAPTRACK_DAMAGED;
    b->place = p + PRELUDE + HEADER;
    b->link = b->place + 8u * (size_t)b->places;
    b->start = b->link + 8u * (size_t)b->links;
    b->run = b->start + 12u * (size_t)b->starts;
    b->reset = b->place + (size_t)tables(b);
    b->data = b->reset + 16u * (size_t)b->resets;
    behind = 0;
    for (uint32_t i = 0, end = 0; i < b->runs; i++) {
        uint32_t first = four(b->run + 8u * i), count = four(b->run + 8u * i + 4u);
        if (first < end || count > b->words || first > b->words - count) return ADAPTRACK_DAMAGED;
        end = first + count;
        behind += count;
    }
    return bytes + 8u * behind == size - PRELUDE - HEADER ? ADAPTRACK_OK : ADAPTRACK_DAMAGED;
}

static const adaptrack_function *function_of(const adaptrack_reader *reader, uint32_t name) {
    for (size_t i = 0; i < reader->count; i++)
        if (reader->functions[i].name == name) return reader->functions + i;
    return 0;
}

/* Every index within its bounds, every function at hand. */
static adaptrack_error check_tables(const adaptrack_reader *reader, const adaptrack_block *b) {
    for (uint32_t i = 0; i < b->places; i++)
        if (four(b->place + 8u * i) >= b->record || four(b->place + 8u * i + 4u) >= b->words) return ADAPTRACK_DAMAGED;
    for (uint32_t i = 0; i < b->starts; i++) {
        uint32_t of = four(b->start + 12u * i), count = four(b->start + 12u * i + 4u);
        uint32_t like = four(b->start + 12u * i + 8u);
        if (of < b->kept || of > b->words || count > b->words - of) return ADAPTRACK_DAMAGED;
        if (like < b->record || like > b->kept || count > b->kept - like) return ADAPTRACK_DAMAGED;
    }
    for (uint32_t i = 0; i < b->resets; i++)
        if (eight(b->reset + 16u * i) >= b->words) return ADAPTRACK_DAMAGED;
    for (uint32_t i = 0; i < b->links; i++) {
        if (four(b->link + 8u * i) >= b->record) return ADAPTRACK_DAMAGED;
        if (!function_of(reader, four(b->link + 8u * i + 4u))) return ADAPTRACK_OTHER_KIND;
    }
    return ADAPTRACK_OK;
}

static adaptrack_error prove(const adaptrack_reader *reader, const void *constants, size_t size, adaptrack_block *b) {
    const unsigned char *p = (const unsigned char *)constants;
    adaptrack_error status;
    if (!reader || !p) return ADAPTRACK_BAD_ARGUMENT;
    if (size < PRELUDE + HEADER || !same(p, MAGIC, sizeof MAGIC)) return ADAPTRACK_DAMAGED;
    if (four(p + 8) != FORMAT) return ADAPTRACK_OTHER_VERSION;
    if (four(p + PRELUDE + 8) != size || adaptrack_crc32(p + PRELUDE, size - PRELUDE) != four(p + 12))
        return ADAPTRACK_DAMAGED;
    status = read_block(p, size, b);
    if (status != ADAPTRACK_OK) return status;
    if (b->kernels != reader->kernels) return ADAPTRACK_OTHER_VERSION;
    if (b->kind != reader->kind) return ADAPTRACK_OTHER_KIND;
    status = check_tables(reader, b);
    return status == ADAPTRACK_OK && reader->check ? reader->check(b) : status;
}

uint32_t adaptrack_block_number(const unsigned char *table, size_t i) { return four(table + 4u * i); }

adaptrack_error adaptrack_block_check(const adaptrack_reader *reader, const void *constants, size_t size) {
    adaptrack_block b;
    return prove(reader, constants, size, &b);
}

size_t adaptrack_block_memory(const void *constants, size_t size) {
    adaptrack_block b;
    const unsigned char *p = (const unsigned char *)constants;
    if (!p || size < PRELUDE + HEADER || !same(p, MAGIC, sizeof MAGIC)) return 0;
    if (read_block(p, size, &b) != ADAPTRACK_OK) return 0;
    return sizeof(adaptrack_head) + 8u * (size_t)b.words;
}

/* -- the words of a block ----------------------------------------------------------------------------------------- */
static void next_run(adaptrack_cursor *r) {
    r->data += 8u * (size_t)(r->end - r->begin);
    r->begin = r->run < r->b->runs ? four(r->b->run + 8u * r->run) : r->b->words;
    r->end = r->run < r->b->runs ? r->begin + four(r->b->run + 8u * r->run + 4u) : r->b->words;
    r->run++;
}

adaptrack_cursor adaptrack_block_from(const adaptrack_block *b, uint32_t first) {
    adaptrack_cursor r = {b, b->data, 0, 0, 0, first};
    next_run(&r);
    return r;
}

uint64_t adaptrack_block_next(adaptrack_cursor *r) {
    uint32_t i = r->at++;
    while (i >= r->end && r->begin < r->b->words) next_run(r);
    return i >= r->begin && i < r->end && r->begin < r->b->words ? eight(r->data + 8u * (size_t)(i - r->begin)) : 0;
}

/* -- the memory --------------------------------------------------------------------------------------------------- */
static uint64_t *words_of(void *memory) { return (uint64_t *)memory + sizeof(adaptrack_head) / 8u; }

void *adaptrack_block_record(void *memory) { return words_of(memory); }

static int is_ready(const void *memory) {
    return memory && (uintptr_t)memory % 8u == 0 && ((const adaptrack_head *)memory)->mark == MARK;
}

/* Write the words from `first` to before `last` as the block has them. */
static void fill(const adaptrack_block *b, uint64_t *words, uint32_t first, uint32_t last) {
    adaptrack_cursor r = adaptrack_block_from(b, first);
    for (uint32_t i = first; i < last; i++) words[i] = adaptrack_block_next(&r);
}

/* Whether they are so. */
static int is_as_in(const adaptrack_block *b, const uint64_t *words, uint32_t first, uint32_t last) {
    adaptrack_cursor r = adaptrack_block_from(b, first);
    for (uint32_t i = first; i < last; i++)
        if (words[i] != adaptrack_block_next(&r)) return 0;
    return 1;
}

/* Write the addresses of arrays and functions into the record. */
static void connect(const adaptrack_reader *reader, const adaptrack_block *b, uint64_t *words) {
    for (uint32_t i = 0; i < b->places; i++)
        words[four(b->place + 8u * i)] = (uint64_t)(uintptr_t)(words + four(b->place + 8u * i + 4u));
    for (uint32_t i = 0; i < b->links; i++) {
        const adaptrack_function *found = function_of(reader, four(b->link + 8u * i + 4u));
        if (found) words[four(b->link + 8u * i)] = (uint64_t)(uintptr_t)found->function;
    }
}

static int is_compiled_exactly(void);

adaptrack_error adaptrack_block_lay(const adaptrack_reader *reader, void *memory, size_t memory_size,
                                     const void *constants, size_t size) {
    adaptrack_block b;
    adaptrack_head *head = (adaptrack_head *)memory;
    adaptrack_error status;
    if (!memory || (uintptr_t)memory % 8u != 0) return ADAPTRACK_BAD_ARGUMENT;
    status = prove(reader, constants, size, &b);
    if (status != ADAPTRACK_OK) return status;
    if (memory_size < sizeof *head || (memory_size - sizeof *head) / 8u < b.words) return ADAPTRACK_TOO_SMALL;
    status = adaptrack_arithmetic();
    if (status != ADAPTRACK_OK) return status;
    if (!is_compiled_exactly()) return ADAPTRACK_ARITHMETIC;
    fill(&b, words_of(memory), 0, b.words);
    connect(reader, &b, words_of(memory));
    head->busy = 0, head->path = 0, head->points = 0, head->reserved[0] = 0, head->reserved[1] = 0;
    head->constants = adaptrack_crc32(constants, size), head->layout = b.layout, head->words = b.words;
    head->renewed = b.renewed, head->kept = b.kept;
    head->mark = MARK;
    return ADAPTRACK_OK;
}

adaptrack_error adaptrack_block_renew(const adaptrack_reader *reader, void *memory, const void *constants,
                                       size_t size) {
    adaptrack_block b;
    adaptrack_head *head = (adaptrack_head *)memory;
    adaptrack_error status;
    uint64_t *words;
    if (!is_ready(memory)) return ADAPTRACK_NOT_READY;
    status = prove(reader, constants, size, &b);
    if (status != ADAPTRACK_OK) return status;
    if (b.layout != head->layout || b.words != head->words) return ADAPTRACK_OTHER_SIZES;
    status = adaptrack_arithmetic();
    if (status != ADAPTRACK_OK) return status;
    words = words_of(memory);
    for (uint32_t i = 0; i < b.starts; i++) {
        uint32_t of = four(b.start + 12u * i), count = four(b.start + 12u * i + 4u);
        uint32_t like = four(b.start + 12u * i + 8u);
        if (!is_as_in(&b, words, like, like + count)) fill(&b, words, of, of + count);
    }
    fill(&b, words, 0, b.kept);
    connect(reader, &b, words);
    for (uint32_t i = 0; i < b.resets; i++) words[eight(b.reset + 16u * i)] = eight(b.reset + 16u * i + 8u);
    head->constants = adaptrack_crc32(constants, size);
    return ADAPTRACK_OK;
}

/* -- a saved state: magic, CRC-32 of the rest, format, kernels, constants, layout, path, 0, count, words ---------- */
size_t adaptrack_block_state_size(const void *memory) {
    const adaptrack_head *head = (const adaptrack_head *)memory;
    return is_ready(memory) ? ADAPTRACK_SAVED_HEAD + 8u * (size_t)(head->words - head->renewed) : 0;
}

adaptrack_error adaptrack_block_save(const adaptrack_reader *reader, const void *memory, void *state, size_t size) {
    const adaptrack_head *head = (const adaptrack_head *)memory;
    unsigned char *p = (unsigned char *)state;
    const uint64_t *words;
    if (!reader || !state) return ADAPTRACK_BAD_ARGUMENT;
    if (!is_ready(memory)) return ADAPTRACK_NOT_READY;
    if (size < adaptrack_block_state_size(memory)) return ADAPTRACK_TOO_SMALL;
    words = (const uint64_t *)memory + sizeof *head / 8u;
    for (size_t i = 0; i < sizeof STATE; i++) p[i] = STATE[i];
    put_four(p + 12, FORMAT);
    put_eight(p + 16, reader->kernels);
    put_four(p + 24, head->constants);
    put_four(p + 28, head->layout);
    put_four(p + 32, head->path);
    put_four(p + 36, 0);
    put_eight(p + 40, head->words - head->renewed);
    for (uint32_t i = head->renewed; i < head->words; i++)
        put_eight(p + ADAPTRACK_SAVED_HEAD + 8u * (size_t)(i - head->renewed), words[i]);
    put_four(p + 8, adaptrack_crc32(p + 12, adaptrack_block_state_size(memory) - 12u));
    return ADAPTRACK_OK;
}

adaptrack_error adaptrack_block_restore(const adaptrack_reader *reader, void *memory, const void *state, size_t size) {
    adaptrack_head *head = (adaptrack_head *)memory;
    const unsigned char *p = (const unsigned char *)state;
    uint64_t *words;
    if (!reader || !state) return ADAPTRACK_BAD_ARGUMENT;
    if (!is_ready(memory)) return ADAPTRACK_NOT_READY;
    if (size < ADAPTRACK_SAVED_HEAD || !same(p, STATE, sizeof STATE)) return ADAPTRACK_DAMAGED;
    if (eight(p + 40) != (size - ADAPTRACK_SAVED_HEAD) / 8u || size % 8u != 0) return ADAPTRACK_DAMAGED;
    if (adaptrack_crc32(p + 12, size - 12u) != four(p + 8)) return ADAPTRACK_DAMAGED;
    if (four(p + 12) != FORMAT || eight(p + 16) != reader->kernels) return ADAPTRACK_OTHER_VERSION;
    if (four(p + 24) != head->constants || four(p + 28) != head->layout) return ADAPTRACK_OTHER_CONSTANTS;
    if (eight(p + 40) != head->words - head->renewed) return ADAPTRACK_OTHER_CONSTANTS;
    if (four(p + 32) != head->path) return ADAPTRACK_OTHER_PATH;
    words = words_of(memory);
    for (uint32_t i = head->renewed; i < head->words; i++)
        words[i] = eight(p + ADAPTRACK_SAVED_HEAD + 8u * (size_t)(i - head->renewed));
    return ADAPTRACK_OK;
}

/* -- who calls ---------------------------------------------------------------------------------------------------- */
adaptrack_error adaptrack_arithmetic(void) {
    volatile double one = 1.0, smallest = DBL_MIN, step = DBL_EPSILON;
    volatile double half = smallest * 0.5, up = one + 0.75 * step, low = one + 0.25 * step, below = -one - 0.25 * step;
    return half > 0.0 && up == one + step && low == one && below == -one ? ADAPTRACK_OK : ADAPTRACK_ARITHMETIC;
}

/* Products and a sum of n numbers, which differ where a compiler fuses or reorders operations. */
static void compute(const double *x, const double *terms, int n, double *y) {
    const double first = x[0] * x[2] - x[4], second = x[1] * x[3] + x[5];
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += terms[i];
    y[0] = first, y[1] = second, y[2] = sum;
}

/* Whether the compiler left each operation as it is written: it must be told so, see the options in the Makefile. */
static int is_compiled_exactly(void) {
    static const double X[6] = {1.0 + 0x1p-30, 1.0 + 0x1p-29, 1.0 - 0x1p-30, 1.0 - 0x1p-29, 1.0, -1.0};
    static const double TERMS[8] = {1.0, 0x1p-60, -1.0, 0x1p-60, 0.0, 0.0, 0.0, 0.0};
    void (*volatile opaque)(const double *, const double *, int, double *) = compute;
    double y[3];
    opaque(X, TERMS, 8, y);
    return y[0] == 0.0 && y[1] == 0.0 && y[2] == 0x1p-60;
}

#if defined(__GNUC__)
#define EXCHANGE(place, value) __atomic_exchange_n(place, value, __ATOMIC_ACQUIRE)
#define RELEASE(place) __atomic_store_n(place, 0u, __ATOMIC_RELEASE)
#elif defined(_MSC_VER)
#include <intrin.h>
#define EXCHANGE(place, value) ((uint32_t)_InterlockedExchange((volatile long *)(place), value))
#define RELEASE(place) ((void)_InterlockedExchange((volatile long *)(place), 0))
#else /* no atomic exchange that C99 knows: interrupts and threads are then the caller's care */
static uint32_t EXCHANGE(uint32_t *place, uint32_t value) {
    uint32_t before = *place;
    *place = value;
    return before;
}
#define RELEASE(place) (*(place) = 0u)
#endif

adaptrack_error adaptrack_block_take(void *memory) {
    if (!is_ready(memory)) return ADAPTRACK_NOT_READY;
    return EXCHANGE(&((adaptrack_head *)memory)->busy, 1u) == 0u ? ADAPTRACK_OK : ADAPTRACK_BUSY;
}

void adaptrack_block_give(void *memory) { RELEASE(&((adaptrack_head *)memory)->busy); }
