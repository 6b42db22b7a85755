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

static const double reach = @reach;

@weights
static double within(double value, double low, double high)
{
    return value < low ? low : (value > high ? high : value);
}

struct layer {
    const double *weights, *biases;
    int columns, rows;
};

static const struct layer layers[] = {
@layers
};

/* Tanh layers and a straight one: W values + b, row by row, to and fro between two arrays. */
static void network(const struct layer *of, int depth, const double *values, double *answers)
{
    double between[2][WIDEST];
    int i, j, k;

    for (k = 0; k < depth; k++) {
        int last = k == depth - 1;
        double *out = last ? answers : between[k % 2];

        for (i = 0; i < of[k].rows; i++) {
            double sum = of[k].biases[i];

            for (j = 0; j < of[k].columns; j++) {
                sum += of[k].weights[i * of[k].columns + j] * values[j];
            }
            out[i] = last ? sum : tanh(sum);
        }
        values = out;
    }
}

#if @{NAME}_PARAMETERS
enum { PARAMETERS = @{NAME}_PARAMETERS };

static const double farthest = @farthest;

static const struct layer corrections[] = {
@corrections
};

/* answers + sum_p d answers / d theta_p (theta_p - nominal_p) / spread_p; linear, so kept near */
static void correct(const double z[FEATURES], const double *parameters, double *answers)
{
    double slopes[PARAMETERS * ANSWERS];
    int p, k;

    network(corrections, (int)(sizeof corrections / sizeof corrections[0]), z, slopes);
    for (p = 0; p < PARAMETERS; p++) {
        double deviation = isfinite(parameters[p]) ? (parameters[p] - nominal[p]) / spread[p] : 0.0;

        deviation = within(deviation, -farthest, farthest);
        for (k = 0; k < ANSWERS; k++) {
            answers[k] += slopes[p * ANSWERS + k] * deviation;
        }
    }
}
#endif

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
    const double previous_input[@{NAME}_INPUTS], const double preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS],
#if @{NAME}_PARAMETERS
    const double parameters[@{NAME}_PARAMETERS],
#endif
    double inputs[@{NAME}_STAGES * @{NAME}_INPUTS])
{
    double features[FEATURES], z[FEATURES], answers[ANSWERS];
    int j, k, finite = standardised(state, disturbance, previous_input, preview, features, z);

    if (finite) {
        network(layers, (int)(sizeof layers / sizeof layers[0]), z, answers);
#if @{NAME}_PARAMETERS
        correct(z, parameters, answers);
#endif
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
