/* adaptrack: what both versions of the Functional Mock-up Interface share. A unit (adaptrack.core.units) is a vector of
   values and two kernels; a value reference is a place in that vector. Instances share nothing. */
#ifndef ADAPTRACK_FMU_H
#define ADAPTRACK_FMU_H
#include "adaptrack_memory.h"

#ifdef _WIN32
#define FMU_PUBLIC __declspec(dllexport)
#else
#define FMU_PUBLIC __attribute__((visibility("default")))
#endif

/* The numbers are those of fmi2Status and fmi3Status. */
typedef enum { FMU_OK = 0, FMU_WARNING = 1, FMU_ERROR = 3, FMU_FATAL = 4 } fmu_status;
typedef enum { FMU_MADE, FMU_SETTING, FMU_STEPPING, FMU_OVER, FMU_FAILED } fmu_mode;
/* What a value is: its type, whether it may be set, and whether it belongs to the array of the value before; as in
   adaptrack.export.units. */
enum { FMU_REAL = 0, FMU_WHOLE = 1, FMU_TRUTH = 2, FMU_TYPE = 3, FMU_PARAMETER = 4, FMU_INPUT = 8, FMU_ELEMENT = 32 };

typedef struct {
    uint64_t number;
    int64_t (*begin)(void *record);
    int64_t (*step)(void *record);
} fmu_unit;
typedef void (*fmu_member)(void);

/* fmu_units.c, which the export writes: the kernels at hand */
extern const uint64_t FMU_KERNELS;
extern const fmu_member FMU_MEMBERS[];
extern const size_t FMU_MEMBER_COUNT;
extern const fmu_unit FMU_UNITS[];
extern const size_t FMU_COUNT;
/* what is impossible in a trajectory, in the words of adaptrack.core.units.follower; the verdict on a fallback */
extern const char *const FMU_FLAWS[];
extern const int64_t FMU_BAD_FALLBACK;

typedef struct fmu fmu;
struct fmu {
    const fmu_unit *unit;
    void *constants, *room, *memory; /* the file; what malloc gave; the memory in it, from a cache line on */
    size_t size;
    double *values;
    const int64_t *kinds;
    const double *least, *most; /* of each parameter and input */
    size_t count; /* of values */
    double start; /* s, time of the first instant */
    double end;   /* s, at which the last step ended by the master's clock */
    fmu_mode mode;
    int stale; /* values were set since the outputs of the first instant were computed */
    /* the logger of the master, which each version calls in its way */
    void (*say)(const fmu *, fmu_status, const char *category, const char *text);
    void (*logger)(void);
    void *environment;
    char name[128];
};

/* A new instance from resources/constants.bin in a folder (UTF-8); 0, with a word to the logger, where there is none
   of these kernels or of this token. given: the logger's part of an instance. */
fmu *fmu_open(const fmu *given, const char *name, const char *token, const char *resources);
void fmu_free(fmu *);
fmu_status fmu_reset(fmu *);
fmu_status fmu_initialise(fmu *, double start);
fmu_status fmu_initialised(fmu *);
fmu_status fmu_terminate(fmu *);
/* Go on by a whole number of periods; FMU_WARNING, and a sentence to the logger, if a trajectory was refused. */
fmu_status fmu_step(fmu *, double time, double size);
fmu_status fmu_set(fmu *, uint32_t reference, int type, double value);
fmu_status fmu_get(fmu *, uint32_t reference, int type, double *value);
/* How many values a reference stands for: those of the array that begins there, else one. */
size_t fmu_length(const fmu *, uint32_t reference);
/* A state, in memory of its own where *state is null, and its bytes. */
fmu_status fmu_save(fmu *, void **state);
fmu_status fmu_restore(fmu *, const void *state);
fmu_status fmu_free_state(void **state);
fmu_status fmu_serialised_size(const fmu *, size_t *size);
fmu_status fmu_serialise(const fmu *, const void *state, void *bytes, size_t size);
fmu_status fmu_deserialise(const fmu *, const void *bytes, size_t size, void **state);
/* The status, and a sentence to the logger, formatted as by printf. */
fmu_status fmu_say(const fmu *, fmu_status status, const char *format, ...);
#define fmu_refuse(f, ...) fmu_say(f, FMU_ERROR, __VA_ARGS__)
#endif
