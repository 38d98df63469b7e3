/* adaptrack: a unit of co-simulation, whichever version of the interface asks. C99 and of its library malloc, free,
   fopen, fread, fclose, vsnprintf. */
#include "fmu.h"

#include <float.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <windows.h>
#endif

enum { TIME = 0, PERIOD = 1 };
enum { FAILED = 1, NO_DELAY = 2, REFUSED = 3 }; /* adaptrack.core.units.contract */
static const double CLOSE = 1e-6;  /* share of a period by which times of the master may be off, */
static const double ROUNDING = 4.0 * DBL_EPSILON; /* and share of a time by which rounding moves it */
enum { LINE = 64, LONGEST = 100000000 };
static const char *const SAYS[] = {
    "", "a null pointer or a wrong size", "too little memory", "not initialised", "another thread is in this instance",
    "constants or state are damaged", "resources/constants.bin is of another version of adaptrack",
    "resources/constants.bin is of another kind", "resources/constants.bin has other sizes",
    "the state was saved under other constants", "the state was saved on another path",
    "the processor does not round to nearest or takes subnormal numbers for zero, or the compiler reordered operations"};

fmu_status fmu_say(const fmu *f, fmu_status status, const char *format, ...) {
    char text[320];
    va_list values;
    va_start(values, format);
    vsnprintf(text, sizeof text, format, values);
    va_end(values);
    if (f && f->say) f->say(f, status, status == FMU_WARNING ? "logStatusWarning" : "logStatusError", text);
    return status;
}

/* Time of the present instant, s. */
static double now(const fmu *f) { return f->start + f->values[TIME]; }

static fmu_status refuse_status(const fmu *f, adaptrack_error status) {
    return status == ADAPTRACK_OK ? FMU_OK
                                  : fmu_refuse(f, "%s", status < sizeof SAYS / sizeof *SAYS ? SAYS[status] : "refused");
}

static fmu_status refuse_value(const fmu *f, const char *what, uint32_t reference) {
    return fmu_refuse(f, "at t = %.15g s the value with reference %lu %s", now(f), (unsigned long)reference, what);
}

static fmu_status refuse_range(const fmu *f, size_t i) {
    return fmu_refuse(f, "at t = %.15g s the value with reference %lu is %.9g: it must be finite and from %.9g to %.9g",
                      now(f), (unsigned long)i, f->values[i], f->least[i], f->most[i]);
}

/* -- the processor ------------------------------------------------------------------------------------------------ */
#ifdef ADAPTRACK_NEEDS_AVX2
#include <cpuid.h>
static int fits(void) {
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & (1u << 12 | 1u << 27 | 1u << 28)) != (1u << 12 | 1u << 27 | 1u << 28))
        return 0; /* FMA, and an operating system that keeps the registers of AVX */
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return (low & 6u) == 6u && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & 1u << 5) != 0;
}
#else
static int fits(void) { return 1; }
#endif

/* -- the constants ------------------------------------------------------------------------------------------------ */
static FILE *opened(const char *path) {
#ifdef _WIN32
    wchar_t wide[1024];
    return MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, 1024) > 0 ? _wfopen(wide, L"rb") : NULL;
#else
    return fopen(path, "rb");
#endif
}

static void *contents(const char *folder, size_t *size) {
    static const char NAME[] = "/constants.bin";
    size_t length = strlen(folder);
    char *path = malloc(length + sizeof NAME), *found = NULL;
    FILE *file;
    if (!path) return NULL;
    memcpy(path, folder, length);
    memcpy(path + length, NAME, sizeof NAME);
    file = opened(path);
    free(path);
    if (!file) return NULL;
    if (fseek(file, 0, SEEK_END) == 0) {
        long end = ftell(file);
        if (end > 0 && end < LONGEST && fseek(file, 0, SEEK_SET) == 0) {
            *size = (size_t)end;
            found = malloc(*size);
            if (found && fread(found, 1, *size, file) != *size) free(found), found = NULL;
        }
    }
    fclose(file);
    return found;
}

/* Whether a token is that of the constants: their CRC-32, as adaptrack.export.fmu writes it. */
static int is_of(const char *token, const void *constants, size_t size) {
    char own[16];
    snprintf(own, sizeof own, "{%08lx}", (unsigned long)adaptrack_crc32(constants, size));
    return token && strcmp(token, own) == 0;
}

