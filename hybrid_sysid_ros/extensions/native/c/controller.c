/* The controller: answers every estimate with a command, from the first layer that has one, as nodes/controller.py. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "std_msgs/msg/bool.h"
#include "trajectory_msgs/msg/joint_trajectory.h"

#include "control.h"

#define SHOW_PERIOD (SECOND / 10)       /* between two predicted trajectories */
#define REFERENCE_PATIENCE (3 * SECOND) /* that a controller waits for somebody who gives references */

static const enum layer layer_of[STATUSES] = {HELD, EXACT, EXACT, EXACT, SHIFTED, POLICY_LAYER, HELD, RESTED};

static inlet references, stops;
static bool waits; /* in lockstep, whether an estimate waits for a reference */
static estimate waiting;
static int64_t activated, shown, answered;

/* ------------------------------------------------------------------ answers */

static void forget(void)
{
    UNIT(forget_plan)(&unit);
    control.stamp = control.sound = shown = answered = control.acted = 0;
    control.settled = false;
    control.returning = !control.armed;
    memset(control.home, 0, sizeof control.home);
    memcpy(control.input, rest, sizeof control.input);
    reference_begin();
    waits = control.answered_once = false;
}

/* Remember where the outputs were found, where a reference begins after rest; whether they were numbers. */
static bool settle(const estimate *found)
{
    int k;

    if (control.settled) {
        return true;
    }
    control.settled = true;
    for (k = 0; k < OUTPUTS; k++) {
        control.home[k] = tracked[k] ? found->outputs[k] : 0.0;
        control.settled = control.settled && isfinite(control.home[k]);
    }
    if (control.settled && control.returning) {
        control.returning = false;
        UNIT(come_back)(&unit);
    }
    return control.settled;
}

/* The preview of an estimate; whether it moves, from the reference of now on. */
static bool preview_of(const estimate *found, double *now, double *preview)
{
    int i;

    if (control.mode == HOLD || !reference_is_there()) {
        control.layers[NO_REFERENCE] += control.mode != HOLD;
        for (i = 0; i < HORIZON; i++) {
            memcpy(preview + i * OUTPUTS, control.home, sizeof control.home);
        }
        return false;
    }
    if (!reference_covers(found->stamp)) { /* the next one begins where this one has ended */
        control.past_end++;
        reference_last(now);
        UNIT(lead)(&unit, now);
        for (i = 0; i < HORIZON; i++) {
            memcpy(preview + i * OUTPUTS, now, sizeof control.home);
        }
        return false;
    }
    for (i = 0; i < HORIZON; i++) {
        reference_at(found->stamp + REACH + llround(INTERVAL * (i + 1) * 1e9), preview + i * OUTPUTS);
    }
    reference_at(found->stamp + REACH, now);
    return true;
}

/* The level that the guard allows: a blind estimate says nothing, as one that is no number. */
static enum loop_state judge(const estimate *found)
{
    UNIT(real) applied[INPUTS];
    int k;

    memcpy(applied, found->applied, sizeof applied);
    for (k = 0; k < INPUTS && found->blind; k++) {
        applied[k] = NAN;
        unit.progress[0].doubt = unit.progress[0].without = NAN;
    }
    UNIT(judge)(&unit, applied, &control.newest);
    return (enum loop_state)control.newest.level;
}

static bool is_sound(const estimate *found)
{
    bool all = !found->blind;
    int k;

    for (k = 0; k < STATES; k++) {
        all = all && isfinite(found->answer.ahead[k]);
    }
    for (k = 0; k < INPUTS; k++) {
        all = all && isfinite(found->answer.disturbance[k]);
    }
    return all;
}

static void proceed(const estimate *found, double late)
{
    const int64_t began = steady();
    double now[OUTPUTS], inputs[INPUTS];
    UNIT(reference) reference;
    enum loop_state level;
    enum layer layer;
    bool moving;
    int k;

    control.stamp = found->stamp;
    control.newest = found->answer;
    control.blind = found->blind;
    level = judge(found);
    timing_add(&control.age, fmax(late, 0.0));
    if (operated(level) >= STOPPED) {
        stop_moving();
        return;
    }
    if (!is_sound(found) || !settle(found) || late > value(CONTROLLER_STALE_AFTER)) {
        hold_command();
        return;
    }
    if (level == RESTING) {
        rest_with(RESTED);
        return;
    }
    moving = preview_of(found, now, reference.outputs);
    UNIT(decide_from)(&unit, moving ? now : NULL, &reference, &control.newest);
    layer = layer_of[control.newest.status];
    control.statuses[control.newest.status]++;
    if (layer != SHIFTED && layer != HELD) {
        control.sound = time_of_loop();
    } else if (is_long()) {
        rest_with(ZEROED);
        return;
    }
    become(operated(level));
    control.layers[layer]++;
    for (k = 0; k < INPUTS; k++) {
        inputs[k] = (double)control.newest.inputs[k];
    }
    timing_add(&control.execution, (double)(steady() - began) / 1e9);
    send_command(inputs, true);
    UNIT(prepare)(&unit, (UNIT(real))(answered ? (double)(control.stamp - answered) / 1e9 : 0.0));
    answered = control.stamp;
    if (control.stamp - shown >= SHOW_PERIOD) {
        shown = control.stamp;
        output_show();
    }
}

