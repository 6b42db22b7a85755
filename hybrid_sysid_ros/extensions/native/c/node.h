/* A ROS node of this process: its parameters, topics, services and states. */
#ifndef NODE_H
#define NODE_H

#include "rcl_lifecycle/rcl_lifecycle.h"

#include "diagnostics.h"
#include "joints.h"
#include "rig.h"
#include "topics.h"

#define PARAMETER_SERVICES 6

typedef struct node node;

typedef struct {
    const char *name;
    bool (*act)(char *words); /* words: why it did not, of WORDS bytes */
    rcl_service_t service;
} trigger;

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
    atomic_bool asked; /* something may wait at a service */
    outlet diagnostics, events;
    bool configured, active;
    bool leaving; /* a manager waits until it has come to rest */
    int64_t left_by;
    rmw_request_id_t leaver;
    int64_t reported;
};

extern node estimator_node, controller_node;

void node_listen(node *own, const rcl_service_t *service); /* to requests */
bool node_is_asked(node *own, const rcl_service_t *service, rmw_request_id_t *from, void *request);

#endif
