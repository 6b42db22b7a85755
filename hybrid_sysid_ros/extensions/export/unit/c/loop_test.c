/* Replays a recorded loop: asks @name what it was asked when it was exported. Generated; do not edit.
 *
@about
 */
#include "@name.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#ifndef @{NAME}_COUNT
#define @{NAME}_COUNT() 0.0 /* instructions so far: a board counts them */
#endif

static const struct {
    @{name}_measurement measurement;
    @{name}_reference reference;
    int status;
    @{name}_real inputs[@{NAME}_INPUTS];
} periods[@periods] = {
@table
};

static @{name}_memory memory;
static double counted[@periods];

static int ascending(const void *one, const void *other)
{
    const double a = *(const double *)one, b = *(const double *)other;

    return (a > b) - (a < b);
}

int main(void)
{
    const double tolerance = @tolerance;
    double largest = 0.0;
    int k, j, wrong = 0;

    if (!@{name}_init(&memory)) {
        printf("the memory of the solver is too small\n");
        return 1;
    }
    @{name}_reset(&memory);
    for (k = 0; k < @periods; k++) {
        @{name}_command command;
        int equal;

        counted[k] = @{NAME}_COUNT();
        @{name}_step(&memory, &periods[k].measurement, &periods[k].reference, &command);
#ifdef DAQP_SINGLE_PRECISION
        if (command.status) {
            @{name}_sent(&memory, periods[k].inputs); /* what differs by rounding has no sequel */
        }
#endif
        @{name}_prepare(&memory, @period);
        counted[k] = @{NAME}_COUNT() - counted[k];
        equal = @same
        for (j = 0; j < @{NAME}_INPUTS; j++) {
            double difference = fabs((double)(command.inputs[j] - periods[k].inputs[j]));

            equal = equal && difference <= tolerance;
            largest = difference > largest ? difference : largest;
        }
        if (!equal) {
            printf("period %d: status %d, not %d; first input %.17g, not %.17g\n", k, command.status,
                   periods[k].status, (double)command.inputs[0], (double)periods[k].inputs[0]);
            wrong++;
        }
    }
    printf("%d of %d periods wrong, largest difference %.3g, tolerance %.3g, %lu bytes\n", wrong, @periods, largest,
           tolerance, (unsigned long)@{name}_size());
    if (counted[0] > 0.0) { /* the first period begins from nothing */
        qsort(counted + 1, @periods - 1, sizeof counted[0], ascending);
        printf("instructions of a period: first %.0f, then median %.0f, 99 %% %.0f, most %.0f\n", counted[0],
               counted[@periods / 2], counted[@periods * 99 / 100], counted[@periods - 1]);
    }
    return wrong != 0;
}