void controller_repeat(void)
{
    if (controller_node.active) {
        control.repeated++;
        repeat_command();
    }
}

void controller_answer(const estimate *found, enum stamp_order order)
{
    const int64_t last = found->stamp + REACH + llround(INTERVAL * HORIZON * 1e9);

    if (!controller_node.active) {
        return;
    }
    if (order == RESTART) {
        forget();
    }
    if (LOCKSTEP && !reference_covers(last)) {
        waiting = *found;
        waits = true;
        return;
    }
    proceed(found, LOCKSTEP ? 0.0 : (double)(now() - found->stamp) / 1e9);
}

/* ------------------------------------------------------------------ the node */

static bool activate(node *own)
{
    static bool begun;

    if (!begun) {
        begun = true;
        operation_begin();
        output_begin(own);
    }
    validator_begin(&control.wishes, !LOCKSTEP, value(CONTROLLER_STAMP_AHEAD), value(CONTROLLER_STAMP_BEHIND),
                    value(CONTROLLER_SILENCE));
    control.mode = DRIVE;
    memset(control.layers, 0, sizeof control.layers);
    memset(control.statuses, 0, sizeof control.statuses);
    memset(control.times_in, 0, sizeof control.times_in);
    memset(&control.execution, 0, sizeof control.execution);
    memset(&control.age, 0, sizeof control.age);
    control.clipped = control.past_end = control.repeated = 0;
    control.state = operated(DRIVING);
    forget();
    activated = steady();
    return inlet_open(&references, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(trajectory_msgs, msg, JointTrajectory),
                      "reference")
           && inlet_open(&stops, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Bool), "estop")
           && output_open(own);
}

static double wind_down(void)
{
    control.mode = STOP;
    announce("at rest");
    return value(CONTROLLER_STOP_SECONDS) + 0.05;
}

static bool is_down(void)
{
    return !moves();
}

static void deactivate(node *own)
{
    if (moves()) {
        send_command(rest, false);
    }
    inlet_close(&references, &own->handle);
    inlet_close(&stops, &own->handle);
    output_close(own);
}

int controller_inlets(inlet **inlets)
{
    if (!controller_node.active) {
        return 0;
    }
    inlets[0] = &references;
    inlets[1] = &stops;
    return 2;
}

bool controller_receive(const inlet *from, const rcl_serialized_message_t *message)
{
    if (from == &references) {
        if (reference_take(message, &control.wishes, LOCKSTEP ? control.stamp : now(), &control.clipped) && waits) {
            waits = false;
            controller_answer(&waiting, NEW);
        }
    } else if (from == &stops && message->buffer_length > 4 && message->buffer[4]) {
        stop_at_once("the topic estop");
    }
    return from == &references || from == &stops;
}

/* Let the inputs rest when estimates stop: not every drive has a timeout of its own. */
void controller_look(void)
{
    if (!controller_node.active) {
        return;
    }
    if (!output_is_open()) {
        const bool may = !LOCKSTEP && steady() - activated > REFERENCE_PATIENCE;

        if (estimator_is_heard() && (inlet_writers(&references) > 0 || may)) {
            output_open_commands(&controller_node);
        }
    }
    if (!LOCKSTEP && moves() && (double)(steady() - control.acted) / 1e9 > value(CONTROLLER_ZERO_AFTER)) {
        rest_with(ZEROED);
    }
}

static bool reset(char *words)
{
    (void)words;
    operation_reset();
    forget();
    return true;
}

static trigger triggers[] = {
    {"enable", operation_enable, {0}}, {"hold", operation_hold, {0}}, {"stop", operation_stop, {0}},
    {"reset", reset, {0}}, {"arm", operation_arm, {0}}, {"disarm", operation_disarm, {0}},
    {"estop", operation_estop, {0}},
};

node controller_node = {
    .name = "controller", .parameters = controller_parameters, .count = CONTROLLER_PARAMETERS, .triggers = triggers,
    .trigger_count = sizeof triggers / sizeof triggers[0], .activate = activate, .wind_down = wind_down,
    .is_down = is_down, .deactivate = deactivate, .health = controller_health,
};
