/* @about
 * Generated; do not edit.
 */
#include "@name.h"

#include <math.h>
#include <string.h>

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "-ffast-math (-ffinite-math-only) takes away the test for what is not a number: compile without it"
#endif

int @{name}_following(const double **arguments, double **results, int *whole, double *work, int memory);
int @{name}_output(const double **arguments, double **results, int *whole, double *work, int memory);

/* Of input j, past_inputs has what was applied in this step and those before, from input_first[j] on; what acts lies
 * between the two oldest of them. Likewise the outputs. */
@tables
static double within(double value, double low, double high)
{
    value = value < low ? low : value;
    return value > high ? high : value;
}

static double bounded(int j, double value)
{
    if (isnan(value)) {
        return rest[j];
    }
    value = within(value, low[j], high[j]);
    if (count[j] > 0.0) {
        value = within(within(rint(value / count[j]) * count[j], -range[j], range[j]), low[j], high[j]);
    }
    return value;
}

static double late(const double *past, int size, double part)
{
    return (1.0 - part) * past[size - 2] + part * past[size - 1];
}

static void put(double *past, int size, double value)
{
    memmove(past + 1, past, (size_t)(size - 1) * sizeof *past);
    past[0] = value;
}

static void act(@{name}_memory *unit)
{
    int j;

    for (j = 0; j < @{NAME}_INPUTS; j++) {
        unit->acting[j] =
            late(unit->past_inputs + input_first[j], input_first[j + 1] - input_first[j], input_part[j]) +
            unit->bias[j];
    }
}

static void look(@{name}_memory *unit, double *found)
{
    const double *arguments[3];
    double *results[1];

    arguments[0] = unit->state;
    arguments[1] = unit->acting;
    arguments[2] = unit->parameters;
    results[0] = found;
    @{name}_output(arguments, results, 0, 0, 0);
}

void @{name}_init(@{name}_memory *unit)
{
    memset(unit, 0, sizeof *unit);
    memcpy(unit->parameters, at_first, sizeof unit->parameters);
    memcpy(unit->inputs, rest, sizeof unit->inputs);
    memcpy(unit->bias, bias_at_first, sizeof unit->bias);
    @{name}_stand(unit);
}

void @{name}_stand(@{name}_memory *unit)
{
    double found[@{NAME}_OUTPUTS];
    int j, k;

    for (j = 0; j < @{NAME}_INPUTS; j++) {
        for (k = input_first[j]; k < input_first[j + 1]; k++) {
            unit->past_inputs[k] = bounded(j, unit->inputs[j]);
        }
    }
    act(unit);
    look(unit, found);
    for (j = 0; j < @{NAME}_OUTPUTS; j++) {
        for (k = output_first[j]; k < output_first[j + 1]; k++) {
            unit->past_outputs[k] = found[j];
        }
        unit->outputs[j] = found[j];
    }
}

void @{name}_step(@{name}_memory *unit)
{
    double following[@{NAME}_STATES], found[@{NAME}_OUTPUTS];
    const double *arguments[3];
    double *results[1];
    int i, j;

    for (j = 0; j < @{NAME}_INPUTS; j++) {
        double *past = unit->past_inputs + input_first[j];

        put(past, input_first[j + 1] - input_first[j],
            within(bounded(j, unit->inputs[j]), past[0] - most[j], past[0] + most[j]));
    }
    act(unit);
    arguments[0] = unit->state;
    arguments[1] = unit->acting;
    arguments[2] = unit->parameters;
    results[0] = following;
    @{name}_following(arguments, results, 0, 0, 0);
    for (i = 0; i < @{NAME}_STATES; i++) {
        unit->state[i] = within(following[i], travel_low[i], travel_high[i]);
    }
    for (i = 0; i < @{NAME}_STATES; i++) {
        const int v = velocity[i];

        if (v >= 0 && unit->state[i] < following[i] && unit->state[v] > 0.0) {
            unit->state[v] = 0.0;
        }
        if (v >= 0 && unit->state[i] > following[i] && unit->state[v] < 0.0) {
            unit->state[v] = 0.0;
        }
    }
    look(unit, found);
    for (j = 0; j < @{NAME}_OUTPUTS; j++) {
        double *past = unit->past_outputs + output_first[j];

        put(past, output_first[j + 1] - output_first[j], found[j]);
        unit->outputs[j] = late(past, output_first[j + 1] - output_first[j], output_part[j]);
    }
}
