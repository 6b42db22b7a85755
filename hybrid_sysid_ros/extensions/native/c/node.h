/* A ROS node of this process: its parameters, topics, services and states. */
#ifndef NODE_H
#define NODE_H

#include "rcl/error_handling.h"
#include "rcl/rcl.h"
#include "rcl_lifecycle/rcl_lifecycle.h"

#include "diagnostics.h"
#include "joints.h"
#include "rig.h"

#define PARAMETER_SERVICES 6

typedef struct node node;

typedef struct {
    const char *name;
    bool (*act)(char *words); /* words: why it did not, of WORDS bytes */
    rcl_service_t service;
} trigger;

typedef struct {
    rcl_publisher_t publisher;
    bool open;
} outlet;

struct node {
    const char *name;
    parameter *parameters;
    int count;
    trigger *triggers;
    int trigger_count;
    bool (*activate)(node *own);
    double (*wind_down)(void); /* begin to come to rest, in so many seconds at most */
    bool (*is_down)(void); /* whether everything has come to rest */
    void (*deactivate)(node *own);
    int (*health)(task *tasks);

    rcl_node_t handle;
    const char *full_name; /* without the first slash */
    char signature[LONGEST_SOURCE];
    rcl_lifecycle_state_machine_t states;
    rcl_service_t services[PARAMETER_SERVICES];
    outlet diagnostics, events;
    bool configured, active;
    bool leaving; /* a manager waits until it has come to rest */
    int64_t left_by;
    rmw_request_id_t leaver;
    int64_t reported;
};

extern rcl_context_t context;
extern bool ended;

#define CHECK(call) node_check((call), #call)
void node_check(rcl_ret_t found, const char *what);
void refuse(const char *words, ...) __attribute__((format(printf, 1, 2), noreturn));
void announce(const char *words, ...) __attribute__((format(printf, 1, 2)));
rmw_qos_profile_t quality_of(const char *topic, bool lockstep);
bool outlet_open(outlet *own, node *of, const rosidl_message_type_support_t *kind, const char *topic);
void outlet_close(outlet *own, node *of);
bool outlet_is_read(const outlet *own);
bool inlet_open(rcl_subscription_t *own, node *of, const rosidl_message_type_support_t *kind, const char *topic);
/* Ask a topic for best effort only, where a publisher offers no more: whether that was changed. */
bool inlet_make_do(rcl_subscription_t *own, node *of, const rosidl_message_type_support_t *kind, const char *topic);
bool inlet_take(rcl_subscription_t *own, rcl_serialized_message_t *message);

void node_begin(node *own);
void node_serve(node *own);
void node_report(node *own, bool printed);
void node_end(node *own);
void node_close(node *own);

void parameters_begin(node *own);
void parameters_open(node *own);
void parameters_serve(node *own);

void lifecycle_open(node *own);
void lifecycle_serve(node *own);
void lifecycle_bring_up(node *own);

extern node estimator_node, controller_node;

#endif
