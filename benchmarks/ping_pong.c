/* A simulated plant, and a relay without a controller: ping_pong relay | probe RATE SECONDS, on rcl alone.
 *
 * The probe publishes joint_states with the time of now, and a reference once a second, takes joint_command, which moves
 * the plant, and prints the delays of the answers in seconds, one a line. The relay answers each measurement with its own
 * bytes, whose input is the last one. PLANT(what), JOINT and WHITE [rad] come from the compiler's arguments.
 */
#define _GNU_SOURCE
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "rcl/error_handling.h"
#include "sensor_msgs/msg/joint_state.h"
#include "trajectory_msgs/msg/joint_trajectory.h"

#include "cdr.h"
#include PLANT_HEADER

static rcl_context_t probe_context;
static rcl_node_t node;
static rcl_wait_set_t set;
static PLANT(memory) plant;

static void check(rcl_ret_t found)
{
    if (found != RCL_RET_OK) {
        fprintf(stderr, "error: %s\n", rcl_get_error_string().str);
        exit(1);
    }
}

static int64_t time_of(clockid_t clock)
{
    struct timespec time;

    clock_gettime(clock, &time);
    return time.tv_sec * SECOND + time.tv_nsec;
}

static bool wait_for(rcl_subscription_t *inlet, int64_t most, rcl_serialized_message_t *message)
{
    check(rcl_wait_set_clear(&set));
    check(rcl_wait_set_add_subscription(&set, inlet, NULL));
    if (rcl_wait(&set, most > 0 ? most : 0) != RCL_RET_OK || set.subscriptions[0] == NULL) {
        rcl_reset_error();
        return false;
    }
    if (rcl_take_serialized_message(inlet, message, NULL, NULL) != RCL_RET_OK) {
        rcl_reset_error();
        return false;
    }
    return true;
}

static double noise(void) /* standard normal, by Box and Muller (1958): without any a sensor looks frozen */
{
    const double radius = (rand() + 1.0) / (RAND_MAX + 1.0), angle = 2.0 * M_PI * rand() / (RAND_MAX + 1.0);

    return sqrt(-2.0 * log(radius)) * cos(angle);
}

/* The stamp of a message of joints, whose first effort the plant gets. */
static int64_t obey(const rcl_serialized_message_t *message)
{
    cdr_reader reader = cdr_begin(message);
    const int64_t stamp = cdr_read_time(&reader);
    uint32_t names;
    double asked;

    cdr_read_text(&reader);
    for (names = cdr_read_whole(&reader); names > 0 && !reader.wrong; names--) {
        cdr_read_text(&reader);
    }
    cdr_read_numbers(&reader);
    cdr_read_numbers(&reader);
    asked = cdr_number(cdr_read_numbers(&reader), 0);
    plant.inputs[0] = isfinite(asked) ? asked : plant.inputs[0];
    return stamp;
}

static void refer(const rcl_publisher_t *references, double level)
{
    uint8_t data[512];
    cdr_writer writer = cdr_open(data, sizeof data);
    int k;

    cdr_write_time(&writer, time_of(CLOCK_REALTIME));
    cdr_write_text(&writer, "probe");
    cdr_write_whole(&writer, 1);
    cdr_write_text(&writer, JOINT);
    cdr_write_whole(&writer, 2);
    for (k = 0; k < 2; k++) {
        cdr_write_whole(&writer, 1);
        cdr_write_words(&writer, &level, 1);
        cdr_write_whole(&writer, 0);
        cdr_write_whole(&writer, 0);
        cdr_write_whole(&writer, 0);
        cdr_write_time(&writer, k * 10 * SECOND);
    }
    cdr_publish(references, data, writer.at);
}