/* -- an instance -------------------------------------------------------------------------------------------------- */
/* The words of the constants (adaptrack.export.fmu): those of the memory, where its state begins, places and links,
   then which word holds which address, and the memory. */
enum { WORDS = ADAPTRACK_FILE_HEAD, STATE, PLACES, LINKS, FIXES, HEAD_WORDS = sizeof(adaptrack_head) / 8 };

static uint64_t *words_of(const fmu *f) { return (uint64_t *)f->memory + HEAD_WORDS; }

/* Read the constants; ADAPTRACK_OTHER_KIND where they are of no unit at hand. */
static adaptrack_error read_constants(fmu *f, adaptrack_file *file) {
    adaptrack_error status = adaptrack_read_constants(file, f->constants, f->size, FMU_KERNELS);
    f->unit = NULL;
    for (size_t i = 0; i < FMU_COUNT; i++)
        if (status == ADAPTRACK_OK && FMU_UNITS[i].number == file->id) f->unit = FMU_UNITS + i;
    return status == ADAPTRACK_OK && !f->unit ? ADAPTRACK_OTHER_KIND : status;
}

static size_t memory_size(const adaptrack_file *file) {
    return sizeof(adaptrack_head) + 8u * (size_t)adaptrack_file_word(file, WORDS);
}

static fmu_status lay(fmu *f) {
    adaptrack_file file;
    adaptrack_error status = read_constants(f, &file);
    uint64_t *words = words_of(f);
    size_t count, state, places, fixes;
    if (status != ADAPTRACK_OK) return refuse_status(f, status);
    count = (size_t)adaptrack_file_word(&file, WORDS), state = (size_t)adaptrack_file_word(&file, STATE);
    places = (size_t)adaptrack_file_word(&file, PLACES), fixes = places + (size_t)adaptrack_file_word(&file, LINKS);
    for (size_t i = 0; i < count; i++) words[i] = adaptrack_file_word(&file, FIXES + fixes + i);
    for (size_t i = 0; i < fixes; i++) {
        const uint64_t fix = adaptrack_file_word(&file, FIXES + i);
        const size_t number = (size_t)(fix >> 32);
        words[fix & 0xffffffffu] = i < places ? (uint64_t)(uintptr_t)(words + number)
                                              : (uint64_t)(uintptr_t)FMU_MEMBERS[number % FMU_MEMBER_COUNT];
    }
    adaptrack_begin((adaptrack_head *)f->memory, &file, FMU_KERNELS, HEAD_WORDS + state, count - state);
    status = adaptrack_arithmetic();
    if (status == ADAPTRACK_OK) status = adaptrack_compiled_exactly();
    if (status != ADAPTRACK_OK) return refuse_status(f, status);
    f->values = (double *)(uintptr_t)words[0], f->count = (size_t)words[1];
    f->kinds = (const int64_t *)(uintptr_t)words[2];
    f->least = (const double *)(uintptr_t)words[4], f->most = (const double *)(uintptr_t)words[6];
    f->mode = FMU_MADE, f->stale = 1, f->start = f->end = 0.0;
    return words[3] == words[1] && f->count > PERIOD && f->values[PERIOD] > 0.0 ? FMU_OK : refuse_status(f, 5);
}

fmu *fmu_open(const fmu *given, const char *name, const char *token, const char *resources) {
    fmu *f = calloc(1, sizeof *f);
    if (!f) return NULL;
    *f = *given;
    snprintf(f->name, sizeof f->name, "%s", name ? name : "");
    f->constants = resources ? contents(resources, &f->size) : NULL;
    if (!fits()) {
        fmu_refuse(f, "the processor has no AVX2 and FMA, for which this FMU is built");
    } else if (!f->constants) {
        fmu_refuse(f, "resources/constants.bin is not there");
    } else if (!is_of(token, f->constants, f->size)) {
        fmu_refuse(f, "the token in modelDescription.xml is not that of resources/constants.bin");
    } else {
        adaptrack_file file;
        if (refuse_status(f, read_constants(f, &file)) == FMU_OK) {
            f->room = malloc(memory_size(&file) + LINE);
            if (f->room) {
                f->memory = (char *)f->room + (LINE - (uintptr_t)f->room % LINE) % LINE;
                if (lay(f) == FMU_OK) return f;
            } else {
                refuse_status(f, ADAPTRACK_TOO_SMALL);
            }
        }
    }
    fmu_free(f);
    return NULL;
}

