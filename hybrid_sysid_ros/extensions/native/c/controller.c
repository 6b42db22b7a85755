/* The controller: answers every estimate with a command, from the first layer that has one, as nodes/controller.py. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "sensor_msgs/msg/joint_state.h"
#include "std_msgs/msg/bool.h"
#include "std_msgs/msg/float64_multi_array.h"
#include "trajectory_msgs/msg/joint_trajectory.h"

#include "reference.h"

#define SHOW_PERIOD (SECOND / 10)          /* between two predicted trajectories */
#define REFERENCE_PATIENCE (3 * SECOND)    /* that a controller waits for somebody who gives references */
#define LONGEST 0.05                       /* s, as long as a first command may count */

#define value(which) value_of(&controller_node, which)

enum mode { DRIVE, HOLD, STOP };
enum loop_state { DRIVING, SLOWED, HOLDING, RESTING, STOPPED, DISARMED, STATES_OF_LOOP };
static const char *const state_words[STATES_OF_LOOP] = {
    "driving", "slowed", "holding", "resting", "stopped", "disarmed"};

enum layer { EXACT, POLICY_LAYER, SHIFTED, HELD, ZEROED, STOPPED_LAYER, NO_REFERENCE, LAYERS };
static const char *const layer_words[LAYERS] = {
    "exact", "policy", "shifted_plan", "held", "zeroed", "stopped", "no_reference"};

enum status { WAITING, SOLVED, ITERATED, NOT_CONVERGED, FAILED, POLICY, KEPT, STATUSES }; /* as the unit's */
static const char *const status_words[STATUSES] = {
    "waiting", "solved", "iterated", "not_converged", "failed", "policy", "held"};
static const enum layer layer_of[STATUSES] = {HELD, EXACT, EXACT, EXACT, SHIFTED, POLICY_LAYER, HELD};

static rcl_subscription_t references, stops;
static outlet commands, efforts, plans;
static validator wishes;
static written_message command, plan;
static bool answered_once, waits; /* waits: in lockstep, an estimate waits for a reference */
static estimate waiting;

static enum mode mode;
static bool armed, emergency;
static char reason[WORDS]; /* why the loop may not move */
static enum loop_state state;

static int64_t activated, stamp, sound, shown, answered, acted;
static bool settled, returning;
static double home[OUTPUTS], input[INPUTS];
static UNIT(command) newest;
static long layers[LAYERS], statuses[STATUSES], times_in[STATES_OF_LOOP], clipped, past_end, repeated;
static timing execution, age;
static troubles loop_troubles, policy_troubles;

/* ------------------------------------------------------------------ operation, as nodes/operation.py */

static const char *way_back(void)
{
    return emergency ? "call the services reset and arm" : "call the service arm";
}

static const char *operation_words(char *words)
{
    if (!armed) {
        snprintf(words, WORDS, "disarmed (%.300s): %s", reason, way_back());
    } else if (mode == DRIVE) {
        words[0] = 0;
    } else {
        snprintf(words, WORDS, "%s until the service enable is called",
                 mode == STOP ? "stopped" : "holding the outputs");
    }
    return words;
}

static void say(const char *which)
{
    char words[WORDS];

    operation_words(words);
    announce("%s: %s", which, *words ? words : "the loop drives");
}

static enum loop_state operated(enum loop_state level)
{
    if (!armed) {
        return DISARMED;
    }
    return mode == STOP ? STOPPED : mode == HOLD && level < HOLDING ? HOLDING : level;
}

static void become(enum loop_state next)
{
    times_in[next] += next != state;
    state = next;
}

/* ------------------------------------------------------------------ commands */

static int64_t time_of_loop(void)
{
    return LOCKSTEP ? stamp : steady();
}

static bool moves(void)
{
    return memcmp(input, rest, sizeof input) != 0;
}

static void repeat(void)
{
    if (!answered_once) {
        return;
    }
    if (commands.open) {
        message_publish(&command, stamp, &commands.publisher);
    }
    if (outlet_is_read(&efforts)) {
        uint8_t data[32 + 8 * INPUTS];
        cdr_writer writer = cdr_open(data, sizeof data);

        cdr_write_whole(&writer, 0);
        cdr_write_whole(&writer, 0);
        cdr_write_whole(&writer, INPUTS);
        cdr_write_words(&writer, input, INPUTS);
        cdr_publish(&efforts.publisher, data, writer.at);
    }
}