int main(int argc, char **argv)
{
    const bool relays = argc > 1 && !strcmp(argv[1], "relay");
    const int64_t period = argc > 2 ? (int64_t)(1e9 / atof(argv[2])) : SECOND;
    const rosidl_message_type_support_t *joints = ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, JointState);
    rcl_allocator_t allocator = rcl_get_default_allocator();
    rcl_init_options_t options = rcl_get_zero_initialized_init_options();
    rcl_node_options_t own = rcl_node_get_default_options();
    rcl_publisher_options_t out = rcl_publisher_get_default_options();
    rcl_subscription_options_t in = rcl_subscription_get_default_options();
    rcl_publisher_t answers = rcl_get_zero_initialized_publisher(), references = answers;
    rcl_subscription_t inlet = rcl_get_zero_initialized_subscription();
    rcl_serialized_message_t message = rmw_get_zero_initialized_serialized_message();
    int64_t begun, next, last = 0;
    const int steps = (int)lround((double)period * 1e-9 / STEP);
    long number = 0, most;
    int step;

    check(rcl_init_options_init(&options, allocator));
    probe_context = rcl_get_zero_initialized_context();
    check(rcl_init(0, NULL, &options, &probe_context));
    node = rcl_get_zero_initialized_node();
    check(rcl_node_init(&node, relays ? "relay" : "probe", "cam_beam", &probe_context, &own));
    check(rmw_serialized_message_init(&message, 4096, &allocator));
    check(rcl_publisher_init(&answers, &node, joints, relays ? "joint_command" : "joint_states", &out));
    check(rcl_subscription_init(&inlet, &node, joints, relays ? "joint_states" : "joint_command", &in));
    set = rcl_get_zero_initialized_wait_set();
    check(rcl_wait_set_init(&set, 1, 0, 0, 0, 0, 0, &probe_context, allocator));
    PLANT(init)(&plant);
    PLANT(stand)(&plant);
    puts("ready");
    fflush(stdout);
    while (relays) {
        if (wait_for(&inlet, SECOND / 10, &message)) {
            cdr_publish(&answers, message.buffer, message.buffer_length);
        }
    }
    check(rcl_publisher_init(&references, &node,
                             ROSIDL_GET_MSG_TYPE_SUPPORT(trajectory_msgs, msg, JointTrajectory), "reference", &out));
    most = argc > 3 ? (long)(atof(argv[3]) * 1e9 / (double)period) : 1000;
    for (begun = time_of(CLOCK_MONOTONIC); !last && time_of(CLOCK_MONOTONIC) - begun < 20 * SECOND;) {
        size_t readers = 0, writers = 0;

        check(rcl_publisher_get_subscription_count(&answers, &readers));
        check(rcl_subscription_get_publisher_count(&inlet, &writers));
        last = readers && writers;
        nanosleep(&(struct timespec){0, 10000000}, NULL);
    }
    next = time_of(CLOCK_MONOTONIC);
    while (number < most) {
        const int64_t left = next - time_of(CLOCK_MONOTONIC);

        if (left > 0) {
            if (wait_for(&inlet, left, &message)) {
                const int64_t came = time_of(CLOCK_REALTIME);

                printf("%.9f\n", (double)(came - obey(&message)) / 1e9);
            }
            continue;
        }
        if (number % (SECOND / period) == 0) {
            refer(&references, number / (SECOND / period) % 2 ? 0.02 : -0.02);
        }
        uint8_t data[256];
        cdr_writer writer = cdr_open(data, sizeof data);
        const double angle = plant.outputs[0] + WHITE * noise(), applied = plant.inputs[0];

        cdr_write_time(&writer, time_of(CLOCK_REALTIME));
        cdr_write_text(&writer, "probe");
        cdr_write_whole(&writer, 1);
        cdr_write_text(&writer, JOINT);
        cdr_write_whole(&writer, 1);
        cdr_write_words(&writer, &angle, 1);
        cdr_write_whole(&writer, 0);
        cdr_write_whole(&writer, 1);
        cdr_write_words(&writer, &applied, 1);
        cdr_publish(&answers, data, writer.at);
        for (step = 0; step < steps; step++) { /* by the input of the last period, as a drive that holds it */
            PLANT(step)(&plant);
        }
        next += period;
        number++;
    }
    printf("asked %ld\n", number);
    return 0;
}
