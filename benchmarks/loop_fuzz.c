/* Asks @name what no rig would, and looks whether every input stays a number within its bounds. Prints how many calls
 * there were, how many were answered by the MPC or the policy, and by the policy alone. Generated; do not edit.
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
static const double lowest[@{NAME}_OUTPUTS] = {@lowest}, highest[@{NAME}_OUTPUTS] = {@highest};
static const double noise[@{NAME}_OUTPUTS] = {@noise};
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

/* Readings as the estimate expects them, the command as it was sent, and a reference within the rig's reach that moves
 * on evenly: what keeps the loop driving. */
static void sound(
    const double *goal, const double *rate, const @{name}_command *last, @{name}_measurement *measurement,
    @{name}_reference *reference)
{
    int j;

    @{name}_expected(&memory, measurement->outputs);
    for (j = 0; j < @{NAME}_OUTPUTS; j++) {
        const double spread = uniform() + uniform() + uniform() + uniform() - 2.0; /* of deviation 3^-.5 */
        const double reading = (double)measurement->outputs[j];

        measurement->outputs[j] = (@{name}_real)((isfinite(reading) ? reading : 0.0) + sqrt(3.0) * noise[j] * spread);
    }
    for (j = 0; j < @{NAME}_INPUTS; j++) {
        measurement->applied[j] = last->inputs[j];
    }
    for (j = 0; j < @{NAME}_HORIZON * @{NAME}_OUTPUTS; j++) {
        const int output = j % @{NAME}_OUTPUTS;

        reference->outputs[j] = (@{name}_real)(goal[output] + rate[output] * (double)(j / @{NAME}_OUTPUTS));
    }
}

/* Of any size, missing, infinite or no number. */
static void odd(double scale, @{name}_measurement *measurement, @{name}_reference *reference)
{
    int j;

    for (j = 0; j < @{NAME}_OUTPUTS; j++) {
        measurement->outputs[j] = number(scale);
    }
    for (j = 0; j < @{NAME}_INPUTS; j++) {
        measurement->applied[j] = number(high[j]);
    }
    for (j = 0; j < @{NAME}_HORIZON * @{NAME}_OUTPUTS; j++) {
        reference->outputs[j] = uniform() < 0.999 ? (@{name}_real)(scale * uniform()) : number(scale);
    }
}

int main(int count, char **given)
{
    const long calls = count > 1 ? atol(given[1]) : 1000000;
    const uint64_t seed = count > 2 ? (uint64_t)atol(given[2]) : 0;
    double time = 0.0, scale = 1.0, oddity = 1.0, goal[@{NAME}_OUTPUTS] = {0.0}, rate[@{NAME}_OUTPUTS] = {0.0};
    long k, answered = 0, of_policy = 0;
    int j;
    @{name}_command command = {0};

    state += seed * 0xBF58476D1CE4E5B9u;
    if (!@{name}_init(&memory)) {
        return 1;
    }
    @{name}_reset(&memory);
    for (k = 0; k < calls; k++) {
        @{name}_measurement measurement;
        @{name}_reference reference;

        if (k % 200 == 0) { /* another stretch: of odd calls alone, of few, or of none */
            scale = pow(10.0, 6.0 * uniform() - 4.0);
            oddity = uniform() < 0.2 ? 1.0 : uniform() < 0.5 ? 0.02 : 0.0;
            for (j = 0; j < @{NAME}_OUTPUTS; j++) {
                goal[j] = lowest[j] + (highest[j] - lowest[j]) * uniform();
                rate[j] = uniform() < 0.5 ? 0.0 : 0.002 * (highest[j] - lowest[j]) * (uniform() - 0.5);
            }
            if (uniform() < 0.7) {
                @{name}_reset(&memory);
            }
        }
        time += uniform() < 0.01 * oddity ? (double)number(10.0) : @period;
        measurement.time = uniform() < 0.01 * oddity ? (double)number(1e3) : time;
        if (uniform() < oddity) {
            odd(scale, &measurement, &reference);
        } else {
            sound(goal, rate, &command, &measurement, &reference);
        }
        @{name}_step(&memory, &measurement, &reference, &command);
        for (j = 0; j < @{NAME}_INPUTS; j++) {
            if (!(command.inputs[j] >= low[j] - 1e-6 && command.inputs[j] <= high[j] + 1e-6)) {
                printf("call %ld: input %d is %.17g\n", k, j, (double)command.inputs[j]);
                return 1;
            }
        }
        answered += command.status >= @{NAME}_SOLVED && command.status <= @{NAME}_POLICY;
        of_policy += command.status == @{NAME}_POLICY;
        @{name}_prepare(&memory, (@{name}_real)@period);
        time = isfinite(time) && fabs(time) < 1e9 ? time : 0.0;
    }
    printf("%ld %ld %ld\n", calls, answered, of_policy);
    return 0;
}