/* Publish a command that answers the newest estimate; limited: no faster than the actuators can follow. Whatever it is,
 * it is a number within the actuator's limits. */
static void send(const double *inputs, bool limited)
{
    const int64_t time = time_of_loop();
    const double elapsed = acted ? (double)(time - acted) / 1e9 : fmin(INTERVAL, LONGEST);
    UNIT(real) sent[INPUTS];
    int j;

    for (j = 0; j < INPUTS; j++) {
        const double room = input_rate[j] * fmax(elapsed, 0.0);
        double u = isfinite(inputs[j]) ? inputs[j] : rest[j];

        u = limited ? fmin(fmax(u, input[j] - room), input[j] + room) : u;
        input[j] = fmin(fmax(u, input_low[j]), input_high[j]);
        sent[j] = (UNIT(real))input[j];
    }
    acted = time;
    UNIT(sent)(&unit, sent);
    message_write(&command, 0, input);
    answered_once = true;
    repeat();
}

/* Inputs at rest: of a rig with a stabiliser what that makes of the newest state, without which it would fall. */
static void at_rest(double *found)
{
    bool known = stamp != 0;
    int j, a;

    for (a = 0; a < STATES; a++) {
        known = known && isfinite(newest.ahead[a]);
    }
    for (j = 0; j < INPUTS; j++) {
        found[j] = rest[j];
        if (STABILISED && known) {
            found[j] = 0.0;
            for (a = 0; a < STATES; a++) {
                found[j] -= gains[j * STATES + a] * (double)newest.ahead[a];
            }
            found[j] = fmin(fmax(found[j], input_low[j]), input_high[j]);
        }
    }
}

static void rest_with(enum layer layer)
{
    layers[layer]++;
    settled = false;
    returning = true;
    become(operated(RESTING));
    send(rest, true);
}

static bool is_long(void)
{
    return !sound || (double)(time_of_loop() - sound) / 1e9 > value(CONTROLLER_ZERO_AFTER);
}

static void hold(void)
{
    if (is_long()) {
        rest_with(ZEROED);
        return;
    }
    layers[HELD]++;
    send(input, true);
}

static void stop(void)
{
    const double seconds = value(CONTROLLER_STOP_SECONDS);
    double share = 1.0, found[INPUTS];
    int j;

    if (seconds > 0.0 && !emergency) {
        share = fmin((double)(time_of_loop() - acted) / 1e9 / seconds, 1.0);
    }
    at_rest(found);
    for (j = 0; j < INPUTS; j++) {
        const double away = input[j] - found[j], room = share * (input_high[j] - input_low[j]);

        found[j] += copysign(fmax(fabs(away) - room, 0.0), away);
    }
    layers[STOPPED_LAYER]++;
    become(operated(RESTING));
    settled = false;
    returning = true;
    send(found, true);
}

/* ------------------------------------------------------------------ answers */

static void forget(void)
{
    UNIT(forget_plan)(&unit);
    governor_release();
    stamp = sound = shown = answered = acted = 0;
    settled = false;
    returning = !armed;
    memset(home, 0, sizeof home);
    memcpy(input, rest, sizeof input);
    reference_begin();
    waits = answered_once = false;
}

/* Remember where the outputs were found, where a reference begins after rest; whether they were numbers. */
static bool settle(const estimate *found)
{
    double start[OUTPUTS];
    int k;

    if (settled) {
        return true;
    }
    settled = true;
    for (k = 0; k < OUTPUTS; k++) {
        home[k] = tracked[k] ? found->outputs[k] : 0.0;
        settled = settled && isfinite(home[k]);
    }
    if (settled && returning) {
        returning = false;
        UNIT(forget_plan)(&unit);
        governor_within_reach(home, start);
        governor_begin(start);
    }
    return settled;
}

