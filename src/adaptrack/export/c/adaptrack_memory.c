/* adaptrack: reads and writes files of constants and states. C99, no library, nothing static that is written. */
#include "adaptrack_memory.h"

#include <float.h>

enum { FORMAT = 2, CHECKSUM = 2, BEHIND_CHECKSUM = 24 };
static const uint64_t CONSTANTS = 0x004b434152544441u; /* "ADTRACK" */
static const uint64_t STATE = 0x0045544154534441u;     /* "ADSTATE" */
static const uint64_t MARK = 0x6b63617274706461u;      /* "adptrack" */

/* -- CRC-32 ------------------------------------------------------------------------------------------------------- */
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

/* -- files -------------------------------------------------------------------------------------------------------- */
uint64_t adaptrack_file_word(const adaptrack_file *file, size_t i) {
    uint64_t word = 0;
    for (int k = 0; k < 8; k++) {
        const size_t place = (size_t)(file->is_big_endian ? 7 - k : k);
        word |= (uint64_t)file->bytes[8u * i + place] << (8 * k);
    }
    return word;
}

static void put_word(unsigned char *bytes, size_t i, uint64_t word) {
    for (int k = 0; k < 8; k++) bytes[8u * i + (size_t)k] = (unsigned char)(word >> (8 * k) & 0xffu);
}

/* The CRC-32 of the words of a file as they are when little-endian. */
static uint32_t checksum_of(const adaptrack_file *file, size_t words) {
    uint32_t crc = 0xffffffffu;
    for (size_t i = CHECKSUM + 1; i < words; i++) {
        unsigned char bytes[8];
        put_word(bytes, 0, adaptrack_file_word(file, i));
        crc = crc_on(crc, bytes, sizeof bytes);
    }
    return ~crc;
}

static adaptrack_error read_file(adaptrack_file *file, const void *bytes, size_t size, uint64_t magic,
                                 uint64_t kernels) {
    if (!bytes) return ADAPTRACK_BAD_ARGUMENT;
    if (size < 8u * ADAPTRACK_FILE_HEAD || size % 8u != 0) return ADAPTRACK_DAMAGED;
    file->bytes = (const unsigned char *)bytes;
    file->is_big_endian = 0;
    if (adaptrack_file_word(file, 0) != magic) file->is_big_endian = 1;
    if (adaptrack_file_word(file, 0) != magic) return ADAPTRACK_DAMAGED;
    if (adaptrack_file_word(file, 1) != FORMAT) return ADAPTRACK_OTHER_VERSION;
    if (adaptrack_file_word(file, 5) != size / 8u - ADAPTRACK_FILE_HEAD) return ADAPTRACK_DAMAGED;
    if (checksum_of(file, size / 8u) != adaptrack_file_word(file, CHECKSUM)) return ADAPTRACK_DAMAGED;
    if (adaptrack_file_word(file, 3) != kernels) return ADAPTRACK_OTHER_VERSION;
    file->checksum = (uint32_t)adaptrack_file_word(file, CHECKSUM);
    file->id = adaptrack_file_word(file, 4);
    file->count = size / 8u - ADAPTRACK_FILE_HEAD;
    return ADAPTRACK_OK;
}

adaptrack_error adaptrack_read_constants(adaptrack_file *file, const void *bytes, size_t size, uint64_t kernels) {
    return read_file(file, bytes, size, CONSTANTS, kernels);
}

/* -- the memory --------------------------------------------------------------------------------------------------- */
int adaptrack_is_ready(const void *memory) {
    return memory && (uintptr_t)memory % 8u == 0 && ((const adaptrack_head *)memory)->mark == MARK;
}

void adaptrack_begin(adaptrack_head *head, const adaptrack_file *constants, uint64_t kernels, size_t state,
                     size_t count) {
    head->busy = 0, head->path = 0, head->points = 0, head->constants = constants->checksum;
    head->state = (uint32_t)state, head->count = (uint32_t)count, head->kernels = kernels;
    head->planner = head->reserved[0] = head->reserved[1] = 0;
    head->mark = MARK;
}

size_t adaptrack_saved_size(const void *memory) {
    return adaptrack_is_ready(memory) ? 8u * (ADAPTRACK_FILE_HEAD + ((const adaptrack_head *)memory)->count) : 0;
}

adaptrack_error adaptrack_save_state(const void *memory, void *state, size_t size) {
    const adaptrack_head *head = (const adaptrack_head *)memory;
    unsigned char *bytes = (unsigned char *)state;
    const uint64_t *words;
    if (!state) return ADAPTRACK_BAD_ARGUMENT;
    if (!adaptrack_is_ready(memory)) return ADAPTRACK_NOT_READY;
    if (size < adaptrack_saved_size(memory)) return ADAPTRACK_TOO_SMALL;
    words = (const uint64_t *)memory + head->state;
    put_word(bytes, 0, STATE);
    put_word(bytes, 1, FORMAT);
    put_word(bytes, 3, head->kernels);
    put_word(bytes, 4, head->constants | (uint64_t)head->path << 32);
    put_word(bytes, 5, head->count);
    for (size_t i = 0; i < head->count; i++) put_word(bytes, ADAPTRACK_FILE_HEAD + i, words[i]);
    put_word(bytes, CHECKSUM, adaptrack_crc32(bytes + BEHIND_CHECKSUM, adaptrack_saved_size(memory) - BEHIND_CHECKSUM));
    return ADAPTRACK_OK;
}

adaptrack_error adaptrack_restore_state(void *memory, const void *state, size_t size) {
    const adaptrack_head *head = (const adaptrack_head *)memory;
    adaptrack_file file;
    adaptrack_error error;
    uint64_t *words;
    if (!adaptrack_is_ready(memory)) return state ? ADAPTRACK_NOT_READY : ADAPTRACK_BAD_ARGUMENT;
    error = read_file(&file, state, size, STATE, head->kernels);
    if (error != ADAPTRACK_OK) return error;
    if ((uint32_t)file.id != head->constants || file.count != head->count) return ADAPTRACK_OTHER_CONSTANTS;
    if (file.id >> 32 != head->path) return ADAPTRACK_OTHER_PATH;
    words = (uint64_t *)memory + head->state;
    for (size_t i = 0; i < file.count; i++) words[i] = adaptrack_file_word(&file, ADAPTRACK_FILE_HEAD + i);
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

/* The compiler must be told to leave each operation as it is written, see the options in the Makefile. */
adaptrack_error adaptrack_compiled_exactly(void) {
    static const double X[6] = {1.0 + 0x1p-30, 1.0 + 0x1p-29, 1.0 - 0x1p-30, 1.0 - 0x1p-29, 1.0, -1.0};
    static const double TERMS[8] = {1.0, 0x1p-60, -1.0, 0x1p-60, 0.0, 0.0, 0.0, 0.0};
    void (*volatile opaque)(const double *, const double *, int, double *) = compute;
    double y[3];
    opaque(X, TERMS, 8, y);
    return y[0] == 0.0 && y[1] == 0.0 && y[2] == 0x1p-60 ? ADAPTRACK_OK : ADAPTRACK_ARITHMETIC;
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

adaptrack_error adaptrack_take(void *memory) {
    if (!adaptrack_is_ready(memory)) return ADAPTRACK_NOT_READY;
    return EXCHANGE(&((adaptrack_head *)memory)->busy, 1u) == 0u ? ADAPTRACK_OK : ADAPTRACK_BUSY;
}

void adaptrack_give(void *memory) { RELEASE(&((adaptrack_head *)memory)->busy); }