void fmu_free(fmu *f) {
    if (!f) return;
    free(f->room);
    free(f->constants);
    free(f);
}

fmu_status fmu_reset(fmu *f) { return lay(f); }

/* -- a run -------------------------------------------------------------------------------------------------------- */
/* The last step has refused a trajectory. The last values are the verdict, what is impossible, and its point. */
static fmu_status warn_of_trajectory(const fmu *f) {
    const double *last = f->values + f->count - 3;
    return fmu_say(f, FMU_WARNING, "at t = %.15g s the %s is refused, and the car goes on as before: point %d: %s",
                   now(f) - f->values[PERIOD], (int64_t)last[0] == FMU_BAD_FALLBACK ? "fallback" : "trajectory",
                   (int)last[2], FMU_FLAWS[(size_t)last[1]]);
}

/* What a kernel of the unit answered. */
static fmu_status judged(fmu *f, int64_t status) {
    if (status == 0) return FMU_OK;
    if (status < 0) return refuse_range(f, (size_t)(-1 - status));
    if (status == REFUSED) return warn_of_trajectory(f);
    if (status == NO_DELAY)
        return fmu_refuse(f, "parallel_exchange: there is no whole period of delay that the exchange could stand for");
    f->mode = FMU_FAILED;
    return fmu_refuse(f, "the state is not finite any more at t = %.15g s", now(f));
}

/* Call one of the unit's kernels. */
static fmu_status run(fmu *f, int64_t (*kernel)(void *)) {
    adaptrack_error status = adaptrack_take(f->memory);
    int64_t answer;
    if (status != ADAPTRACK_OK) return refuse_status(f, status);
    answer = kernel(words_of(f));
    adaptrack_give(f->memory);
    return judged(f, answer);
}

/* The outputs of the first instant, if they are not those of the values at hand. */
static fmu_status settled(fmu *f) {
    fmu_status status = FMU_OK;
    if (f->stale) status = run(f, f->unit->begin);
    if (status == FMU_OK) f->stale = 0;
    return status;
}

fmu_status fmu_initialise(fmu *f, double start) {
    if (f->mode != FMU_MADE) return fmu_refuse(f, "initialised already: reset first");
    if (!(start - start == 0.0)) return fmu_refuse(f, "the start time is %g: it must be finite", start);
    f->start = f->end = start, f->mode = FMU_SETTING;
    return FMU_OK;
}

fmu_status fmu_initialised(fmu *f) {
    fmu_status status;
    if (f->mode != FMU_SETTING) return fmu_refuse(f, "not in initialization mode");
    status = settled(f);
    if (status == FMU_OK) f->mode = FMU_STEPPING;
    return status;
}

fmu_status fmu_terminate(fmu *f) {
    if (f->mode < FMU_STEPPING) return fmu_refuse(f, "not initialised");
    f->mode = FMU_OVER;
    return FMU_OK;
}

/* Whether two times of the master, or two lengths of a step, are one but for rounding. */
static int same(double a, double b, double time, double period) {
    double apart = a < b ? b - a : a - b;
    return apart <= CLOSE * period + ROUNDING * (time < 0.0 ? -time : time);
}

fmu_status fmu_step(fmu *f, double time, double size) {
    double period = f->values[PERIOD], periods = size / period;
    long count = periods > 0.5 && periods < 1e6 ? (long)(periods + 0.5) : 0;
    fmu_status worst = FMU_OK;
    if (f->mode != FMU_STEPPING)
        return fmu_refuse(f, "a step at t = %.15g s, before initialization or after the end", time);
    if (!same(time, f->end, time, period))
        return fmu_refuse(f, "the step begins at t = %.15g s: it must begin where the last one ended, at %.15g s", time,
                          f->end);
    if (count == 0 || !same(size, (double)count * period, time, period))
        return fmu_refuse(f,
                          "the step at t = %.15g s is %.15g s long: it must be a whole number of periods, fewer than a "
                          "million, of %.9g s (fixedInternalStepSize)",
                          time, size, period);
    for (; count > 0; count--) {
        fmu_status status = run(f, f->unit->step);
        if (status > FMU_WARNING) return status;
        if (status > worst) worst = status;
    }
    f->end = time + size;
    return worst;
}

