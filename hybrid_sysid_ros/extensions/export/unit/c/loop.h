/* @title. Generated; do not edit.
 *
@about
 */
#ifndef @{NAME}_H
#define @{NAME}_H

@single#include "daqp/api.h"

#include <stddef.h>

#define @{NAME}_MODEL "@seal" /* the seal of the model; another one needs another unit */
#define @{NAME}_STATES @states
#define @{NAME}_INPUTS @inputs
#define @{NAME}_OUTPUTS @outputs
#define @{NAME}_HORIZON @horizon

#ifdef __cplusplus
extern "C" {
#endif

typedef @real @{name}_real;

/* outputs: readings of the sensors, NAN where one is missing. applied: mean inputs since the measurement before, NAN
 * where they are not known: the last command then. time: missing beyond @largest_stamp s; it begins anew with the second one
 * in a row that is more than @restart s before the newest. */
typedef struct {
    double time; /* [s] */
    @{name}_real outputs[@{NAME}_OUTPUTS];
    @{name}_real applied[@{NAME}_INPUTS];
} @{name}_measurement;

/* outputs: references at one period of the horizon after another, the first one period after the command acts. Beyond
 * the rig's travel or validity they are held just before its end. */
typedef struct {
    @{name}_real outputs[@{NAME}_HORIZON * @{NAME}_OUTPUTS];
} @{name}_reference;

enum @{name}_status {
    @{NAME}_WAITING, /* there is no estimate yet: the last command */
    @{NAME}_SOLVED, /* the optimum, to tolerance */
    @{NAME}_ITERATED, /* one real-time iteration towards the optimum */
    @{NAME}_NOT_CONVERGED, /* the last iterate, within the bounds */
    @{NAME}_FAILED, /* no solution: the rest of the last plan, or the last command */
    @{NAME}_POLICY, /* the policy's plan, which has passed the check */
    @{NAME}_HELD, /* neither a policy nor a plan, or no newer measurement for @stale_after s: the last command */
    @{NAME}_RESTED /* the guard rests the inputs, or step has found no sound answer (1, 2, 3, 5) for @zero_after s */
};

/* What the guard allows, by the evidence that it has. */
enum @{name}_level {
    @{NAME}_DRIVING, /* the reference is followed */
    @{NAME}_SLOWED, /* the reference moves slowly, and the inputs stay near rest */
    @{NAME}_HOLDING, /* the outputs are held where they are */
    @{NAME}_RESTING /* the inputs are at rest, or what the rig's stabiliser makes of it */
};

/* Why that is no more. */
enum @{name}_cause {
    @{NAME}_NOTHING,
    @{NAME}_ESTIMATE, /* measurements contradict the model */
    @{NAME}_ACTUATOR, /* the actuator does not do what was commanded */
    @{NAME}_RANGE, /* the state is outside of the rig's travel or validity */
    @{NAME}_SENSOR, /* a sensor is missing or left out: it may show an actuator's fault */
    @{NAME}_REVERSED /* an input acts reversed, and is sent with the other sign */
};

/* inputs: always finite and within their bounds. state: estimated at the measurement. ahead: when the command acts.
 * disturbance: estimated offset of each input. */
typedef struct {
    @{name}_real inputs[@{NAME}_INPUTS];
    int status; /* of enum @{name}_status */
    @{name}_real state[@{NAME}_STATES];
    @{name}_real ahead[@{NAME}_STATES];
    @{name}_real disturbance[@{NAME}_INPUTS];
    int level; /* of enum @{name}_level */
    int cause; /* of enum @{name}_cause */
} @{name}_command;

@records
/* All memory of a loop; its members are not for users. */
typedef struct {
@memory
@filters    DAQPProblem problem;
    DAQPWorkspace workspace;
    DAQPSettings settings;
    DAQPResult result;
    @{name}_real arena[@arena];
    int used;
    double origin; /* from which floats count time [s] */
    double back; /* the newest stamp, where that is long before others [s] */
} @{name}_memory;

/* Bytes of the memory. */
size_t @{name}_size(void);

/* Begin a loop: 1, or 0 where the memory of the solver is too small. One thread at a time. */
int @{name}_init(@{name}_memory *unit);

/* Forget the past. */
void @{name}_reset(@{name}_memory *unit);

/* A period: the command for a measurement and a reference. */
void @{name}_step(
    @{name}_memory *unit, const @{name}_measurement *measurement, const @{name}_reference *reference,
    @{name}_command *command);

/* The two halves of a period, for whoever does something in between, and looks itself whether measurements come and
 * answers are found. The first finds the estimate alone: 1, or 0 while there is none; the second the command for it.
 */
int @{name}_observe(@{name}_memory *unit, const @{name}_measurement *measurement, @{name}_command *command);
void @{name}_decide(@{name}_memory *unit, const @{name}_reference *reference, @{name}_command *command);

/* The halves of the second one. This finds what level the guard allows: applied is what acted, NAN where that is not
 * known. That finds the command; now: the reference when it acts, NULL where the reference stands still.
 */
void @{name}_judge(@{name}_memory *unit, const @{name}_real *applied, @{name}_command *command);
void @{name}_decide_from(
    @{name}_memory *unit, const @{name}_real *now, const @{name}_reference *reference, @{name}_command *command);

/* Inputs at rest: of a rig with a stabiliser what that makes of the newest state, unless its actuators are in doubt. */
void @{name}_at_rest(@{name}_memory *unit, @{name}_real *inputs);

/* Lead the reference on from these outputs, at the rig's rate. */
void @{name}_lead(@{name}_memory *unit, const @{name}_real *outputs);

/* The outputs that the newest estimate expects. */
void @{name}_expected(@{name}_memory *unit, @{name}_real *outputs);

/* Forget the measurements, or the last plan and all doubt about actuators and range, alone. */
void @{name}_forget_estimate(@{name}_memory *unit);
void @{name}_forget_plan(@{name}_memory *unit);

/* Begin the next command where the rig is, with a new plan, and lead the reference on from there. */
void @{name}_come_back(@{name}_memory *unit);

/* Say that other inputs were sent than those of the last command. */
void @{name}_sent(@{name}_memory *unit, const @{name}_real *inputs);

/* Prepare the next step, which will be elapsed [s] after this one; call it when the command is sent. */
void @{name}_prepare(@{name}_memory *unit, @{name}_real elapsed);

#ifdef __cplusplus
}
#endif

#endif