static void preview_of(const estimate *found, double elapsed, double *preview)
{
    double ahead[OUTPUTS];
    int i;

    if (mode == HOLD || !reference_is_there()) {
        layers[NO_REFERENCE] += mode != HOLD;
        for (i = 0; i < HORIZON; i++) {
            memcpy(preview + i * OUTPUTS, home, sizeof home);
        }
        return;
    }
    if (!reference_covers(found->stamp)) { /* the next one begins where this one has ended */
        past_end++;
        reference_last(ahead);
        governor_begin(ahead);
        for (i = 0; i < HORIZON; i++) {
            memcpy(preview + i * OUTPUTS, ahead, sizeof ahead);
        }
        return;
    }
    for (i = 0; i < HORIZON; i++) {
        reference_at(found->stamp + REACH + llround(INTERVAL * (i + 1) * 1e9), preview + i * OUTPUTS);
    }
    if (!governor_is_free()) {
        reference_at(found->stamp + REACH, ahead);
        governor_follow(ahead, preview, elapsed);
    }
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

static void show(void)
{
    double numbers[STATES + INPUTS];
    int i, k;

    if (!outlet_is_read(&plans)) {
        return;
    }
    for (i = 0; i < HORIZON; i++) {
        for (k = 0; k < STATES; k++) {
            numbers[k] = (double)unit.horizon_states[(i + 1) * STATES + k];
        }
        for (k = 0; k < INPUTS; k++) {
            numbers[STATES + k] = (double)unit.horizon_planned[i * INPUTS + k];
        }
        message_write(&plan, i, numbers);
    }
    message_publish(&plan, stamp + REACH, &plans.publisher);
}

static void proceed(const estimate *found, double late)
{
    const double elapsed = stamp ? (double)(found->stamp - stamp) / 1e9 : 0.0;
    const int64_t began = steady();
    double preview[HORIZON * OUTPUTS], inputs[INPUTS];
    UNIT(reference) reference;
    enum layer layer;
    int k;

    stamp = found->stamp;
    newest = found->answer;
    timing_add(&age, fmax(late, 0.0));
    if (operated(DRIVING) >= STOPPED) {
        stop();
        return;
    }
    if (!is_sound(found) || !settle(found) || late > value(CONTROLLER_STALE_AFTER)) {
        hold();
        return;
    }
    preview_of(found, elapsed, preview);
    for (k = 0; k < HORIZON * OUTPUTS; k++) {
        reference.outputs[k] = (UNIT(real))preview[k];
    }
    UNIT(decide)(&unit, &reference, &newest);
    layer = layer_of[newest.status];
    statuses[newest.status]++;
    if (layer != SHIFTED && layer != HELD) {
        sound = time_of_loop();
    } else if (is_long()) {
        rest_with(ZEROED);
        return;
    }
    become(operated(DRIVING));
    layers[layer]++;
    for (k = 0; k < INPUTS; k++) {
        inputs[k] = (double)newest.inputs[k];
    }
    timing_add(&execution, (double)(steady() - began) / 1e9);
    send(inputs, true);
    UNIT(prepare)(&unit, (UNIT(real))(answered ? (double)(stamp - answered) / 1e9 : 0.0));
    answered = stamp;
    if (stamp - shown >= SHOW_PERIOD) {
        shown = stamp;
        show();
    }
}

void controller_repeat(void)
{
    if (controller_node.active) {
        repeated++;
        repeat();
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

void controller_commanded(double *inputs)
{
    memcpy(inputs, input, sizeof input);
}

/* ------------------------------------------------------------------ services */

static bool turn_to(enum mode next, char *words)
{
    const enum mode before = mode;

    if (next != STOP && !armed) {
        snprintf(words, WORDS, "the loop is disarmed (%.300s): %s", reason, way_back());
        return false;
    }
    mode = next;
    say(next == DRIVE ? "may move" : "at rest");
    if (before == HOLD && next == DRIVE && settled) {
        governor_begin(home);
    }
    settled = settled && next == DRIVE;
    return true;
}

static bool enable(char *words)
{
    return turn_to(DRIVE, words);
}

static bool hold_outputs(char *words)
{
    return turn_to(HOLD, words);
}

static bool stop_moving(char *words)
{
    return turn_to(STOP, words);
}

static bool reset(char *words)
{
    (void)words;
    if (emergency) {
        emergency = false;
        say("at rest");
    }
    forget();
    return true;
}

static bool stop_at_once(const char *why)
{
    double found[INPUTS];

    if (!emergency) {
        armed = false;
        emergency = true;
        snprintf(reason, sizeof reason, "emergency stop by %s", why);
        say("at rest");
    }
    at_rest(found);
    send(found, false);
    return true;
}

static bool estop(char *words)
{
    (void)words;
    return stop_at_once("the service estop or a stop by hand");
}

static bool disarm(char *words)
{
    (void)words;
    armed = false;
    if (!*reason) {
        snprintf(reason, sizeof reason, "by the service disarm");
    }
    say("at rest");
    return true;
}

/* What is in the way of arming, or "". */
static const char *unready(void)
{
    const int64_t silent = estimator_silence();
    int k;

    if (silent < 0 || (double)silent / 1e9 > value(CONTROLLER_STALE_SECONDS)) {
        return "no estimates come on state_estimate: start the estimator and the sensors";
    }
    for (k = 0; k < STATES; k++) {
        if (!isfinite(newest.ahead[k])) {
            return "the estimates are no numbers: look at the estimator's diagnostics";
        }
    }
    return "";
}

static bool arm(char *words)
{
    if (emergency) {
        snprintf(words, WORDS, "%.300s is latched: call the service reset before", reason);
        return false;
    }
    if (*unready()) {
        snprintf(words, WORDS, "not ready to be armed: %s", unready());
        return false;
    }
    armed = true;
    mode = DRIVE;
    reason[0] = 0;
    say("may move");
    return true;
}

static trigger triggers[] = {
    {"enable", enable, {0}}, {"hold", hold_outputs, {0}}, {"stop", stop_moving, {0}}, {"reset", reset, {0}},
    {"arm", arm, {0}}, {"disarm", disarm, {0}}, {"estop", estop, {0}},
};

/* ------------------------------------------------------------------ the node */

static bool activate(node *own)
{
    static bool begun;

    if (!begun) {
        begun = true;
        armed = value(CONTROLLER_ARMED) != 0.0;
        command = joints_written(&command_form, own->signature);
        plan = trajectory_written(&plan_form, HORIZON, INTERVAL, own->signature);
        if (!armed) {
            snprintf(reason, sizeof reason, "not armed yet");
            say("at rest");
        }
    }
    validator_begin(&wishes, !LOCKSTEP, value(CONTROLLER_STAMP_AHEAD), value(CONTROLLER_STAMP_BEHIND),
                    value(CONTROLLER_SILENCE));
    mode = DRIVE;
    memset(layers, 0, sizeof layers);
    memset(statuses, 0, sizeof statuses);
    memset(times_in, 0, sizeof times_in);
    memset(&execution, 0, sizeof execution);
    memset(&age, 0, sizeof age);
    clipped = past_end = repeated = 0;
    state = operated(DRIVING);
    forget();
    activated = steady();
    return inlet_open(&references, own, ROSIDL_GET_MSG_TYPE_SUPPORT(trajectory_msgs, msg, JointTrajectory), "reference")
           && inlet_open(&stops, own, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Bool), "estop")
           && outlet_open(&efforts, own, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Float64MultiArray),
                          "effort_command")
           && outlet_open(&plans, own, ROSIDL_GET_MSG_TYPE_SUPPORT(trajectory_msgs, msg, JointTrajectory),
                          "predicted_trajectory");
}

static double wind_down(void)
{
    mode = STOP;
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
        send(rest, false);
    }
    (void)!rcl_subscription_fini(&references, &own->handle);
    (void)!rcl_subscription_fini(&stops, &own->handle);
    outlet_close(&commands, own);
    outlet_close(&efforts, own);
    outlet_close(&plans, own);
}

