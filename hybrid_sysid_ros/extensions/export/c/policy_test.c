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
#if @{NAME}_PARAMETERS
    double parameters[@{NAME}_PARAMETERS];
#endif
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
            vectors[i].state, vectors[i].disturbance, vectors[i].previous_input, vectors[i].preview,
#if @{NAME}_PARAMETERS
            vectors[i].parameters,
#endif
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
            printf("vector %d: answered %d, not %d; inside %d, not %d; first input %.17g, not %.17g\n", i, answered,
                   vectors[i].answered, inside, vectors[i].inside, inputs[0], vectors[i].inputs[0]);
            wrong++;
        }
    }
    printf("%d of %d vectors wrong, largest difference %.3g, tolerance %.3g\n", wrong, @vectors, largest, tolerance);
    return wrong != 0;
}
