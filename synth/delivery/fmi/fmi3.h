/*
 * The interface of an FMI 3.0.2 unit, all of whose functions must be present whatever it can do. Names, sizes, orders
 * and signatures are those of the specification, since a simulator calls the binary by them.
 */
#ifndef FMI3_H
#define FMI3_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "instance.h" /* EXPORT */

#define fmi3Version "3.0"
#define fmi3False false

typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef int16_t fmi3Int16;
typedef int32_t fmi3Int32;
typedef int64_t fmi3Int64;
typedef uint8_t fmi3UInt8, fmi3Byte;
typedef uint16_t fmi3UInt16;
typedef uint32_t fmi3UInt32;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef const fmi3Byte *fmi3Binary;

typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum { fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent } fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;

typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String category, fmi3String message);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64 time, fmi3Boolean setRequested,
                                               fmi3Boolean getAllowed, fmi3Boolean stepFinished,
                                               fmi3Boolean canReturnEarly, fmi3Boolean *earlyReturnRequested,
                                               fmi3Float64 *earlyReturnTime);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);

EXPORT const char *fmi3GetVersion(void);
EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance, fmi3Boolean loggingOn, size_t, const fmi3String categories[]);

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                 fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment,
                                                 fmi3LogMessageCallback);
EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
                                                fmi3Boolean earlyReturnAllowed, const fmi3ValueReference intermediate[],
                                                size_t, fmi3InstanceEnvironment, fmi3LogMessageCallback,
                                                fmi3IntermediateUpdateCallback);
EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean loggingOn,
                                                      fmi3InstanceEnvironment, fmi3LogMessageCallback,
                                                      fmi3ClockUpdateCallback, fmi3LockPreemptionCallback,
                                                      fmi3UnlockPreemptionCallback);
EXPORT void fmi3FreeInstance(fmi3Instance);
EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                              fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime);
EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance);
EXPORT fmi3Status fmi3Terminate(fmi3Instance);
EXPORT fmi3Status fmi3Reset(fmi3Instance);

#define VARIABLES const fmi3ValueReference vr[], size_t nvr
#define FMI3_ACCESS(type)                                                                                              \
    EXPORT fmi3Status fmi3Get##type(fmi3Instance, VARIABLES, fmi3##type[], size_t);                                    \
    EXPORT fmi3Status fmi3Set##type(fmi3Instance, VARIABLES, const fmi3##type[], size_t);
#define FMI3_ALL_BUT_FLOAT64(action)                                                                                   \
    action(Float32) action(Int8) action(UInt8) action(Int16) action(UInt16) action(Int32) action(UInt32)               \
        action(Int64) action(UInt64) action(Boolean) action(String)

FMI3_ACCESS(Float64)
FMI3_ALL_BUT_FLOAT64(FMI3_ACCESS)
EXPORT fmi3Status fmi3GetBinary(fmi3Instance, VARIABLES, size_t sizes[], fmi3Binary[], size_t);
EXPORT fmi3Status fmi3SetBinary(fmi3Instance, VARIABLES, const size_t sizes[], const fmi3Binary[], size_t);
EXPORT fmi3Status fmi3GetClock(fmi3Instance, VARIABLES, fmi3Clock[]);
EXPORT fmi3Status fmi3SetClock(fmi3Instance, VARIABLES, const fmi3Clock[]);

EXPORT fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance, fmi3ValueReference, size_t *);
EXPORT fmi3Status fmi3GetVariableDependencies(fmi3Instance, fmi3ValueReference dependent, size_t elements[],
                                              fmi3ValueReference independents[], size_t elementsOfIndependents[],
                                              fmi3DependencyKind[], size_t);
EXPORT fmi3Status fmi3GetFMUState(fmi3Instance, fmi3FMUState *);
EXPORT fmi3Status fmi3SetFMUState(fmi3Instance, fmi3FMUState);
EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance, fmi3FMUState *);
EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance, fmi3FMUState, size_t *);
EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance, fmi3FMUState, fmi3Byte[], size_t);
EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance, const fmi3Byte[], size_t, fmi3FMUState *);
EXPORT fmi3Status fmi3GetDirectionalDerivative(fmi3Instance, const fmi3ValueReference unknowns[], size_t,
                                               const fmi3ValueReference knowns[], size_t, const fmi3Float64 seed[],
                                               size_t, fmi3Float64 sensitivity[], size_t);
EXPORT fmi3Status fmi3GetAdjointDerivative(fmi3Instance, const fmi3ValueReference unknowns[], size_t,
                                           const fmi3ValueReference knowns[], size_t, const fmi3Float64 seed[], size_t,
                                           fmi3Float64 sensitivity[], size_t);
EXPORT fmi3Status fmi3GetOutputDerivatives(fmi3Instance, VARIABLES, const fmi3Int32 orders[], fmi3Float64[], size_t);
EXPORT fmi3Status fmi3DoStep(fmi3Instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                             fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                             fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime);

EXPORT fmi3Status fmi3EnterConfigurationMode(fmi3Instance);
EXPORT fmi3Status fmi3ExitConfigurationMode(fmi3Instance);
EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance);
EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance);
EXPORT fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance);
EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance, fmi3Boolean *discrete, fmi3Boolean *terminate,
                                           fmi3Boolean *nominals, fmi3Boolean *values,
                                           fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime);
EXPORT fmi3Status fmi3GetIntervalDecimal(fmi3Instance, VARIABLES, fmi3Float64[], fmi3IntervalQualifier[]);
EXPORT fmi3Status fmi3GetIntervalFraction(fmi3Instance, VARIABLES, fmi3UInt64 counters[],
                                          fmi3UInt64 resolutions[], fmi3IntervalQualifier[]);
EXPORT fmi3Status fmi3GetShiftDecimal(fmi3Instance, VARIABLES, fmi3Float64[]);
EXPORT fmi3Status fmi3GetShiftFraction(fmi3Instance, VARIABLES, fmi3UInt64 counters[], fmi3UInt64 resolutions[]);
EXPORT fmi3Status fmi3SetIntervalDecimal(fmi3Instance, VARIABLES, const fmi3Float64[]);
EXPORT fmi3Status fmi3SetIntervalFraction(fmi3Instance, VARIABLES, const fmi3UInt64 counters[],
                                          const fmi3UInt64 resolutions[]);
EXPORT fmi3Status fmi3SetShiftDecimal(fmi3Instance, VARIABLES, const fmi3Float64[]);
EXPORT fmi3Status fmi3SetShiftFraction(fmi3Instance, VARIABLES, const fmi3UInt64 counters[],
                                       const fmi3UInt64 resolutions[]);
EXPORT fmi3Status fmi3ActivateModelPartition(fmi3Instance, fmi3ValueReference clock, fmi3Float64 time);

EXPORT fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance);
EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                              fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation);
EXPORT fmi3Status fmi3SetTime(fmi3Instance, fmi3Float64);
EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance, const fmi3Float64[], size_t);
EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance, fmi3Float64[], size_t);
EXPORT fmi3Status fmi3GetEventIndicators(fmi3Instance, fmi3Float64[], size_t);
EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance, fmi3Float64[], size_t);
EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance, fmi3Float64[], size_t);
EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance, size_t *);
EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance, size_t *);

#endif
