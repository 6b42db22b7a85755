"""The texts of an exported policy in C99; what stands behind an @ is filled in."""

from __future__ import annotations

from string import Template


class Text(Template):
    """C has no use for @, but format strings for %."""

    delimiter = "@"


FOLLOWED = Text(""" *
 * parameters: the plant's, as they are estimated (@names), in the model's units; what is not a finite
 * number counts as the model's own value.
""")

HEADER = Text("""\
/* An approximate model predictive controller: a network with its bounds. Generated; do not edit.
 *
@about
 */
#ifndef @{NAME}_H
#define @{NAME}_H

#define @{NAME}_STATES @states
#define @{NAME}_INPUTS @inputs
#define @{NAME}_OUTPUTS @outputs
#define @{NAME}_HORIZON @horizon
#define @{NAME}_STAGES @stages
#define @{NAME}_PARAMETERS @parameters

#ifdef __cplusplus
extern "C" {
#endif

/* The inputs to apply from now on, those of one period after another; the first @{NAME}_INPUTS are for now.
 *
 * state: the one that the inputs will meet, a delay ahead. disturbance: estimated offset of each input. previous_input:
 * the ones applied last. preview: reference of the outputs 1, 2, ... periods after the state's time, one period after
 * another.
@followed *
 * Returns 1 where the inputs are the network's. Returns 0 where something is not a finite number: the inputs are then
 * the previous ones within their bounds, or zero. They are finite and within their bounds, always.
 */
int @name(
    const double state[@{NAME}_STATES], const double disturbance[@{NAME}_INPUTS],
    const double previous_input[@{NAME}_INPUTS], const double preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS],@signature
    double inputs[@{NAME}_STAGES * @{NAME}_INPUTS]);

/* Whether a question is one like those of the training: 1 or 0. Beyond that the network knows nothing. */
int @{name}_inside(
    const double state[@{NAME}_STATES], const double disturbance[@{NAME}_INPUTS],
    const double previous_input[@{NAME}_INPUTS], const double preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS]);

#ifdef __cplusplus
}
#endif

#endif
""")

SOURCE = Text("""\
/* An approximate model predictive controller: a network with its bounds. Generated; do not edit.
 *
@about
 *
 * No memory but the stack, no library but the C library's math.h.
 */
#include "@name.h"

#include <math.h>

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "-ffast-math (-ffinite-math-only) takes away the test for what is not a number: compile without it"
#endif

enum {
    STATES = @{NAME}_STATES,
    INPUTS = @{NAME}_INPUTS,
    OUTPUTS = @{NAME}_OUTPUTS,
    HORIZON = @{NAME}_HORIZON,
    STAGES = @{NAME}_STAGES,
    ANSWERS = STAGES * INPUTS,
    TRACKED = @tracked,
    PREVIEW = STATES + 2 * INPUTS,
    FEATURES = PREVIEW + HORIZON * TRACKED,
    WIDEST = @widest
};

enum activation { STRAIGHT, TANH };

static const double reach = @reach;

@weights
static double within(double value, double low, double high)
{
    return value < low ? low : (value > high ? high : value);
}

/* W from + b, row by row */
static void layer(
    const double *weights, const double *biases, const double *from, int columns, double *to, int rows,
    enum activation activation)
{
    int i, j;

    for (i = 0; i < rows; i++) {
        double sum = biases[i];

        for (j = 0; j < columns; j++) {
            sum += weights[i * columns + j] * from[j];
        }
        to[i] = activation == TANH ? tanh(sum) : sum;
    }
}

@network@{corrected}
/* The features, and z = (features - centre) / scale; 0 where one is not a finite number. */
static int standardised(
    const double *state, const double *disturbance, const double *previous_input, const double *preview,
    double features[FEATURES], double z[FEATURES])
{
    int i, j, k;

    for (j = 0; j < STATES; j++) {
        features[j] = state[j];
    }
    for (j = 0; j < INPUTS; j++) {
        features[STATES + j] = disturbance[j];
        features[STATES + INPUTS + j] = previous_input[j];
    }
    for (k = 0; k < TRACKED; k++) {
        double output = 0.0;

        for (j = 0; j < STATES; j++) {
            output += output_map[k * STATES + j] * state[j];
        }
        for (i = 0; i < HORIZON; i++) {
            features[PREVIEW + i * TRACKED + k] = preview[i * OUTPUTS + tracked[k]] - output;
        }
    }
    for (j = 0; j < FEATURES; j++) {
        z[j] = (features[j] - centre[j]) / scale[j];
        if (!isfinite(z[j])) {
            return 0;
        }
    }
    return 1;
}

int @name(
    const double state[@{NAME}_STATES], const double disturbance[@{NAME}_INPUTS],
    const double previous_input[@{NAME}_INPUTS], const double preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS],@signature
    double inputs[@{NAME}_STAGES * @{NAME}_INPUTS])
{
    double features[FEATURES], z[FEATURES], answers[ANSWERS];
    int j, k, finite = standardised(state, disturbance, previous_input, preview, features, z);

    if (finite) {
        network(z, answers);
@{correct}\
        for (k = 0; k < ANSWERS; k++) {
            double low = input_low[k % INPUTS], high = input_high[k % INPUTS];

            answers[k] = 0.5 * (low + high) + 0.5 * (high - low) * answers[k];
            finite = finite && isfinite(answers[k]);
        }
    }
    for (j = 0; j < INPUTS; j++) {
        double low = input_low[j], high = input_high[j];
        double last = within(isfinite(previous_input[j]) ? previous_input[j] : 0.0, low, high);

        for (k = 0; k < STAGES; k++) {
            if (finite) {
                double u = answers[k * INPUTS + j];

                last = within(within(u, last - rate_limit[j], last + rate_limit[j]), low, high);
            }
            inputs[k * INPUTS + j] = last;
        }
    }
    return finite;
}

int @{name}_inside(
    const double state[@{NAME}_STATES], const double disturbance[@{NAME}_INPUTS],
    const double previous_input[@{NAME}_INPUTS], const double preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS])
{
    double features[FEATURES], z[FEATURES], total = 0.0;
    const double *row = whitening;
    int i, j;

    if (!standardised(state, disturbance, previous_input, preview, features, z)) {
        return 0;
    }
    for (i = 0; i < FEATURES; i++) {
        double distance = 0.0;

        if (features[i] < lowest[i] || features[i] > highest[i]) {
            return 0;
        }
        for (j = 0; j <= i; j++) {
            distance += row[j] * z[j];
        }
        total += distance * distance;
        row += i + 1;
    }
    return total <= reach * reach;
}
""")

