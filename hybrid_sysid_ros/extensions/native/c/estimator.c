/* The estimator: answers every measurement with the present state, and the one at which the next command will act. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "sensor_msgs/msg/joint_state.h"
#include "std_msgs/msg/float64_multi_array.h"

#include "estimator.h"

#define SHOW_PERIOD (SECOND / 20) /* between two covariances */
#define SOON 0.6                  /* periods, below which measurements are more frequent than expected */
#define LONGEST_GAP 1.0           /* s, after which an estimate begins anew */
#define NUMBERS (2 * STATES + 3 * INPUTS + FURTHER + 2 + FOLLOWED + INPUTS)

estimator_state estimation;

static inlet measurements, commands;
static bool makes_do; /* with best effort */
static bool listens; /* to commands, which stand for inputs that a driver does not report */
static outlet estimates, covariances;
static validator others;
static slot_reader measured, commanded;
static written_message message;
static int64_t zero, usable, shown, first_stamp;
static double known[INPUTS];
static void (*answer_estimate)(const estimate *found, enum stamp_order order);
static void (*repeat_answer)(void);

void estimator_serves(void (*answers)(const estimate *found, enum stamp_order order), void (*repeats)(void))
{
    answer_estimate = answers;
    repeat_answer = repeats;
}

static void forget(void)
{
    UNIT(forget_estimate)(&unit);
    estimation.newest.stamp = zero = usable = shown = 0;
    first_stamp = 0;
    estimation.seen = 0;
}

static bool reset(char *words)
{
    (void)words;
    forget();
    return true;
}

static bool activate(node *own)
{
    const bool timed = !LOCKSTEP;
    int j;

    memset(&estimation, 0, sizeof estimation);
    validator_begin(&estimation.entry, timed, value(ESTIMATOR_STAMP_AHEAD), value(ESTIMATOR_STAMP_BEHIND),
                    value(ESTIMATOR_SILENCE));
    others = estimation.entry;
    if (measured.found == NULL) {
        measured = slot_reader_of(measured_slots, OUTPUTS + INPUTS, INPUTS);
        commanded = slot_reader_of(measured_slots + OUTPUTS, INPUTS, 0);
        message = joints_written(&estimate_form, own->signature);
    }
    forget();
    for (j = 0; j < INPUTS; j++) {
        known[j] = NAN;
    }
    return inlet_open(&measurements, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, JointState),
                      "joint_states")
           && outlet_open(&covariances, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Float64MultiArray),
                          "state_covariance");
}

static void deactivate(node *own)
{
    inlet_close(&measurements, &own->handle);
    if (listens) {
        inlet_close(&commands, &own->handle);
    }
    listens = makes_do = false;
    outlet_close(&estimates, &own->handle);
    outlet_close(&covariances, &own->handle);
}

int estimator_inlets(inlet **inlets)
{
    int count = 0;

    if (estimator_node.active) {
        inlets[count++] = &measurements;
        if (listens) {
            inlets[count++] = &commands;
        }
    }
    return count;
}

bool estimator_is_heard(void)
{
    return estimator_node.active && inlet_writers(&measurements) > 0;
}

int64_t estimator_silence(void)
{
    return estimation.newest.stamp && estimation.entry.heard ? steady() - estimation.entry.heard : -1;
}

/* Open what waits for somebody who publishes measurements. */
void estimator_look(void)
{
    static int64_t looked;

    if (!estimator_node.active) {
        return;
    }
    if (!makes_do && !estimator_is_heard() && steady() - looked > SECOND / 5) {
        looked = steady();
        makes_do = inlet_make_do(&measurements, &estimator_node.handle,
                                 ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, JointState), "joint_states");
    }
    if (!estimates.open && estimator_is_heard()) {
        outlet_open(&estimates, &estimator_node.handle, ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, JointState),
                    "state_estimate");
    }
}

static void publish(void)
{
    if (estimates.open) {
        message_publish(&message, estimation.newest.stamp, &estimates.publisher);
    }
}

/* Write the newest estimate into its message: NAN where nothing may be made of it. */
static void pack(const double *applied)
{
    double numbers[NUMBERS];
    int at = 0, k;

    for (k = 0; k < STATES; k++) {
        numbers[at++] = (double)estimation.newest.answer.state[k];
    }
    for (k = 0; k < FURTHER; k++) {
        numbers[at++] = estimation.newest.outputs[further_outputs[k]];
    }
    for (k = 0; k < INPUTS; k++) {
        numbers[at++] = (double)estimation.newest.answer.disturbance[k];
    }
    for (k = 0; k < STATES; k++) {
        numbers[at++] = (double)estimation.newest.answer.ahead[k];
    }
    for (k = 0; k < INPUTS; k++) {
        numbers[at++] = (double)estimation.newest.answer.disturbance[k];
    }
    for (k = 0; k < INPUTS; k++) {
        numbers[at++] = k == (int)unit.progress[0].reversed ? -applied[k] : applied[k];
    }
    numbers[at++] = unit.progress[0].doubt;
    numbers[at++] = unit.progress[0].without;
    numbers[at++] = unit.progress[0].reversed;
    for (k = 0; k < FOLLOWED; k++) {
        numbers[at++] = (double)unit.out[2 * STATES + INPUTS + k];
    }
    for (k = 0; estimation.newest.blind && k < at; k++) {
        numbers[k] = NAN;
    }
    message_write(&message, 0, numbers);
}

static void count(const double *given, int64_t stamp)
{
    const double elapsed = (double)(stamp - estimation.newest.stamp) / 1e9;
    int k;

    if (estimation.newest.stamp && elapsed > 0.0) {
        const double between = round(elapsed / PERIOD) - 1.0;

        estimation.missing += between > 0.0 ? (long)between : 0;
        estimation.too_soon += elapsed < SOON * PERIOD;
    }
    for (k = 0; k < INPUTS; k++) {
        estimation.unknown += isnan(given[OUTPUTS + k]) && isnan(known[k]);
    }
}

