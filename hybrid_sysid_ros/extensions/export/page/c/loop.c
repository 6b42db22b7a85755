/* A loop for a page: numbers that both sides see, and calls. Generated; do not edit. */
#include "@name.h"

#include <string.h>

#define CALL(name) __attribute__((export_name(#name)))

static @{name}_memory unit;
static struct {
    double outputs[@{NAME}_OUTPUTS], applied[@{NAME}_INPUTS], preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS];
    double inputs[@{NAME}_INPUTS], state[@{NAME}_STATES], disturbance[@{NAME}_INPUTS];
} shared;

CALL(shared) void *shared_numbers(void)
{
    return &shared;
}

CALL(begin) int begin(void)
{
    if (!@{name}_init(&unit)) {
        return 0;
    }
    @{name}_reset(&unit);
    memcpy(shared.inputs, unit.command, sizeof shared.inputs);
    return 1;
}

CALL(step) int step(double time)
{
    @{name}_measurement measurement;
    @{name}_reference reference;
    @{name}_command command;

    measurement.time = time;
    memcpy(measurement.outputs, shared.outputs, sizeof measurement.outputs);
    memcpy(measurement.applied, shared.applied, sizeof measurement.applied);
    memcpy(reference.outputs, shared.preview, sizeof reference.outputs);
    @{name}_step(&unit, &measurement, &reference, &command);
    memcpy(shared.inputs, command.inputs, sizeof shared.inputs);
    memcpy(shared.state, command.state, sizeof shared.state);
    memcpy(shared.disturbance, command.disturbance, sizeof shared.disturbance);
    return command.status;
}

CALL(prepare) void prepare(double elapsed)
{
    @{name}_prepare(&unit, elapsed);
}
