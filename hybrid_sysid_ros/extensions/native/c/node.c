#include "node.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "diagnostic_msgs/msg/diagnostic_array.h"
#include "rcl_interfaces/msg/parameter_event.h"
#include "rcl/graph.h"
#include "rcl/logging_rosout.h"
#include "rosidl_runtime_c/string_functions.h"
#include "std_srvs/srv/trigger.h"

#define REPORT_PERIOD (2 * SECOND / 5)

int64_t clock_time; /* of /clock [ns]; -1: it is not used */

int64_t steady(void)
{
    struct timespec time;

    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec * SECOND + time.tv_nsec;
}

int64_t now(void)
{
    struct timespec time;

    if (clock_time >= 0) {
        return clock_time;
    }
    clock_gettime(CLOCK_REALTIME, &time);
    return time.tv_sec * SECOND + time.tv_nsec;
}

void refuse(const char *words, ...)
{
    va_list given;

    va_start(given, words);
    fprintf(stderr, "error: ");
    vfprintf(stderr, words, given);
    fprintf(stderr, "\n");
    va_end(given);
    fflush(NULL);
    _exit(2); /* exit() would free what threads of the middleware still use */
}

void announce(const char *words, ...)
{
    va_list given;

    va_start(given, words);
    vprintf(words, given);
    putchar('\n');
    va_end(given);
    fflush(stdout);
}

void node_check(rcl_ret_t found, const char *what)
{
    if (found != RCL_RET_OK) {
        const char *why = rcl_get_error_string().str;
        char line[WORDS];
        size_t k;

        snprintf(line, sizeof line, "%.700s", why);
        for (k = 0; line[k]; k++) {
            line[k] = line[k] == '\n' ? ' ' : line[k];
        }
        refuse("ROS cannot make the node (%.40s): %s", what, line);
    }
}

/* ------------------------------------------------------------------ topics */

rmw_qos_profile_t quality_of(const char *topic, bool lockstep)
{
    rmw_qos_profile_t found = rmw_qos_profile_default;
    int k;

    for (k = 0; k < TOPICS; k++) {
        if (!strcmp(topics[k].name, topic)) {
            found.depth = lockstep ? LOCKSTEP_DEPTH : (size_t)topics[k].depth;
            found.reliability = topics[k].reliable ? RMW_QOS_POLICY_RELIABILITY_RELIABLE
                                                   : RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
            found.durability = topics[k].kept ? RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL
                                              : RMW_QOS_POLICY_DURABILITY_VOLATILE;
        }
    }
    return found;
}

bool outlet_open(outlet *own, node *of, const rosidl_message_type_support_t *kind, const char *topic)
{
    rcl_publisher_options_t options = rcl_publisher_get_default_options();

    options.qos = quality_of(topic, LOCKSTEP);
    own->publisher = rcl_get_zero_initialized_publisher();
    own->open = rcl_publisher_init(&own->publisher, &of->handle, kind, topic, &options) == RCL_RET_OK;
    return own->open;
}

void outlet_close(outlet *own, node *of)
{
    if (own->open) {
        (void)!rcl_publisher_fini(&own->publisher, &of->handle);
    }
    own->open = false;
}

bool outlet_is_read(const outlet *own)
{
    size_t count = 0;

    return own->open && rcl_publisher_get_subscription_count(&own->publisher, &count) == RCL_RET_OK && count > 0;
}

bool inlet_open(rcl_subscription_t *own, node *of, const rosidl_message_type_support_t *kind, const char *topic)
{
    rcl_subscription_options_t options = rcl_subscription_get_default_options();

    options.qos = quality_of(topic, false);
    *own = rcl_get_zero_initialized_subscription();
    return rcl_subscription_init(own, &of->handle, kind, topic, &options) == RCL_RET_OK;
}

bool inlet_make_do(rcl_subscription_t *own, node *of, const rosidl_message_type_support_t *kind, const char *topic)
{
    rcl_subscription_options_t options = rcl_subscription_get_default_options();
    rcl_allocator_t allocator = rcl_get_default_allocator();
    rcl_topic_endpoint_info_array_t found = rcl_get_zero_initialized_topic_endpoint_info_array();
    bool offers = false;
    size_t k;

    if (rcl_get_publishers_info_by_topic(
            &of->handle, &allocator, rcl_subscription_get_topic_name(own), false, &found) == RCL_RET_OK) {
        for (k = 0; k < found.size; k++) {
            offers = offers || found.info_array[k].qos_profile.reliability == RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
        }
    }
    (void)!rcl_topic_endpoint_info_array_fini(&found, &allocator);
    rcl_reset_error();
    if (!offers) {
        return false;
    }
    fprintf(stderr, "%s: a publisher offers best effort, which is used from now on\n", topic);
    options.qos = quality_of(topic, false);
    options.qos.reliability = RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
    (void)!rcl_subscription_fini(own, &of->handle);
    *own = rcl_get_zero_initialized_subscription();
    CHECK(rcl_subscription_init(own, &of->handle, kind, topic, &options));
    return true;
}

