/* A sampled controller as an FMI 2.0 co-simulation unit; see instance.h. */
#include "fmi2.h"

#include "instance.h"

typedef struct {
    controller_data data;
    fmi2CallbackLogger log;
    fmi2ComponentEnvironment environment;
    char *name;
} instance;

static fmi2Status report(const instance *self, const char *problem)
{
    if (problem == NULL) {
        return fmi2OK;
    }
    if (self->log != NULL) {
        self->log(self->environment, self->name, fmi2Error, "logStatusError", "%s", problem);
    }
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t n, const fmi2String categories[])
{
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn)
{
    instance *self = NULL;

    if (type == fmi2CoSimulation && strcmp(guid, MODEL_TOKEN) == 0) {
        self = calloc(1, sizeof *self);
    }
    if (self != NULL) {
        self->name = malloc(strlen(name) + 1);
        if (self->name == NULL) {
            free(self);
            return NULL;
        }
        strcpy(self->name, name);
        self->log = functions->logger;
        self->environment = functions->componentEnvironment;
        data_reset(&self->data);
    } else if (functions->logger != NULL) {
        functions->logger(functions->componentEnvironment, name, fmi2Error, "logStatusError",
                          "no memory, no co-simulation, or another guid");
    }
    return self;
}

void fmi2FreeInstance(fmi2Component c)
{
    if (c != NULL) {
        free(((instance *)c)->name);
        free(c);
    }
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    data_start(&((instance *)c)->data, startTime);
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    data_reset(&((instance *)c)->data);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    return report(c, data_get(&((instance *)c)->data, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    return report(c, data_set(&((instance *)c)->data, vr, nvr, value));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    const instance *self = c;
    fmi2Status status = report(self, data_step(&((instance *)c)->data, t, h));

    if (status == fmi2OK && self->data.fault) {
        status = fmi2Warning;
        if (self->log != NULL) {
            self->log(self->environment, self->name, status, "logStatusWarning", "%s", MODEL_HELD);
        }
    }
    return status;
}

/* All variables are real. */

#define NO_VARIABLES(function, type)                                                                                   \
    fmi2Status function(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, type value[])                      \
    {                                                                                                                  \
        return report(c, nvr == 0 ? NULL : #function ": all variables are of type Real");                              \
    }

NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLES(fmi2SetString, const fmi2String)

/* Capabilities that the model description does not claim. */

#define REFUSED(function, ...)                                                                                         \
    fmi2Status function(fmi2Component c, __VA_ARGS__)                                                                  \
    {                                                                                                                  \
        return report(c, #function " is not provided");                                                                \
    }

REFUSED(fmi2GetFMUstate, fmi2FMUstate *state)
REFUSED(fmi2SetFMUstate, fmi2FMUstate state)
REFUSED(fmi2FreeFMUstate, fmi2FMUstate *state)
REFUSED(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
REFUSED(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
REFUSED(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
REFUSED(fmi2GetDirectionalDerivative, const fmi2ValueReference unknowns[], size_t nUnknown,
        const fmi2ValueReference knowns[], size_t nKnown, const fmi2Real dKnown[], fmi2Real dUnknown[])
REFUSED(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
        const fmi2Real value[])
REFUSED(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
        fmi2Real value[])

/* A step has ended when fmi2DoStep returns: there is nothing to cancel and no status to wait for. */

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return report(c, "fmi2CancelStep: no step is pending");
}

#define NO_STATUS(function, type)                                                                                      \
    fmi2Status function(fmi2Component c, const fmi2StatusKind kind, type *value)                                       \
    {                                                                                                                  \
        return fmi2Discard;                                                                                            \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetRealStatus, fmi2Real)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
NO_STATUS(fmi2GetStringStatus, fmi2String)