int controller_inlets(rcl_subscription_t **inlets)
{
    if (!controller_node.active) {
        return 0;
    }
    inlets[0] = &references;
    inlets[1] = &stops;
    return 2;
}

bool controller_receive(const rcl_subscription_t *inlet, const rcl_serialized_message_t *message)
{
    if (inlet == &references) {
        if (reference_take(message, &wishes, LOCKSTEP ? stamp : now(), &clipped) && waits) {
            waits = false;
            controller_answer(&waiting, NEW);
        }
    } else if (inlet == &stops && message->buffer_length > 4 && message->buffer[4]) {
        stop_at_once("the topic estop");
    }
    return inlet == &references || inlet == &stops;
}

/* Let the inputs rest when estimates stop: not every drive has a timeout of its own. */
void controller_look(void)
{
    size_t publishers = 0;

    if (!controller_node.active) {
        return;
    }
    if (!commands.open) {
        const bool may = !LOCKSTEP && steady() - activated > REFERENCE_PATIENCE;

        (void)!rcl_subscription_get_publisher_count(&references, &publishers);
        if (estimator_is_heard() && (publishers > 0 || may)) {
            outlet_open(&commands, &controller_node, ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, JointState),
                        "joint_command");
        }
    }
    if (!LOCKSTEP && moves() && (double)(steady() - acted) / 1e9 > value(CONTROLLER_ZERO_AFTER)) {
        rest_with(ZEROED);
    }
}

