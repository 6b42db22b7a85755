/* A simulated rig for a page: numbers that both sides see, and calls. Generated; do not edit. */
#include "@name.h"

#include <string.h>

#define CALL(name) __attribute__((export_name(#name)))

static @{name}_memory unit;
static struct {
    double inputs[@{NAME}_INPUTS], bias[@{NAME}_INPUTS];
    double state[@{NAME}_STATES], outputs[@{NAME}_OUTPUTS];
} shared;

static void show(void)
{
    memcpy(shared.state, unit.state, sizeof shared.state);
    memcpy(shared.outputs, unit.outputs, sizeof shared.outputs);
}

CALL(shared) void *shared_numbers(void)
{
    return &shared;
}

CALL(begin) int begin(void)
{
    @{name}_init(&unit);
    memcpy(shared.inputs, unit.inputs, sizeof shared.inputs);
    memcpy(shared.bias, unit.bias, sizeof shared.bias);
    show();
    return 1;
}

CALL(step) int step(int steps)
{
    memcpy(unit.inputs, shared.inputs, sizeof unit.inputs);
    memcpy(unit.bias, shared.bias, sizeof unit.bias);
    for (; steps > 0; steps--) {
        @{name}_step(&unit);
    }
    show();
    return 1;
}
