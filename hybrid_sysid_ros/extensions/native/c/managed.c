#include "managed.h"

#include <stdio.h>
#include <unistd.h>

#include "diagnostic_msgs/msg/diagnostic_array.h"
#include "rcl/logging_rosout.h"
#include "rcl_interfaces/msg/parameter_event.h"
#include "rosidl_runtime_c/string_functions.h"
#include "std_srvs/srv/trigger.h"

#include "lifecycle.h"
#include "parameters.h"

#define REPORT_PERIOD (2 * SECOND / 5)

/* From a thread of the middleware. */
static void be_asked(const void *own, size_t count)
{
    if (count) {
        atomic_store(&((node *)own)->asked, true);
    }
}

void node_listen(node *own, const rcl_service_t *service)
{
    CHECK(rcl_service_set_on_new_request_callback(service, be_asked, own));
}

bool node_is_asked(node *own, const rcl_service_t *service, rmw_request_id_t *from, void *request)
{
    const bool found = rcl_take_request(service, from, request) == RCL_RET_OK;

    if (found) {
        atomic_store(&own->asked, true); /* another request may wait behind it */
    }
    return found;
}

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
    outlet_open(&own->diagnostics, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(diagnostic_msgs, msg, DiagnosticArray),
                "/diagnostics");
    outlet_open(&own->events, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(rcl_interfaces, msg, ParameterEvent),
                "/parameter_events");
    lifecycle_open(own);
    parameters_open(own);
    for (k = 0; k < own->trigger_count; k++) {
        char name[64];

        snprintf(name, sizeof name, "~/%s", own->triggers[k].name);
        own->triggers[k].service = rcl_get_zero_initialized_service();
        CHECK(rcl_service_init(&own->triggers[k].service, &own->handle,
                               ROSIDL_GET_SRV_TYPE_SUPPORT(std_srvs, srv, Trigger), name, &quality));
        node_listen(own, &own->triggers[k].service);
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
        if (node_is_asked(own, &own->triggers[k].service, &from, &request)) {
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
    if (atomic_exchange(&own->asked, own->leaving)) {
        serve_triggers(own);
        lifecycle_serve(own);
        parameters_serve(own);
        rcl_reset_error();
    }
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
    outlet_close(&own->diagnostics, &own->handle);
    outlet_close(&own->events, &own->handle);
    (void)!rcl_lifecycle_state_machine_fini(&own->states, &own->handle);
    (void)!rcl_logging_rosout_fini_publisher_for_node(&own->handle);
    (void)!rcl_node_fini(&own->handle);
    rcl_reset_error();
}
