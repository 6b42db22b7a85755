/* @title. Generated; do not edit.
 *
@about
 */
#include "@name.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "-ffast-math (-ffinite-math-only) takes away the test for what is not a number: compile without it"
#endif
#if DBL_MANT_DIG < 53
#error "a double has 32 bits here, which count time for minutes only: give the compiler its flag for 64 (-mdouble=64)"
#endif

/* A function of numbers side by side: they stay in vector registers where it is no part of another one. */
#if defined(__GNUC__)
#define @{NAME}_APART __attribute__((noinline))
#else
#define @{NAME}_APART
#endif

@structures
@tables
/* As Python has them: the first stays where one is not a number. */
static inline @{name}_real @{name}_min(@{name}_real a, @{name}_real b)
{
    return b < a ? b : a;
}

static inline @{name}_real @{name}_max(@{name}_real a, @{name}_real b)
{
    return b > a ? b : a;
}

static inline int @{name}_min_int(int a, int b)
{
    return b < a ? b : a;
}

static inline int @{name}_max_int(int a, int b)
{
    return b > a ? b : a;
}

/* ------------------------------------------------------------------ the solver of quadratic programs, DAQP */

int daqp_update_ldp(int mask, DAQPWorkspace *work, DAQPProblem *problem);
void *@{name}_allocate(size_t size);
void *@{name}_allocate_zeros(size_t count, size_t size);
void @{name}_release(void *memory);

static @{name}_memory *@{name}_in_use;

/* DAQP is compiled with these in place of malloc, calloc and free: it gets all its memory in @{name}_init. */
void *@{name}_allocate(size_t size)
{
    const int words = (int)((size + sizeof(@{name}_real) - 1) / sizeof(@{name}_real));
    @{name}_real *found = NULL;

    if (@{name}_in_use != NULL && words <= @arena - @{name}_in_use->used) {
        found = @{name}_in_use->arena + @{name}_in_use->used;
        @{name}_in_use->used += words;
    }
    return found;
}

void *@{name}_allocate_zeros(size_t count, size_t size)
{
    void *found = @{name}_allocate(count * size);

    if (found != NULL) {
        memset(found, 0, count * size);
    }
    return found;
}

void @{name}_release(void *memory)
{
    (void)memory;
}

static int @{name}_update(@{name}_memory *unit, int changed)
{
    return daqp_update_ldp(changed, &unit->workspace, &unit->problem);
}

static int @{name}_search(@{name}_memory *unit)
{
    daqp_solve(&unit->result, &unit->workspace);
    return unit->result.exitflag;
}

/* ------------------------------------------------------------------ the loop */

@exchange
@functions
/* ------------------------------------------------------------------ what begins as something else than zero */

@beginnings
size_t @{name}_size(void)
{
    return sizeof(@{name}_memory);
}

int @{name}_init(@{name}_memory *unit)
{
    int flag;

    memset(unit, 0, sizeof *unit);
@copies
    unit->problem.n = @variables;
    unit->problem.m = @constraints;
    unit->problem.ms = @variables;
    unit->problem.H = unit->program_hessian;
    unit->problem.f = unit->program_gradient;
@rows
    unit->problem.bupper = unit->program_upper;
    unit->problem.blower = unit->program_lower;
    unit->problem.sense = unit->program_states;
    unit->result.x = unit->program_solution;
    unit->result.lam = unit->program_multipliers;
    daqp_default_settings(&unit->settings);
    unit->settings.primal_tol = @tolerance;
    unit->back = NAN;
    unit->workspace.settings = &unit->settings;
    @{name}_in_use = unit;
    flag = setup_daqp(&unit->problem, &unit->workspace, NULL);
@soft
    @{name}_in_use = NULL;
    return flag > 0;
}

void @{name}_forget_estimate(@{name}_memory *unit)
{
    @forget_estimate;
    unit->back = NAN;
@begin_monitor
}

