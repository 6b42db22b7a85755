/* @title as an FMU for co-simulation, FMI 3.0. Generated; do not edit. */
#include "fmi3Functions.h"

#include "@unit.h"

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define TOKEN "@token"
#define PERIOD @period /* [s] */
#define VARIABLES @count

/* What an FMU state keeps. */
typedef struct {
    double time; /* [s] */
    double start; /* [s] */
    double periods; /* since the start */
@members
} fmu_values;

enum fmu_mode { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED };

typedef struct {
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    enum fmu_mode mode;
    fmu_values values;
} fmu_instance;

/* A copy of the values may hold addresses within them: it belongs to one instance. */
typedef struct {
    const fmu_instance *of;
    enum fmu_mode mode;
    fmu_values values;
} fmu_copy;

enum fmu_kind { FLOAT64, BOOLEAN, ENUMERATION };
enum fmu_access { READ, BEFORE, ALWAYS }; /* when a variable may be set: never, before the first step, at any time */

typedef struct {
    fmi3ValueReference reference;
    enum fmu_kind kind;
    enum fmu_access access;
    int checked; /* whether values must be finite and within low and high */
    size_t offset;
    size_t size;
    double low, high;
    const char *name;
} fmu_variable;

static const fmu_variable variables[VARIABLES] = {
@table
};

static fmi3Status refused(const fmu_instance *instance, const char *format, ...)
{
    char text[512];
    va_list arguments;

    if (instance != NULL && instance->log != NULL) {
        va_start(arguments, format);
        vsnprintf(text, sizeof text, format, arguments);
        va_end(arguments);
        instance->log(instance->environment, fmi3Error, "logStatusError", text);
    }
    return fmi3Error;
}

/* ------------------------------------------------------------------ what differs between bodies */

@functions
@variables
/* ------------------------------------------------------------------ life of an instance */

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance given, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    (void)given, (void)loggingOn, (void)nCategories, (void)categories; /* errors are always told, there is no more */
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference requiredIntermediateVariables[], size_t nRequiredIntermediateVariables,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate)
{
    fmu_instance *instance = calloc(1, sizeof *instance);

    (void)instanceName, (void)resourcePath, (void)visible, (void)loggingOn, (void)eventModeUsed;
    (void)earlyReturnAllowed, (void)requiredIntermediateVariables, (void)intermediateUpdate;
    if (instance == NULL) {
        return NULL;
    }
    instance->environment = instanceEnvironment;
    instance->log = logMessage;
    if (instantiationToken == NULL || strcmp(instantiationToken, TOKEN) != 0) {
        refused(instance, "The instantiation token is not that of this FMU: its modelDescription.xml is another one.");
    } else if (nRequiredIntermediateVariables > 0) {
        refused(instance, "There are no intermediate values of variables.");
    } else if (!begin(instance)) {
        refused(instance, "The memory of the solver is too small.");
    } else {
        return instance;
    }
    free(instance);
    return NULL;
}

void fmi3FreeInstance(fmi3Instance given)
{
    free(given);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance given, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    fmu_instance *instance = given;

    (void)toleranceDefined, (void)tolerance, (void)stopTimeDefined, (void)stopTime;
    if (!isfinite(startTime)) {
        return refused(instance, "The start time is not a finite number.");
    }
    instance->values.time = instance->values.start = startTime;
    instance->mode = INITIALIZING;
    stand(instance);
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance given)
{
    fmu_instance *instance = given;

    stand(instance);
    instance->mode = STEPPING;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance given)
{
    ((fmu_instance *)given)->mode = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance given)
{
    fmu_instance *instance = given;

    memset(&instance->values, 0, sizeof instance->values);
    instance->mode = INSTANTIATED;
    return begin(instance) ? fmi3OK : refused(instance, "The memory of the solver is too small.");
}

fmi3Status fmi3DoStep(fmi3Instance given, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    fmu_instance *instance = given;
    fmu_values *values = &instance->values;
    const double wanted = communicationStepSize / PERIOD;
    const double periods = floor(wanted + 0.5);
    double k;

    (void)noSetFMUStatePriorToCurrentPoint;
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    *lastSuccessfulTime = values->time;
    if (instance->mode != STEPPING) {
        return refused(instance, "A step needs an FMU that was initialized.");
    }
    if (!(fabs(currentCommunicationPoint - values->time) <= 1e-6 * PERIOD + 1e-12 * fabs(values->time))) {
        return refused(instance, "The step begins at %.9g s, but the last one ended at %.9g s.",
                       currentCommunicationPoint, values->time);
    }
    if (!(wanted > 0.5 && wanted < 1e9 && fabs(wanted - periods) <= 1e-6)) {
        return refused(instance, "The step of %.9g s is not a multiple of the period of %.9g s.",
                       communicationStepSize, PERIOD);
    }
    for (k = 0.0; k < periods; k++) {
        if (!step(instance, k == 0.0)) {
            return fmi3Error;
        }
        values->periods += 1.0;
        *lastSuccessfulTime = values->time = values->start + values->periods * PERIOD;
    }
    return fmi3OK;
}

/* ------------------------------------------------------------------ FMU states */

fmi3Status fmi3GetFMUState(fmi3Instance given, fmi3FMUState *FMUState)
{
    const fmu_instance *instance = given;
    fmu_copy *copy = *FMUState == NULL ? malloc(sizeof *copy) : *FMUState;

    if (copy == NULL) {
        return refused(instance, "There is no memory for a state.");
    }
    copy->of = instance;
    copy->mode = instance->mode;
    copy->values = instance->values;
    *FMUState = copy;
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance given, fmi3FMUState FMUState)
{
    fmu_instance *instance = given;
    const fmu_copy *copy = FMUState;

    if (copy == NULL || copy->of != instance) {
        return refused(instance, "The state is that of another instance.");
    }
    instance->mode = copy->mode;
    instance->values = copy->values;
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance given, fmi3FMUState *FMUState)
{
    (void)given;
    free(*FMUState);
    *FMUState = NULL;
    return fmi3OK;
}

/* ------------------------------------------------------------------ functions that this FMU does not have */

@stubs
