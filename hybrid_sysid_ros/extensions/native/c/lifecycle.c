/* The states of the nodes, which a manager may change (https://design.ros2.org/articles/node_lifecycle.html). */
#include <string.h>

#include "lifecycle_msgs/msg/detail/state__functions.h"
#include "lifecycle_msgs/msg/detail/transition_description__functions.h"
#include "lifecycle_msgs/msg/state.h"
#include "lifecycle_msgs/msg/transition.h"
#include "lifecycle_msgs/msg/transition_event.h"
#include "lifecycle_msgs/srv/change_state.h"
#include "lifecycle_msgs/srv/get_available_states.h"
#include "lifecycle_msgs/srv/get_available_transitions.h"
#include "lifecycle_msgs/srv/get_state.h"
#include "rosidl_runtime_c/string_functions.h"

#include "lifecycle.h"

#define SERVICE(kind) ROSIDL_GET_SRV_TYPE_SUPPORT(lifecycle_msgs, srv, kind)
#define SERVE(channel, kind, answer)                                                                                   \
    do {                                                                                                               \
        lifecycle_msgs__srv__##kind##_Request request;                                                                 \
        lifecycle_msgs__srv__##kind##_Response response;                                                               \
        rmw_request_id_t from;                                                                                         \
        lifecycle_msgs__srv__##kind##_Request__init(&request);                                                         \
        lifecycle_msgs__srv__##kind##_Response__init(&response);                                                       \
        if (node_is_asked(own, &own->states.com_interface.channel, &from, &request)) {                                 \
            answer;                                                                                                    \
            (void)!rcl_send_response(&own->states.com_interface.channel, &from, &response);                            \
        }                                                                                                              \
        lifecycle_msgs__srv__##kind##_Request__fini(&request);                                                         \
        lifecycle_msgs__srv__##kind##_Response__fini(&response);                                                       \
    } while (0)

void lifecycle_open(node *own)
{
    rcl_lifecycle_state_machine_options_t options = rcl_lifecycle_get_default_state_machine_options();

    options.enable_com_interface = true;
    own->states = rcl_lifecycle_get_zero_initialized_state_machine();
    CHECK(rcl_lifecycle_state_machine_init(
        &own->states, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(lifecycle_msgs, msg, TransitionEvent),
        SERVICE(ChangeState), SERVICE(GetState), SERVICE(GetAvailableStates), SERVICE(GetAvailableTransitions),
        SERVICE(GetAvailableTransitions), &options));
    node_listen(own, &own->states.com_interface.srv_change_state);
    node_listen(own, &own->states.com_interface.srv_get_state);
    node_listen(own, &own->states.com_interface.srv_get_available_states);
    node_listen(own, &own->states.com_interface.srv_get_available_transitions);
    node_listen(own, &own->states.com_interface.srv_get_transition_graph);
}

static void finish(node *own, bool done)
{
    if (rcl_lifecycle_trigger_transition_by_label(
            &own->states, done ? rcl_lifecycle_transition_success_label : rcl_lifecycle_transition_failure_label, true)
        != RCL_RET_OK) {
        rcl_reset_error();
    }
}

/* Leave the active state, with everything at rest. */
static void leave(node *own)
{
    if (own->active) {
        own->deactivate(own);
    }
    own->active = false;
}

/* Make a transition that has begun; false where it is not done yet. */
static bool go(node *own, uint8_t asked, bool *done)
{
    *done = true;
    switch (asked) {
    case lifecycle_msgs__msg__Transition__TRANSITION_CONFIGURE:
        own->configured = true;
        break;
    case lifecycle_msgs__msg__Transition__TRANSITION_CLEANUP:
        own->configured = false;
        break;
    case lifecycle_msgs__msg__Transition__TRANSITION_ACTIVATE:
        *done = own->active = own->activate(own);
        break;
    case lifecycle_msgs__msg__Transition__TRANSITION_DEACTIVATE:
        if (own->wind_down != NULL && !own->leaving) {
            own->left_by = steady() + (int64_t)(1e9 * own->wind_down());
            own->leaving = true;
            return false;
        }
        own->leaving = false;
        leave(own);
        break;
    default: /* one of the three shutdowns */
        leave(own);
        own->configured = false;
        ended = true;
    }
    finish(own, *done);
    return true;
}

