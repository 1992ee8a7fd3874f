/* A sampled controller as an FMI 3.0 co-simulation unit; see instance.h. */
#include "fmi3.h"

#include "instance.h"

typedef struct {
    controller_data data;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
} instance;

static fmi3Status report(const instance *self, const char *problem)
{
    if (problem == NULL) {
        return fmi3OK;
    }
    if (self->log != NULL) {
        self->log(self->environment, fmi3Error, "logStatusError", problem);
    }
    return fmi3Error;
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean loggingOn, size_t n, const fmi3String categories[])
{
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
                                         fmi3Boolean earlyReturnAllowed, const fmi3ValueReference intermediate[],
                                         size_t nIntermediate, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    instance *self = NULL;

    if (strcmp(token, MODEL_TOKEN) == 0) {
        self = calloc(1, sizeof *self);
    }
    if (self != NULL) {
        self->log = log;
        self->environment = environment;
        data_reset(&self->data);
    } else if (log != NULL) {
        log(environment, fmi3Error, "logStatusError", "no memory, or another instantiation token");
    }
    return self;
}

void fmi3FreeInstance(fmi3Instance c)
{
    free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    data_start(&((instance *)c)->data, startTime);
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance c)
{
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c)
{
    data_reset(&((instance *)c)->data);
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, fmi3Float64 values[], size_t n)
{
    return report(c, data_get(&((instance *)c)->data, vr, nvr, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t nvr, const fmi3Float64 values[],
                          size_t n)
{
    return report(c, data_set(&((instance *)c)->data, vr, nvr, values));
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn,
                      fmi3Float64 *lastSuccessfulTime)
{
    fmi3Status status = report(c, data_step(&((instance *)c)->data, t, h));

    if (status == fmi3OK && ((instance *)c)->data.fault) {
        const instance *self = c;

        status = fmi3Warning;
        if (self->log != NULL) {
            self->log(self->environment, status, "logStatusWarning", MODEL_HELD);
        }
    }
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    *lastSuccessfulTime = ((instance *)c)->data.time;
    return status;
}

/* All variables are Float64. */

#define NO_VARIABLES(type)                                                                                             \
    fmi3Status fmi3Get##type(fmi3Instance c, VARIABLES, fmi3##type values[], size_t n)                                 \
    {                                                                                                                  \
        return report(c, nvr == 0 ? NULL : "fmi3Get" #type ": all variables are of type Float64");                     \
    }                                                                                                                  \
    fmi3Status fmi3Set##type(fmi3Instance c, VARIABLES, const fmi3##type values[], size_t n)                           \
    {                                                                                                                  \
        return report(c, nvr == 0 ? NULL : "fmi3Set" #type ": all variables are of type Float64");                     \
    }

FMI3_ALL_BUT_FLOAT64(NO_VARIABLES)

/* Capabilities and interfaces that the model description does not claim. Version 3 wants all functions present. */

#define REFUSED(function, ...)                                                                                         \
    fmi3Status function(fmi3Instance c, __VA_ARGS__)                                                                   \
    {                                                                                                                  \
        return report(c, #function " is not provided");                                                                \
    }
#define REFUSED_MODE(function)                                                                                         \
    fmi3Status function(fmi3Instance c)                                                                                \
    {                                                                                                                  \
        return report(c, #function " is not provided");                                                                \
    }

REFUSED(fmi3GetBinary, VARIABLES, size_t sizes[], fmi3Binary values[], size_t n)
REFUSED(fmi3SetBinary, VARIABLES, const size_t sizes[], const fmi3Binary values[], size_t n)
REFUSED(fmi3GetClock, VARIABLES, fmi3Clock values[])
REFUSED(fmi3SetClock, VARIABLES, const fmi3Clock values[])
REFUSED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *n)
REFUSED(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t elements[],
        fmi3ValueReference independents[], size_t elementsOfIndependents[], fmi3DependencyKind kinds[], size_t n)
REFUSED(fmi3GetFMUState, fmi3FMUState *state)
REFUSED(fmi3SetFMUState, fmi3FMUState state)
REFUSED(fmi3FreeFMUState, fmi3FMUState *state)
REFUSED(fmi3SerializedFMUStateSize, fmi3FMUState state, size_t *size)
REFUSED(fmi3SerializeFMUState, fmi3FMUState state, fmi3Byte bytes[], size_t size)
REFUSED(fmi3DeserializeFMUState, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
REFUSED(fmi3GetDirectionalDerivative, const fmi3ValueReference unknowns[], size_t nUnknowns,
        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
        fmi3Float64 sensitivity[], size_t nSensitivity)
REFUSED(fmi3GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t nUnknowns,
        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
        fmi3Float64 sensitivity[], size_t nSensitivity)
REFUSED(fmi3GetOutputDerivatives, VARIABLES, const fmi3Int32 orders[], fmi3Float64 values[], size_t n)

REFUSED_MODE(fmi3EnterConfigurationMode)
REFUSED_MODE(fmi3ExitConfigurationMode)
REFUSED_MODE(fmi3EnterEventMode)
REFUSED_MODE(fmi3EnterStepMode)
REFUSED_MODE(fmi3EvaluateDiscreteStates)
REFUSED(fmi3UpdateDiscreteStates, fmi3Boolean *discrete, fmi3Boolean *terminate, fmi3Boolean *nominals,
        fmi3Boolean *values, fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)

REFUSED(fmi3GetIntervalDecimal, VARIABLES, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
REFUSED(fmi3GetIntervalFraction, VARIABLES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
        fmi3IntervalQualifier qualifiers[])
REFUSED(fmi3GetShiftDecimal, VARIABLES, fmi3Float64 shifts[])
REFUSED(fmi3GetShiftFraction, VARIABLES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
REFUSED(fmi3SetIntervalDecimal, VARIABLES, const fmi3Float64 intervals[])
REFUSED(fmi3SetIntervalFraction, VARIABLES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
REFUSED(fmi3SetShiftDecimal, VARIABLES, const fmi3Float64 shifts[])
REFUSED(fmi3SetShiftFraction, VARIABLES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
REFUSED(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)

REFUSED_MODE(fmi3EnterContinuousTimeMode)
REFUSED(fmi3CompletedIntegratorStep, fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *enterEventMode,
        fmi3Boolean *terminateSimulation)
REFUSED(fmi3SetTime, fmi3Float64 time)
REFUSED(fmi3SetContinuousStates, const fmi3Float64 states[], size_t n)
REFUSED(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t n)
REFUSED(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t n)
REFUSED(fmi3GetContinuousStates, fmi3Float64 states[], size_t n)
REFUSED(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t n)
REFUSED(fmi3GetNumberOfEventIndicators, size_t *n)
REFUSED(fmi3GetNumberOfContinuousStates, size_t *n)

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean loggingOn, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    return NULL;
}
