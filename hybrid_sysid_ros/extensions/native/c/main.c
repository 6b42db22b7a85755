/* The estimator and the controller of a rig as one process: one thread, which waits for messages and answers them. */
#include <errno.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <dirent.h>
#include <unistd.h>

#include "rcl/logging.h"
#include "rosgraph_msgs/msg/clock.h"

#include "lifecycle.h"
#include "loop.h"
#include "managed.h"

#define SERVE_PERIOD (SECOND / 100) /* between two looks at services, the starter and peers */
#define MOST_INLETS 8

static volatile sig_atomic_t interrupted;
static inlet clock_inlet;

static void interrupt(int number)
{
    (void)number;
    interrupted = 1;
}

/* Whether the process that started this one has gone: then the standard input has ended. */
static bool is_left(void)
{
    struct pollfd input = {0, POLLIN, 0};
    char some[64];

    return poll(&input, 1, 0) > 0 && read(0, some, sizeof some) == 0;
}

static void prioritise(void)
{
    const int priority = (int)value_of(&controller_node, CONTROLLER_PRIORITY);
    const struct sched_param asked = {.sched_priority = priority};
    struct dirent *entry;
    DIR *tasks;

    if (!priority || (tasks = opendir("/proc/self/task")) == NULL) {
        return;
    }
    while ((entry = readdir(tasks)) != NULL) {
        if (atoi(entry->d_name) && sched_setscheduler(atoi(entry->d_name), SCHED_FIFO, &asked)) {
            fprintf(stderr, "no real-time priority (%s): the limit for the user is `ulimit -r`\n", strerror(errno));
            break;
        }
    }
    closedir(tasks);
    if (mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT)) {
        fprintf(stderr, "memory may be paged out (%s): the limit for the user is `ulimit -l`\n", strerror(errno));
    }
}

static void follow_clock(rcl_serialized_message_t *message)
{
    atomic_store(&clock_inlet.heard, false);
    while (inlet_take(&clock_inlet, message)) {
        cdr_reader reader = cdr_begin(message);
        const int64_t time = cdr_read_time(&reader);

        clock_time = reader.wrong ? clock_time : time;
    }
}

/* Wait for messages for at most a time [ns], and answer them. */
static void turn(rcl_serialized_message_t *message, int64_t most)
{
    inlet *inlets[MOST_INLETS];
    int count, k;

    inlets_wait(most);
    if (clock_time >= 0) {
        follow_clock(message);
    }
    count = loop_inlets(inlets);
    for (k = 0; k < count; k++) {
        if (atomic_exchange(&inlets[k]->heard, false)) {
            while (inlet_take(inlets[k], message)) {
                loop_receive(inlets[k], message);
            }
        }
    }
}

int main(int argc, char **argv)
{
    static node *const nodes[] = {&estimator_node, &controller_node};
    const struct sigaction end = {.sa_handler = interrupt}, ignored = {.sa_handler = SIG_IGN};
    struct sigaction before;
    rcl_allocator_t allocator = rcl_get_default_allocator();
    rcl_init_options_t options = rcl_get_zero_initialized_init_options();
    rcl_serialized_message_t message = rmw_get_zero_initialized_serialized_message();
    const char *tether = getenv("HYBRID_SYSID_TETHER");
    int64_t served = 0;
    size_t k;

    sigaction(SIGINT, &end, NULL);
    sigaction(SIGTERM, &end, NULL);
    if (!sigaction(SIGHUP, NULL, &before) && before.sa_handler != SIG_IGN) {
        sigaction(SIGHUP, &end, NULL);
    }
    sigaction(SIGPIPE, &ignored, NULL);
    CHECK(rcl_init_options_init(&options, allocator));
    context = rcl_get_zero_initialized_context();
    CHECK(rcl_init(argc, (char const *const *)argv, &options, &context));
    forget_start();
    CHECK(rcl_logging_configure(&context.global_arguments, &allocator));
    CHECK(rmw_serialized_message_init(&message, LARGEST_MESSAGE, &allocator));
    clock_time = -1;
    inlets_begin();
    loop_begin();
    for (k = 0; k < 2; k++) {
        node_begin(nodes[k]);
        forget_start();
    }
    if (value_of(&controller_node, CONTROLLER_USE_SIM_TIME) != 0.0
        || value_of(&estimator_node, ESTIMATOR_USE_SIM_TIME) != 0.0) {
        rmw_qos_profile_t newest = rmw_qos_profile_default;

        newest.reliability = RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
        newest.depth = 1;
        if (!inlet_open_with(&clock_inlet, &controller_node.handle,
                             ROSIDL_GET_MSG_TYPE_SUPPORT(rosgraph_msgs, msg, Clock), "/clock", &newest)) {
            refuse("ROS cannot listen to /clock: %s", rcl_get_error_string().str);
        }
        clock_time = 0;
    }
    for (k = 0; k < 2; k++) {
        if (nodes[k]->parameters[k ? (int)CONTROLLER_AUTOSTART : (int)ESTIMATOR_AUTOSTART].number != 0.0) {
            lifecycle_bring_up(nodes[k]);
        }
    }
    forget_start();
    prioritise();
    announce("ready");
    while (!interrupted && !ended) {
        turn(&message, SERVE_PERIOD);
        if (steady() - served > SERVE_PERIOD) {
            served = steady();
            for (k = 0; k < 2; k++) {
                node_serve(nodes[k]);
            }
            loop_look();
            interrupted = interrupted || (tether != NULL && *tether && is_left());
        }
    }
    for (k = 2; k > 0; k--) {
        node_end(nodes[k - 1]);
    }
    fflush(NULL);
    if (clock_time >= 0) {
        inlet_close(&clock_inlet, &controller_node.handle);
    }
    for (k = 0; k < 2; k++) {
        node_close(nodes[k]);
    }
    (void)!rcl_shutdown(&context);
    (void)!rcl_context_fini(&context);
    _exit(0); /* exit() would free what threads of the middleware still use */
}