fmu_status fmu_set(fmu *f, uint32_t reference, int type, double value) {
    const char *wrong = NULL;
    if (reference >= f->count || (f->kinds[reference] & FMU_TYPE) != type)
        wrong = "it does not exist, or is of another type";
    else if (!(f->kinds[reference] & (FMU_INPUT | FMU_PARAMETER)))
        wrong = "it is computed";
    else if (f->mode > FMU_STEPPING || (f->mode == FMU_STEPPING && !(f->kinds[reference] & FMU_INPUT)))
        wrong = "not after initialization, or not after the end";
    if (wrong)
        return fmu_refuse(f, "at t = %.15g s the value with reference %lu cannot be set to %.9g: %s", now(f),
                          (unsigned long)reference, value, wrong);
    f->values[reference] = value;
    f->stale = f->mode != FMU_STEPPING;
    return FMU_OK;
}

fmu_status fmu_get(fmu *f, uint32_t reference, int type, double *value) {
    if (reference >= f->count || (f->kinds[reference] & FMU_TYPE) != type)
        return refuse_value(f, "does not exist, or is of another type", reference);
    if (f->mode == FMU_SETTING && settled(f) != FMU_OK) return FMU_ERROR;
    *value = reference == TIME ? now(f) : f->values[reference];
    return FMU_OK;
}

size_t fmu_length(const fmu *f, uint32_t reference) {
    size_t length = 1;
    while (reference < f->count && reference + length < f->count && (f->kinds[reference + length] & FMU_ELEMENT)) length++;
    return length;
}

/* -- its state: size, mode, stale, start, end, CRC-32 of these, then the memory's ------------------------------------- */
typedef struct {
    uint64_t size;
    int64_t mode, stale;
    double start, end;
    uint64_t sum;
} saved;

static size_t state_size(const fmu *f) { return sizeof(saved) + adaptrack_saved_size(f->memory); }

/* Memory for a state, unless the master brings some. */
static fmu_status provide(const fmu *f, void **state) {
    if (!*state) *state = malloc(state_size(f));
    return *state ? FMU_OK : fmu_refuse(f, "no memory");
}

fmu_status fmu_save(fmu *f, void **state) {
    saved head;
    if (!f || !state || provide(f, state) != FMU_OK) return FMU_ERROR;
    head.size = state_size(f), head.mode = (int64_t)f->mode, head.stale = f->stale;
    head.start = f->start, head.end = f->end;
    head.sum = adaptrack_crc32(&head, offsetof(saved, sum));
    memcpy(*state, &head, sizeof head);
    return refuse_status(f, adaptrack_save_state(f->memory, (char *)*state + sizeof head,
                                                 (size_t)head.size - sizeof head));
}

fmu_status fmu_restore(fmu *f, const void *state) {
    saved head;
    fmu_status status;
    if (!f) return FMU_ERROR;
    if (!state) return refuse_status(f, ADAPTRACK_BAD_ARGUMENT);
    memcpy(&head.size, state, sizeof head.size);
    if (head.size != state_size(f)) return fmu_refuse(f, "the state is of another FMU");
    memcpy(&head, state, sizeof head);
    if (head.sum != adaptrack_crc32(&head, offsetof(saved, sum))) return fmu_refuse(f, "the state is damaged");
    status = refuse_status(f, adaptrack_restore_state(f->memory, (const char *)state + sizeof head,
                                                       (size_t)head.size - sizeof head));
    if (status != FMU_OK) return status;
    f->mode = (fmu_mode)head.mode, f->stale = (int)head.stale, f->start = head.start, f->end = head.end;
    return FMU_OK;
}

fmu_status fmu_free_state(void **state) {
    if (!state) return FMU_ERROR;
    free(*state);
    *state = NULL;
    return FMU_OK;
}

fmu_status fmu_serialised_size(const fmu *f, size_t *size) {
    if (!f || !size) return FMU_ERROR;
    *size = state_size(f);
    return FMU_OK;
}

fmu_status fmu_serialise(const fmu *f, const void *state, void *bytes, size_t size) {
    if (!f || !state || !bytes || size < state_size(f)) return FMU_ERROR;
    memcpy(bytes, state, state_size(f));
    return FMU_OK;
}

fmu_status fmu_deserialise(const fmu *f, const void *bytes, size_t size, void **state) {
    if (!f || !bytes || !state || size != state_size(f)) return fmu_refuse(f, "the state is of another FMU");
    if (provide(f, state) != FMU_OK) return FMU_ERROR;
    memcpy(*state, bytes, size);
    return FMU_OK;
}