bool inlet_take(rcl_subscription_t *own, rcl_serialized_message_t *message)
{
    const bool found = rcl_take_serialized_message(own, message, NULL, NULL) == RCL_RET_OK;

    if (!found) {
        rcl_reset_error();
    }
    return found;
}

/* ------------------------------------------------------------------ the node */

void node_begin(node *own)
{
    rcl_node_options_t options = rcl_node_get_default_options();
    rcl_service_options_t quality = rcl_service_get_default_options();
    int k;

    own->handle = rcl_get_zero_initialized_node();
    CHECK(rcl_node_init(&own->handle, own->name, "", &context, &options));
    own->full_name = rcl_node_get_fully_qualified_name(&own->handle) + 1;
    parameters_begin(own);
    if (!LOCKSTEP) {
        snprintf(own->signature, sizeof own->signature, "/%s %d", own->full_name, (int)getpid());
    }
    (void)!rcl_logging_rosout_init_publisher_for_node(&own->handle);
    rcl_reset_error();
    outlet_open(&own->diagnostics, own, ROSIDL_GET_MSG_TYPE_SUPPORT(diagnostic_msgs, msg, DiagnosticArray),
                "/diagnostics");
    outlet_open(&own->events, own, ROSIDL_GET_MSG_TYPE_SUPPORT(rcl_interfaces, msg, ParameterEvent),
                "/parameter_events");
    lifecycle_open(own);
    parameters_open(own);
    for (k = 0; k < own->trigger_count; k++) {
        char name[64];

        snprintf(name, sizeof name, "~/%s", own->triggers[k].name);
        own->triggers[k].service = rcl_get_zero_initialized_service();
        CHECK(rcl_service_init(&own->triggers[k].service, &own->handle,
                               ROSIDL_GET_SRV_TYPE_SUPPORT(std_srvs, srv, Trigger), name, &quality));
    }
}

static const char *state_of(const node *own)
{
    return own->active ? "active" : own->configured ? "inactive" : "unconfigured";
}

static void serve_triggers(node *own)
{
    int k;

    for (k = 0; k < own->trigger_count; k++) {
        std_srvs__srv__Trigger_Request request;
        std_srvs__srv__Trigger_Response response;
        rmw_request_id_t from;
        char words[WORDS] = "";

        std_srvs__srv__Trigger_Request__init(&request);
        if (rcl_take_request(&own->triggers[k].service, &from, &request) == RCL_RET_OK) {
            std_srvs__srv__Trigger_Response__init(&response);
            if (own->active) {
                response.success = own->triggers[k].act(words);
            } else {
                snprintf(words, sizeof words, "the node is %s: its part of the loop is at rest", state_of(own));
            }
            rosidl_runtime_c__String__assign(&response.message, words);
            (void)!rcl_send_response(&own->triggers[k].service, &from, &response);
            std_srvs__srv__Trigger_Response__fini(&response);
        }
        std_srvs__srv__Trigger_Request__fini(&request);
    }
}

/* Answer what has been asked of the node's services, and report. */
void node_serve(node *own)
{
    serve_triggers(own);
    lifecycle_serve(own);
    parameters_serve(own);
    rcl_reset_error();
    if (steady() - own->reported > REPORT_PERIOD) {
        own->reported = steady();
        node_report(own, false);
    }
}

void node_report(node *own, bool printed)
{
    static task tasks[3];
    int count = 1;

    if (own->active) {
        count = own->health(tasks);
    } else {
        task_begin(tasks, "loop");
        tasks->level = WARN;
        snprintf(tasks->message, sizeof tasks->message, "%s", state_of(own));
    }
    tasks_publish(tasks, count, own->full_name, RIG, &own->diagnostics.publisher);
    if (printed) {
        tasks_print(tasks, count, own->name);
    }
}

void node_end(node *own)
{
    node_report(own, true);
    if (own->active) {
        own->deactivate(own);
        own->active = false;
    }
}

/* Leave the graph, so that nobody waits for the node. */
void node_close(node *own)
{
    int k;

    for (k = 0; k < own->trigger_count; k++) {
        (void)!rcl_service_fini(&own->triggers[k].service, &own->handle);
    }
    for (k = 0; k < PARAMETER_SERVICES; k++) {
        (void)!rcl_service_fini(&own->services[k], &own->handle);
    }
    outlet_close(&own->diagnostics, own);
    outlet_close(&own->events, own);
    (void)!rcl_lifecycle_state_machine_fini(&own->states, &own->handle);
    (void)!rcl_logging_rosout_fini_publisher_for_node(&own->handle);
    (void)!rcl_node_fini(&own->handle);
    rcl_reset_error();
}
