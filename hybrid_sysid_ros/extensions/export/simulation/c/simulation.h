/* @about
 * Generated; do not edit.
 */
#ifndef @{NAME}_H
#define @{NAME}_H

#define @{NAME}_STATES @states
#define @{NAME}_INPUTS @inputs
#define @{NAME}_OUTPUTS @outputs
#define @{NAME}_PARAMETERS @parameters
#define @{NAME}_STEP @step /* [s] */

#ifdef __cplusplus
extern "C" {
#endif

/* All memory; state, parameters, inputs and bias may be written, between steps. */
typedef struct {
    double state[@{NAME}_STATES];
    double parameters[@{NAME}_PARAMETERS];
    double inputs[@{NAME}_INPUTS]; /* commanded; they act within their bounds, and at rest where one is not a number */
    double bias[@{NAME}_INPUTS]; /* what acts beside the inputs, such as a push */
    double outputs[@{NAME}_OUTPUTS];
    double acting[@{NAME}_INPUTS];
    double past_inputs[@past_inputs];
    double past_outputs[@past_outputs];
} @{name}_memory;

/* Begin with a state of zero, the identified parameters and inputs at rest. */
void @{name}_init(@{name}_memory *unit);

/* Let the inputs have been the same for long, and compute the outputs at the state. */
void @{name}_stand(@{name}_memory *unit);

/* A step. */
void @{name}_step(@{name}_memory *unit);

#ifdef __cplusplus
}
#endif

#endif
