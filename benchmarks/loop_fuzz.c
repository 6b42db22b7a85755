/* Asks @name what no rig would, and looks whether every input stays a number within its bounds. Generated; do not edit.
 *
@about
 */
#include "@name.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static @{name}_memory memory;
static const double low[@{NAME}_INPUTS] = {@low}, high[@{NAME}_INPUTS] = {@high};
static const double wild[] = {NAN, INFINITY, -INFINITY, 1e300, -1e300, 0.0, -0.0, 1e6, -1e6, 1e-300};
static uint64_t state = 0x9E3779B97F4A7C15u;

static double uniform(void) /* xorshift of Marsaglia (2003), in [0, 1) */
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) / 9007199254740992.0;
}

static @{name}_real number(double size)
{
    const double u = uniform();

    return (@{name}_real)(u < 0.02 ? wild[(int)(uniform() * 10.0)] : size * (2.0 * u - 1.0));
}

int main(int count, char **given)
{
    const long calls = count > 1 ? atol(given[1]) : 1000000;
    const uint64_t seed = count > 2 ? (uint64_t)atol(given[2]) : 0;
    double time = 0.0, scale = 1.0;
    long k;
    int j;

    state += seed * 0xBF58476D1CE4E5B9u;
    if (!@{name}_init(&memory)) {
        return 1;
    }
    @{name}_reset(&memory);
    for (k = 0; k < calls; k++) {
        @{name}_measurement measurement;
        @{name}_reference reference;
        @{name}_command command;
        const double kind = uniform();

        scale = k % 97 ? scale : pow(10.0, 6.0 * uniform() - 4.0);
        time += kind < 0.01 ? (double)number(10.0) : @period;
        measurement.time = kind > 0.99 ? (double)number(1e3) : time;
        for (j = 0; j < @{NAME}_OUTPUTS; j++) {
            measurement.outputs[j] = number(scale);
        }
        for (j = 0; j < @{NAME}_INPUTS; j++) {
            measurement.applied[j] = number(high[j]);
        }
        for (j = 0; j < @{NAME}_HORIZON * @{NAME}_OUTPUTS; j++) {
            reference.outputs[j] = uniform() < 0.999 ? (@{name}_real)(scale * uniform()) : number(scale);
        }
        @{name}_step(&memory, &measurement, &reference, &command);
        for (j = 0; j < @{NAME}_INPUTS; j++) {
            if (!(command.inputs[j] >= low[j] - 1e-6 && command.inputs[j] <= high[j] + 1e-6)) {
                printf("call %ld: input %d is %.17g\n", k, j, (double)command.inputs[j]);
                return 1;
            }
        }
        @{name}_prepare(&memory, (@{name}_real)@period);
        time = isfinite(time) && fabs(time) < 1e9 ? time : 0.0;
        if (uniform() < 1e-4) {
            @{name}_reset(&memory);
        }
    }
    printf("%ld calls: every input a number within its bounds\n", calls);
    return 0;
}