static int health(task *tasks)
{
    task *loop = &tasks[0], *policy = &tasks[1];
    const double warn = value(CONTROLLER_WARN_SHARE), error = value(CONTROLLER_ERROR_SHARE);
    char words[WORDS], key[96];
    long answers = 0, dropped = 0;
    int k;

    for (k = 0; k < NO_REFERENCE; k++) {
        answers += layers[k];
    }
    task_begin(loop, "loop");
    trouble(&loop_troubles, "answers without a reference", layers[NO_REFERENCE]);
    trouble(&loop_troubles, "commands held", layers[HELD]);
    trouble(&loop_troubles, "commands at rest", layers[ZEROED]);
    trouble(&loop_troubles, "answers after the end of the reference", past_end);
    trouble(&loop_troubles, "references beyond the travel", clipped);
    for (k = 0; k < REASONS; k++) {
        dropped += wishes.dropped[k];
        if (k != UNRELATED) {
            snprintf(words, sizeof words, "references %s", reason_words[k]);
            trouble(&loop_troubles, words, wishes.dropped[k]);
        }
    }
    task_judge(loop, &loop_troubles, answers, warn, error);
    task_text(loop, "state", state_words[state]);
    operation_words(words);
    task_text(loop, "state_reason",
              state == RESTING ? "there is no sound estimate, or no answer to it" : words);
    task_text(loop, "ready", *unready() ? unready() : "yes");
    for (k = 0; k < STATES_OF_LOOP; k++) {
        snprintf(key, sizeof key, "times_%s", state_words[k]);
        task_whole(loop, key, times_in[k]);
    }
    task_text(loop, "policy", controller_parameters[CONTROLLER_POLICY].text);
    task_whole(loop, "commands", answers);
    for (k = 0; k < LAYERS; k++) {
        if (layers[k]) {
            snprintf(key, sizeof key, "layer_%s", layer_words[k]);
            task_whole(loop, key, layers[k]);
        }
    }
    task_whole(loop, "dropped_references", dropped);
    task_whole(loop, "clipped_references", clipped);
    task_whole(loop, "repeated_estimates", repeated);
    task_text(loop, "body", BODY);
    task_text(loop, "not_watched", NOT_WATCHED_LOOP);
    task_timing(loop, "execution", &execution);
    task_timing(loop, "estimate_age", &age);
    if (*words && (loop->level == OK || emergency)) {
        loop->level = emergency && loop->level < WARN ? WARN : loop->level;
        snprintf(loop->message, sizeof loop->message, "%s", words);
    } else if (!stamp && loop->level == OK) {
        snprintf(loop->message, sizeof loop->message, "waiting for estimates");
    } else if (estimator_silence() >= 0 && (double)estimator_silence() / 1e9 > value(CONTROLLER_STALE_SECONDS)) {
        loop->level = STALE;
        snprintf(loop->message, sizeof loop->message, "nothing on state_estimate for %.1f s",
                 (double)estimator_silence() / 1e9);
    }
    task_begin(policy, "policy");
    trouble(&policy_troubles, "plans not converged", statuses[NOT_CONVERGED]);
    trouble(&policy_troubles, "plans failed", statuses[FAILED]);
    trouble(&policy_troubles, "plans held", statuses[KEPT]);
    task_judge(policy, &policy_troubles, answers, warn, error);
    for (k = 0; k < STATUSES; k++) {
        if (statuses[k]) {
            snprintf(key, sizeof key, "status_%s", status_words[k]);
            task_whole(policy, key, statuses[k]);
        }
    }
    return 2;
}

node controller_node = {
    .name = "controller", .parameters = controller_parameters, .count = CONTROLLER_PARAMETERS, .triggers = triggers,
    .trigger_count = 7, .activate = activate, .wind_down = wind_down, .is_down = is_down, .deactivate = deactivate,
    .health = health,
};

/* ------------------------------------------------------------------ both nodes */

void loop_begin(void)
{
    if (!UNIT(init)(&unit)) {
        refuse("the memory of the loop's solver is too small: report this");
    }
    UNIT(reset)(&unit);
}

int loop_inlets(rcl_subscription_t **inlets)
{
    const int count = estimator_inlets(inlets);

    return count + controller_inlets(inlets + count);
}

void loop_receive(const rcl_subscription_t *inlet, const rcl_serialized_message_t *message)
{
    (void)(estimator_receive(inlet, message) || controller_receive(inlet, message));
}

void loop_look(void)
{
    estimator_look();
    controller_look();
}
