/* Ends of topics, with the quality of service that each topic has. */
#ifndef TOPICS_H
#define TOPICS_H

#include <stdatomic.h>

#include "process.h"

typedef struct {
    rcl_publisher_t publisher;
    bool open;
} outlet;

typedef struct {
    rcl_subscription_t subscription;
    atomic_bool heard; /* something may have come that was not taken */
} inlet;

rmw_qos_profile_t quality_of(const char *topic, bool lockstep);
bool outlet_open(outlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic);
void outlet_close(outlet *own, rcl_node_t *of);
bool outlet_is_read(const outlet *own);
bool inlet_open(inlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic);
/* The same with a quality of its own. */
bool inlet_open_with(inlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic,
                     const rmw_qos_profile_t *quality);
void inlet_close(inlet *own, rcl_node_t *of);
/* Ask a topic for best effort only, where a publisher offers no more: whether that was changed. */
bool inlet_make_do(inlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic);
bool inlet_take(inlet *own, rcl_serialized_message_t *message);
size_t inlet_writers(const inlet *own); /* how many publish what it hears */
void inlets_begin(void);
void inlets_wait(int64_t most); /* until something is heard, for at most a time [ns] */

#endif
