/* adaptrack: Functional Mock-up Interface 3.0, co-simulation. What a unit does not have answers fmi3Error. */
#include "fmu.h"

#include <stdbool.h>
#ifdef ADAPTRACK_STANDARD_HEADERS /* that the types are those of the standard, a compiler says with its headers */
#include "fmi3Functions.h"
#else
typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent
} fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String category, fmi3String message);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean, fmi3Boolean,
                                               fmi3Boolean, fmi3Boolean, fmi3Boolean *, fmi3Float64 *);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);
#endif
#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
#define PUBLIC(name) FMU_PUBLIC fmi3Status name
#define ME fmi3Instance instance
#define REFERENCES const fmi3ValueReference references[], size_t count
#define LACKS(name, ...) \
    PUBLIC(name)(ME, __VA_ARGS__) { return lacks(instance, #name); }
#define LACKS_VALUES(type) \
    PUBLIC(fmi3Get##type)(ME, REFERENCES, fmi3##type values[], size_t many) { return none(instance, count); } \
    PUBLIC(fmi3Set##type)(ME, REFERENCES, const fmi3##type values[], size_t many) { return none(instance, count); }
#define VALUES(type, kind, back) \
    PUBLIC(fmi3Get##type)(ME, REFERENCES, fmi3##type values[], size_t many) { \
        if (!fits(instance, references, count, values, many)) return fmi3Error; \
        for (size_t i = 0; i < count; i++) \
            for (size_t j = 0; j < fmu_length(instance, references[i]); j++) { \
                double value; \
                if (fmu_get(instance, references[i] + (uint32_t)j, kind, &value) != FMU_OK) return fmi3Error; \
                *values++ = (fmi3##type)(back); \
            } \
        return fmi3OK; \
    } \
    PUBLIC(fmi3Set##type)(ME, REFERENCES, const fmi3##type values[], size_t many) { \
        if (!fits(instance, references, count, values, many)) return fmi3Error; \
        for (size_t i = 0; i < count; i++) \
            for (size_t j = 0; j < fmu_length(instance, references[i]); j++) \
                if (fmu_set(instance, references[i] + (uint32_t)j, kind, (double)*values++) != FMU_OK) \
                    return fmi3Error; \
        return fmi3OK; \
    }

static fmi3Status lacks(fmi3Instance instance, const char *name) { return (fmi3Status)fmu_refuse(instance, "%s", name); }

static fmi3Status none(fmi3Instance instance, size_t count) {
    return count == 0 ? fmi3OK : (fmi3Status)fmu_refuse(instance, "there are no values of this type");
}

static int fits(fmi3Instance instance, REFERENCES, const void *values, size_t many) {
    const int is_given = instance && (count == 0 || (references && values));
    size_t length = 0;
    for (size_t i = 0; is_given && i < count; i++) length += fmu_length(instance, references[i]);
    if (is_given && length == many) return 1;
    fmu_refuse(instance, "values: a null pointer, or not as many values as the references stand for");
    return 0;
}

static void say(const fmu *f, fmu_status status, const char *category, const char *text) {
    if (f->logger) ((fmi3LogMessageCallback)f->logger)(f->environment, (fmi3Status)status, category, text);
}

/* -- an instance -------------------------------------------------------------------------------------------------- */
FMU_PUBLIC const char *fmi3GetVersion(void) { return "3.0"; }

PUBLIC(fmi3SetDebugLogging)(ME, fmi3Boolean on, size_t count, const fmi3String categories[]) {
    return instance ? fmi3OK : fmi3Error; /* errors and warnings are said, always */
}

FMU_PUBLIC fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference intermediate[], size_t count,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    fmu given = {0};
    given.say = say, given.logger = (void (*)(void))log, given.environment = environment;
    if (count > 0) {
        fmu_refuse(&given, "there are no intermediate variables");
        return NULL;
    }
    return fmu_open(&given, name, token, resources);
}

FMU_PUBLIC fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    return NULL;
}

FMU_PUBLIC fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback clock,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock) {
    return NULL;
}

FMU_PUBLIC void fmi3FreeInstance(ME) { fmu_free(instance); }

PUBLIC(fmi3EnterInitializationMode)(ME, fmi3Boolean tolerant, fmi3Float64 tolerance, fmi3Float64 start,
                                    fmi3Boolean stops, fmi3Float64 stop) {
    return instance ? (fmi3Status)fmu_initialise(instance, start) : fmi3Error;
}

PUBLIC(fmi3ExitInitializationMode)(ME) { return instance ? (fmi3Status)fmu_initialised(instance) : fmi3Error; }
PUBLIC(fmi3Terminate)(ME) { return instance ? (fmi3Status)fmu_terminate(instance) : fmi3Error; }
PUBLIC(fmi3Reset)(ME) { return instance ? (fmi3Status)fmu_reset(instance) : fmi3Error; }
PUBLIC(fmi3EnterStepMode)(ME) { return instance ? fmi3OK : fmi3Error; }

/* -- values ------------------------------------------------------------------------------------------------------- */
VALUES(Float64, FMU_REAL, value)
VALUES(Int64, FMU_WHOLE, value)
VALUES(Boolean, FMU_TRUTH, value > 0.5)
LACKS_VALUES(Float32)
LACKS_VALUES(Int8)
LACKS_VALUES(UInt8)
LACKS_VALUES(Int16)
LACKS_VALUES(UInt16)
LACKS_VALUES(Int32)
LACKS_VALUES(UInt32)
LACKS_VALUES(UInt64)
LACKS_VALUES(String)

PUBLIC(fmi3GetBinary)(ME, REFERENCES, size_t sizes[], fmi3Binary values[], size_t many) { return none(instance, count); }
PUBLIC(fmi3SetBinary)(ME, REFERENCES, const size_t sizes[], const fmi3Binary values[], size_t many) {
    return none(instance, count);
}
PUBLIC(fmi3GetClock)(ME, REFERENCES, fmi3Clock values[]) { return none(instance, count); }
PUBLIC(fmi3SetClock)(ME, REFERENCES, const fmi3Clock values[]) { return none(instance, count); }

/* -- steps -------------------------------------------------------------------------------------------------------- */
PUBLIC(fmi3DoStep)(ME, fmi3Float64 time, fmi3Float64 size, fmi3Boolean settled, fmi3Boolean *event,
                   fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    fmu_status status;
    if (!instance || !event || !terminate || !early || !last) return fmi3Error;
    status = fmu_step(instance, time, size);
    *event = false, *terminate = false, *early = false;
    *last = status <= FMU_WARNING ? time + size : time;
    return (fmi3Status)status;
}

/* -- the state ---------------------------------------------------------------------------------------------------- */
PUBLIC(fmi3GetFMUState)(ME, fmi3FMUState *state) { return (fmi3Status)fmu_save(instance, state); }
PUBLIC(fmi3SetFMUState)(ME, fmi3FMUState state) { return (fmi3Status)fmu_restore(instance, state); }
PUBLIC(fmi3FreeFMUState)(ME, fmi3FMUState *state) { return (fmi3Status)fmu_free_state(state); }

PUBLIC(fmi3SerializedFMUStateSize)(ME, fmi3FMUState state, size_t *size) {
    return (fmi3Status)fmu_serialised_size(instance, size);
}

PUBLIC(fmi3SerializeFMUState)(ME, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    return (fmi3Status)fmu_serialise(instance, state, bytes, size);
}

PUBLIC(fmi3DeserializeFMUState)(ME, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    return (fmi3Status)fmu_deserialise(instance, bytes, size, state);
}

/* -- what a unit does not have ------------------------------------------------------------------------------------ */
PUBLIC(fmi3EnterEventMode)(ME) { return lacks(instance, "fmi3EnterEventMode"); }
PUBLIC(fmi3EnterConfigurationMode)(ME) { return lacks(instance, "fmi3EnterConfigurationMode"); }
PUBLIC(fmi3ExitConfigurationMode)(ME) { return lacks(instance, "fmi3ExitConfigurationMode"); }
PUBLIC(fmi3EvaluateDiscreteStates)(ME) { return lacks(instance, "fmi3EvaluateDiscreteStates"); }
LACKS(fmi3UpdateDiscreteStates, fmi3Boolean *needed, fmi3Boolean *terminate, fmi3Boolean *nominals,
      fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next)
LACKS(fmi3GetNumberOfVariableDependencies, fmi3ValueReference reference, size_t *count)
LACKS(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t elements[], fmi3ValueReference independents[],
      size_t of[], fmi3DependencyKind kinds[], size_t count)
LACKS(fmi3GetDirectionalDerivative, const fmi3ValueReference unknowns[], size_t count,
      const fmi3ValueReference knowns[], size_t many, const fmi3Float64 seed[], size_t seeds,
      fmi3Float64 sensitivity[], size_t sensitivities)
LACKS(fmi3GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t count, const fmi3ValueReference knowns[],
      size_t many, const fmi3Float64 seed[], size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities)
LACKS(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[], size_t many)
LACKS(fmi3GetIntervalDecimal, REFERENCES, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
LACKS(fmi3GetIntervalFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
      fmi3IntervalQualifier qualifiers[])
LACKS(fmi3GetShiftDecimal, REFERENCES, fmi3Float64 shifts[])
LACKS(fmi3GetShiftFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
LACKS(fmi3SetIntervalDecimal, REFERENCES, const fmi3Float64 intervals[])
LACKS(fmi3SetIntervalFraction, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
LACKS(fmi3SetShiftDecimal, REFERENCES, const fmi3Float64 shifts[])
LACKS(fmi3SetShiftFraction, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
PUBLIC(fmi3EnterContinuousTimeMode)(ME) { return lacks(instance, "fmi3EnterContinuousTimeMode"); }
LACKS(fmi3CompletedIntegratorStep, fmi3Boolean settled, fmi3Boolean *event, fmi3Boolean *terminate)
LACKS(fmi3SetTime, fmi3Float64 time)
LACKS(fmi3SetContinuousStates, const fmi3Float64 states[], size_t count)
LACKS(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t count)
LACKS(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t count)
LACKS(fmi3GetContinuousStates, fmi3Float64 states[], size_t count)
LACKS(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t count)
LACKS(fmi3GetNumberOfEventIndicators, size_t *count)
LACKS(fmi3GetNumberOfContinuousStates, size_t *count)
LACKS(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)
