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
 *
 * parameters, where there are any (here: @names): the plant's, as they are estimated, in the model's units; what is not
 * a finite number counts as the model's own value.
 *
 * Returns 1 where the inputs are the network's. Returns 0 where something is not a finite number: the inputs are then
 * the previous ones within their bounds, or zero. They are finite and within their bounds, always.
 */
int @name(
    const double state[@{NAME}_STATES], const double disturbance[@{NAME}_INPUTS],
    const double previous_input[@{NAME}_INPUTS], const double preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS],
#if @{NAME}_PARAMETERS
    const double parameters[@{NAME}_PARAMETERS],
#endif
    double inputs[@{NAME}_STAGES * @{NAME}_INPUTS]);

/* Whether a question is one like those of the training: 1 or 0. Beyond that the network knows nothing. */
int @{name}_inside(
    const double state[@{NAME}_STATES], const double disturbance[@{NAME}_INPUTS],
    const double previous_input[@{NAME}_INPUTS], const double preview[@{NAME}_HORIZON * @{NAME}_OUTPUTS]);

#ifdef __cplusplus
}
#endif

#endif
