/* adaptrack: Functional Mock-up Interface 2.0, co-simulation. What a unit does not have answers fmi2Error. */
#include "fmu.h"

#include <stdlib.h>
#include <string.h>
#ifdef ADAPTRACK_STANDARD_HEADERS /* that the types are those of the standard, a compiler says with its headers */
#include "fmi2Functions.h"
#else
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef void (*fmi2CallbackLogger)(fmi2ComponentEnvironment, fmi2String name, fmi2Status, fmi2String category,
                                   fmi2String message, ...);
typedef struct {
    fmi2CallbackLogger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
#endif
#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
#define PUBLIC(name) FMU_PUBLIC fmi2Status name
#define ME fmi2Component me
#define REFERENCES const fmi2ValueReference references[], size_t count
#define LACKS(name, ...) \
    PUBLIC(name)(ME, __VA_ARGS__) { return (fmi2Status)fmu_refuse(me, #name); }
#define VALUES(type, kind, back) \
    PUBLIC(fmi2Get##type)(ME, REFERENCES, fmi2##type values[]) { \
        if (!fits(me, references, count, values)) return fmi2Error; \
        for (size_t i = 0; i < count; i++) { \
            double value; \
            if (fmu_get(me, references[i], kind, &value) != FMU_OK) return fmi2Error; \
            values[i] = (fmi2##type)(back); \
        } \
        return fmi2OK; \
    } \
    PUBLIC(fmi2Set##type)(ME, REFERENCES, const fmi2##type values[]) { \
        if (!fits(me, references, count, values)) return fmi2Error; \
        for (size_t i = 0; i < count; i++) \
            if (fmu_set(me, references[i], kind, (double)values[i]) != FMU_OK) return fmi2Error; \
        return fmi2OK; \
    }

static int fits(fmi2Component me, const void *references, size_t count, const void *values) {
    if (me && (count == 0 || (references && values))) return 1;
    fmu_refuse(me, "values: a null pointer");
    return 0;
}

static void say(const fmu *f, fmu_status status, const char *category, const char *text) {
    if (f->logger)
        ((fmi2CallbackLogger)f->logger)(f->environment, f->name, (fmi2Status)status, category, "%s", text);
}

/* -- the folder of the resources ---------------------------------------------------------------------------------- */
static int digit(char c) {
    return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* The path of a file URI (RFC 8089), into memory of the caller, to be freed. */
static char *path_of(const char *uri) {
    char *path, *to;
    if (!uri) return NULL;
    if (strncmp(uri, "file:", 5) == 0) uri += 5;
    if (strncmp(uri, "//localhost/", 12) == 0) uri += 11;
    if (strncmp(uri, "///", 3) == 0) uri += 2;
#ifdef _WIN32
    if (uri[0] == '/' && uri[1] != '\0' && uri[2] == ':') uri++; /* /C:/... */
#endif
    path = to = malloc(strlen(uri) + 1);
    if (!path) return NULL;
    while (*uri) {
        if (uri[0] == '%' && digit(uri[1]) >= 0 && digit(uri[2]) >= 0) {
            *to++ = (char)(16 * digit(uri[1]) + digit(uri[2]));
            uri += 3;
        } else {
            *to++ = *uri++;
        }
    }
    *to = '\0';
    return path;
}

/* -- an instance -------------------------------------------------------------------------------------------------- */
FMU_PUBLIC const char *fmi2GetTypesPlatform(void) { return "default"; }
FMU_PUBLIC const char *fmi2GetVersion(void) { return "2.0"; }

PUBLIC(fmi2SetDebugLogging)(ME, fmi2Boolean on, size_t count, const fmi2String categories[]) {
    return me ? fmi2OK : fmi2Error; /* errors and warnings are said, always */
}

FMU_PUBLIC fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                                         const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                         fmi2Boolean logging) {
    fmu given = {0}, *made;
    char *path;
    if (functions)
        given.say = say, given.logger = (void (*)(void))functions->logger,
        given.environment = functions->componentEnvironment;
    if (type != fmi2CoSimulation) {
        fmu_refuse(&given, "co-simulation alone");
        return NULL;
    }
    path = path_of(resources);
    made = fmu_open(&given, name, token, path);
    free(path);
    return made;
}

FMU_PUBLIC void fmi2FreeInstance(ME) { fmu_free(me); }

PUBLIC(fmi2SetupExperiment)(ME, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start, fmi2Boolean stops,
                            fmi2Real stop) {
    fmu *f = me;
    if (!f) return fmi2Error;
    if (f->mode != FMU_MADE || !(start - start == 0.0))
        return (fmi2Status)fmu_refuse(f, "fmi2SetupExperiment: the start time is %g: it must be finite, and come before "
                                         "initialization", start);
    f->start = start;
    return fmi2OK;
}

PUBLIC(fmi2EnterInitializationMode)(ME) {
    return me ? (fmi2Status)fmu_initialise(me, ((const fmu *)me)->start) : fmi2Error;
}
PUBLIC(fmi2ExitInitializationMode)(ME) { return me ? (fmi2Status)fmu_initialised(me) : fmi2Error; }
PUBLIC(fmi2Terminate)(ME) { return me ? (fmi2Status)fmu_terminate(me) : fmi2Error; }
PUBLIC(fmi2Reset)(ME) { return me ? (fmi2Status)fmu_reset(me) : fmi2Error; }

/* -- values ------------------------------------------------------------------------------------------------------- */
VALUES(Real, FMU_REAL, value)
VALUES(Integer, FMU_WHOLE, value > 2147483647.0 ? 2147483647.0 : value)
VALUES(Boolean, FMU_TRUTH, value > 0.5)

PUBLIC(fmi2GetString)(ME, REFERENCES, fmi2String values[]) {
    return count == 0 ? fmi2OK : (fmi2Status)fmu_refuse(me, "there are no strings");
}
PUBLIC(fmi2SetString)(ME, REFERENCES, const fmi2String values[]) {
    return count == 0 ? fmi2OK : (fmi2Status)fmu_refuse(me, "there are no strings");
}

/* -- steps -------------------------------------------------------------------------------------------------------- */
PUBLIC(fmi2DoStep)(ME, fmi2Real time, fmi2Real size, fmi2Boolean settled) {
    return me ? (fmi2Status)fmu_step(me, time, size) : fmi2Error;
}

/* -- the state ---------------------------------------------------------------------------------------------------- */
PUBLIC(fmi2GetFMUstate)(ME, fmi2FMUstate *state) { return (fmi2Status)fmu_save(me, state); }
PUBLIC(fmi2SetFMUstate)(ME, fmi2FMUstate state) { return (fmi2Status)fmu_restore(me, state); }
PUBLIC(fmi2FreeFMUstate)(ME, fmi2FMUstate *state) { return (fmi2Status)fmu_free_state(state); }

PUBLIC(fmi2SerializedFMUstateSize)(ME, fmi2FMUstate state, size_t *size) {
    return (fmi2Status)fmu_serialised_size(me, size);
}

PUBLIC(fmi2SerializeFMUstate)(ME, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    return (fmi2Status)fmu_serialise(me, state, bytes, size);
}

PUBLIC(fmi2DeSerializeFMUstate)(ME, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    return (fmi2Status)fmu_deserialise(me, bytes, size, state);
}

/* -- what a unit does not have ------------------------------------------------------------------------------------ */
PUBLIC(fmi2CancelStep)(ME) { return (fmi2Status)fmu_refuse(me, "fmi2CancelStep"); }
LACKS(fmi2GetDirectionalDerivative, const fmi2ValueReference unknowns[], size_t count,
      const fmi2ValueReference knowns[], size_t many, const fmi2Real seed[], fmi2Real sensitivity[])
LACKS(fmi2SetRealInputDerivatives, REFERENCES, const fmi2Integer orders[], const fmi2Real values[])
LACKS(fmi2GetRealOutputDerivatives, REFERENCES, const fmi2Integer orders[], fmi2Real values[])
LACKS(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
LACKS(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
LACKS(fmi2GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
LACKS(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)

PUBLIC(fmi2GetRealStatus)(ME, const fmi2StatusKind kind, fmi2Real *value) {
    if (!me || !value || kind != fmi2LastSuccessfulTime) return fmi2Error;
    *value = ((const fmu *)me)->start + ((const fmu *)me)->values[0];
    return fmi2OK;
}