CORRECTION = Text("""
enum { PARAMETERS = @{NAME}_PARAMETERS };

static const double farthest = @farthest;

@sensitivity/* answers + sum_p d answers / d theta_p (theta_p - nominal_p) / spread_p; linear, so kept near */
static void correct(const double z[FEATURES], const double *parameters, double *answers)
{
    double slopes[PARAMETERS * ANSWERS];
    int p, k;

    sensitivity(z, slopes);
    for (p = 0; p < PARAMETERS; p++) {
        double deviation = isfinite(parameters[p]) ? (parameters[p] - nominal[p]) / spread[p] : 0.0;

        deviation = within(deviation, -farthest, farthest);
        for (k = 0; k < ANSWERS; k++) {
            answers[k] += slopes[p * ANSWERS + k] * deviation;
        }
    }
}
""")

TEST = Text("""\
/* Asks @name what it was asked when it was exported. Generated; do not edit.
 *
@about
 *
 * cc -std=c99 -O2 @name.c @{name}_test.c -lm && ./a.out
 */
#include "@name.h"

#include <math.h>
#include <stdio.h>

static const struct {
    double state[@{NAME}_STATES], disturbance[@{NAME}_INPUTS], previous_input[@{NAME}_INPUTS];
    double preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS];
    @{field}\
double inputs[@{NAME}_STAGES * @{NAME}_INPUTS];
    int answered, inside;
} vectors[@vectors] = {
@table
};

int main(void)
{
    const double tolerance = @tolerance;
    double largest = 0.0;
    int i, k, wrong = 0;

    for (i = 0; i < @vectors; i++) {
        double inputs[@{NAME}_STAGES * @{NAME}_INPUTS];
        int answered = @name(
            vectors[i].state, vectors[i].disturbance, vectors[i].previous_input, vectors[i].preview, @{asked}\
inputs);
        int inside = @{name}_inside(
            vectors[i].state, vectors[i].disturbance, vectors[i].previous_input, vectors[i].preview);
        int equal = answered == vectors[i].answered && inside == vectors[i].inside;

        for (k = 0; k < @{NAME}_STAGES * @{NAME}_INPUTS; k++) {
            double difference = fabs(inputs[k] - vectors[i].inputs[k]);

            equal = equal && difference <= tolerance;
            largest = difference > largest ? difference : largest;
        }
        if (!equal) {
            printf("vector %d: answered %d, not %d; inside %d, not %d; first input %.17g, not %.17g\\n", i, answered,
                   vectors[i].answered, inside, vectors[i].inside, inputs[0], vectors[i].inputs[0]);
            wrong++;
        }
    }
    printf("%d of %d vectors wrong, largest difference %.3g, tolerance %.3g\\n", wrong, @vectors, largest, tolerance);
    return wrong != 0;
}
""")