static void answer(const double *given, int64_t stamp, enum stamp_order order, int64_t began)
{
    UNIT(measurement) measurement;
    bool any = false;
    int k;

    if (order == DUPLICATE) {
        estimation.repeated++;
        publish();
        repeat_answer();
        return;
    }
    if (order == RESTART) {
        forget();
        estimation.restarts++;
    }
    zero = zero ? zero : stamp;
    count(given, stamp);
    measurement.time = (double)(stamp - zero) / 1e9;
    for (k = 0; k < OUTPUTS; k++) {
        measurement.outputs[k] = (UNIT(real))given[k];
    }
    for (k = 0; k < INPUTS; k++) {
        measurement.applied[k] = (UNIT(real))(isnan(given[OUTPUTS + k]) ? known[k] : given[OUTPUTS + k]);
    }
    if (!UNIT(observe)(&unit, &measurement, &estimation.newest.answer)) {
        estimation.unusable++;
        return;
    }
    for (k = 0; k < OUTPUTS; k++) { /* without those of sensors that are frozen or left out */
        any = any || isfinite(unit.outputs[k]);
        estimation.invalid += !isfinite(unit.outputs[k]);
        estimation.updates += isfinite(unit.outputs[k]) != 0;
    }
    usable = any && stamp > usable ? stamp : usable;
    if (order == LATE) {
        estimation.late++;
        return;
    }
    estimation.newest.stamp = stamp;
    estimation.newest.began = began;
    estimation.newest.blind = (double)(stamp - usable) / 1e9 > value(ESTIMATOR_SENSOR_TIMEOUT);
    estimation.blind += estimation.newest.blind;
    UNIT(real) expected[OUTPUTS];
    UNIT(expected)(&unit, expected);
    for (k = 0; k < OUTPUTS; k++) {
        const double normalised = (double)unit.out[2 * STATES + INPUTS + FOLLOWED + OUTPUTS + 1 + k];

        estimation.newest.outputs[k] = (double)expected[k];
        estimation.gated += normalised > GATE;
    }
    estimation.innovations[estimation.seen++ % WINDOW] = (double)unit.out[2 * STATES + INPUTS + FOLLOWED + OUTPUTS];
    timing_add(&estimation.execution, (double)(steady() - began) / 1e9);
    for (k = 0; k < INPUTS; k++) {
        estimation.newest.applied[k] = (UNIT(real))given[OUTPUTS + k];
    }
    answer_estimate(&estimation.newest, order); /* first of all: the rig waits for it */
    pack(given + OUTPUTS);
    publish();
    if (stamp - shown >= SHOW_PERIOD) {
        shown = stamp;
        if (outlet_is_read(&covariances)) {
            static uint8_t data[256 + sizeof(COVARIANCE_LABEL) + 8 * sizeof unit.P / sizeof unit.P[0]];
            cdr_writer writer = cdr_open(data, sizeof data);
            double numbers[sizeof unit.P / sizeof unit.P[0]];

            for (k = 0; k < (int)(sizeof unit.P / sizeof unit.P[0]); k++) {
                numbers[k] = (double)unit.P[k];
            }
            cdr_write_whole(&writer, 2);
            cdr_write_text(&writer, COVARIANCE_LABEL);
            cdr_write_whole(&writer, COVARIANCE_SIZE);
            cdr_write_whole(&writer, COVARIANCE_SIZE * COVARIANCE_SIZE);
            cdr_write_text(&writer, "the same");
            cdr_write_whole(&writer, COVARIANCE_SIZE);
            cdr_write_whole(&writer, COVARIANCE_SIZE);
            cdr_write_whole(&writer, 0);
            cdr_write_whole(&writer, COVARIANCE_SIZE * COVARIANCE_SIZE);
            cdr_write_words(&writer, numbers, COVARIANCE_SIZE * COVARIANCE_SIZE);
            cdr_publish(&covariances.publisher, data, writer.at);
        }
    }
}

bool estimator_receive(const inlet *from, const rcl_serialized_message_t *given)
{
    const int64_t began = steady();
    double values[OUTPUTS + INPUTS];
    joint_states joints;
    enum stamp_order order;
    bool lacks = false;
    int k;

    if (from == &commands) {
        if (joints_unpack(given, &others, &joints) && joints_read(&joints, &commanded, &others, values)
            && validator_accepts_source(&others, joints.source)) {
            validator_select_source(&others, joints.source);
            for (k = 0; k < INPUTS; k++) {
                known[k] = isfinite(values[k]) ? values[k] : known[k];
            }
        }
        return true;
    }
    if (from != &measurements) {
        return false;
    }
    if (!joints_unpack(given, &estimation.entry, &joints) || !joints_read(&joints, &measured, &estimation.entry, values)
        || (order = validator_admit(&estimation.entry, joints.source, joints.stamp)) == REFUSED) {
        return true;
    }
    answer(values, joints.stamp, order, began);
    for (k = 0; k < INPUTS; k++) {
        lacks = lacks || isnan(values[OUTPUTS + k]);
    }
    if (lacks && !listens) {
        listens = inlet_open(&commands, &estimator_node.handle,
                             ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, JointState), "joint_command");
    }
    return true;
}

static trigger triggers[] = {{"reset", reset, {0}}};

node estimator_node = {
    .name = "estimator", .parameters = estimator_parameters, .count = ESTIMATOR_PARAMETERS, .triggers = triggers,
    .trigger_count = 1, .activate = activate, .deactivate = deactivate, .health = estimator_health,
};