void @{name}_forget_plan(@{name}_memory *unit)
{
    @forget_plan;
@begin_guard
}

void @{name}_reset(@{name}_memory *unit)
{
    @{name}_forget_estimate(unit);
    @{name}_forget_plan(unit);
}

/* Whether time begins anew: with the second stamp in a row that is long before the newest one. */
static int @{name}_begins_anew(@{name}_memory *unit, double time)
{
    const double before = unit->back;

    unit->back = time < unit->origin + (double)unit->progress[0].answered - @restart ? time : NAN;
    return before < unit->back && unit->back < before + @restart;
}

int @{name}_observe(@{name}_memory *unit, const @{name}_measurement *measurement, @{name}_command *command)
{
    const double time = fabs(measurement->time) <= @largest_stamp ? measurement->time : NAN;
    int known;

    if (@{name}_begins_anew(unit, time)) {
        @{name}_reset(unit);
    }
    memcpy(unit->outputs, measurement->outputs, sizeof unit->outputs);
    memcpy(unit->applied, measurement->applied, sizeof unit->applied);
@rebase    known = @observe;
    memcpy(command->state, unit->out, sizeof command->state);
    memcpy(command->ahead, unit->out + @{NAME}_STATES, sizeof command->ahead);
    memcpy(command->disturbance, unit->instance + @{NAME}_STATES, sizeof command->disturbance);
    memcpy(command->inputs, unit->command, sizeof command->inputs);
    command->status = unit->progress[0].status;
    return known;
}

void @{name}_expected(@{name}_memory *unit, @{name}_real *outputs)
{
    @expect;
    memcpy(outputs, unit->outputs, sizeof unit->outputs);
}

void @{name}_judge(@{name}_memory *unit, const @{name}_real *applied, @{name}_command *command)
{
    memmove(unit->applied, applied, sizeof unit->applied);
    @judge;
    command->level = unit->guard_core[0].level;
    command->cause = unit->guard_core[0].cause + 1;
}

static void @{name}_answer_with(
    @{name}_memory *unit, const @{name}_real *now, const @{name}_reference *reference, int alone,
    @{name}_command *command)
{
    memcpy(unit->instance + @preview, reference->outputs, sizeof reference->outputs);
    if (now != NULL) {
        memcpy(unit->now, now, sizeof unit->now);
    }
    @decide;
    memcpy(command->inputs, unit->command, sizeof command->inputs);
    command->status = unit->progress[0].status;
}

void @{name}_decide_from(
    @{name}_memory *unit, const @{name}_real *now, const @{name}_reference *reference, @{name}_command *command)
{
    @{name}_answer_with(unit, now, reference, 0, command);
}

void @{name}_decide(@{name}_memory *unit, const @{name}_reference *reference, @{name}_command *command)
{
    @{name}_judge(unit, unit->applied, command);
    @{name}_decide_from(unit, reference->outputs, reference, command);
}

void @{name}_step(
    @{name}_memory *unit, const @{name}_measurement *measurement, const @{name}_reference *reference,
    @{name}_command *command)
{
    if (@{name}_observe(unit, measurement, command)) {
        @{name}_judge(unit, unit->applied, command);
        @{name}_answer_with(unit, reference->outputs, reference, 1, command);
    }
}

void @{name}_sent(@{name}_memory *unit, const @{name}_real *inputs)
{
    memcpy(unit->command, inputs, sizeof unit->command);
    @sent;
}

void @{name}_come_back(@{name}_memory *unit)
{
    unit->progress[0].returning = 1;
}

void @{name}_at_rest(@{name}_memory *unit, @{name}_real *inputs)
{
    @find_rest;
    memcpy(inputs, unit->plan, sizeof unit->plan);
}

void @{name}_lead(@{name}_memory *unit, const @{name}_real *outputs)
{
    memcpy(unit->now, outputs, sizeof unit->now);
    @lead;
}

void @{name}_prepare(@{name}_memory *unit, @{name}_real elapsed)
{
    @prepare;
}