void lifecycle_bring_up(node *own)
{
    static const uint8_t order[] = {
        lifecycle_msgs__msg__Transition__TRANSITION_CONFIGURE, lifecycle_msgs__msg__Transition__TRANSITION_ACTIVATE};
    bool done;
    size_t k;

    for (k = 0; k < 2; k++) {
        CHECK(rcl_lifecycle_trigger_transition_by_id(&own->states, order[k], true));
        go(own, order[k], &done);
    }
}

/* Whether a request of a change is answered at once. */
static bool change(node *own, const lifecycle_msgs__srv__ChangeState_Request *asked, bool *done, rmw_request_id_t from)
{
    const rcl_lifecycle_state_t *state = own->states.current_state;
    unsigned int k;

    *done = false;
    for (k = 0; k < state->valid_transition_size; k++) {
        const rcl_lifecycle_transition_t *found = &state->valid_transitions[k];
        const bool by_label = asked->transition.label.size && !strcmp(found->label, asked->transition.label.data);

        if (!own->leaving && (by_label || (!asked->transition.label.size && found->id == asked->transition.id))) {
            const uint8_t id = (uint8_t)found->id;

            if (rcl_lifecycle_trigger_transition_by_id(&own->states, id, true) != RCL_RET_OK) {
                rcl_reset_error();
                return true;
            }
            own->leaver = from;
            return go(own, id, done);
        }
    }
    return true;
}

static void serve_change(node *own)
{
    rcl_service_t *service = &own->states.com_interface.srv_change_state;
    lifecycle_msgs__srv__ChangeState_Request request;
    lifecycle_msgs__srv__ChangeState_Response response;
    rmw_request_id_t from;
    bool answered = false;

    lifecycle_msgs__srv__ChangeState_Request__init(&request);
    lifecycle_msgs__srv__ChangeState_Response__init(&response);
    if (own->leaving && (own->is_down() || steady() > own->left_by)) {
        answered = go(own, lifecycle_msgs__msg__Transition__TRANSITION_DEACTIVATE, &response.success);
        from = own->leaver;
    } else if (node_is_asked(own, service, &from, &request)) {
        answered = change(own, &request, &response.success, from);
    }
    if (answered) {
        (void)!rcl_send_response(service, &from, &response);
    }
    lifecycle_msgs__srv__ChangeState_Request__fini(&request);
    lifecycle_msgs__srv__ChangeState_Response__fini(&response);
}

static void describe_state(const rcl_lifecycle_state_t *state, lifecycle_msgs__msg__State *found)
{
    found->id = (uint8_t)state->id;
    rosidl_runtime_c__String__assign(&found->label, state->label);
}

static void describe_transitions(
    const rcl_lifecycle_transition_t *own, unsigned int count,
    lifecycle_msgs__msg__TransitionDescription__Sequence *found)
{
    unsigned int k;

    lifecycle_msgs__msg__TransitionDescription__Sequence__init(found, count);
    for (k = 0; k < count && k < found->size; k++) {
        found->data[k].transition.id = (uint8_t)own[k].id;
        rosidl_runtime_c__String__assign(&found->data[k].transition.label, own[k].label);
        describe_state(own[k].start, &found->data[k].start_state);
        describe_state(own[k].goal, &found->data[k].goal_state);
    }
}

void lifecycle_serve(node *own)
{
    const rcl_lifecycle_transition_map_t *map = &own->states.transition_map;
    unsigned int k;

    serve_change(own);
    SERVE(srv_get_state, GetState, describe_state(own->states.current_state, &response.current_state));
    SERVE(srv_get_available_states, GetAvailableStates, {
        lifecycle_msgs__msg__State__Sequence__init(&response.available_states, map->states_size);
        for (k = 0; k < map->states_size; k++) {
            describe_state(&map->states[k], &response.available_states.data[k]);
        }
    });
    SERVE(srv_get_available_transitions, GetAvailableTransitions,
          describe_transitions(own->states.current_state->valid_transitions,
                               own->states.current_state->valid_transition_size, &response.available_transitions));
    SERVE(srv_get_transition_graph, GetAvailableTransitions,
          describe_transitions(map->transitions, map->transitions_size, &response.available_transitions));
}
