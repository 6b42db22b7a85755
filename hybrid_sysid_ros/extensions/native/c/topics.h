/* Ends of topics, with the quality of service that each topic has. */
#ifndef TOPICS_H
#define TOPICS_H

#include "process.h"

typedef struct {
    rcl_publisher_t publisher;
    bool open;
} outlet;

rmw_qos_profile_t quality_of(const char *topic, bool lockstep);
bool outlet_open(outlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic);
void outlet_close(outlet *own, rcl_node_t *of);
bool outlet_is_read(const outlet *own);
bool inlet_open(rcl_subscription_t *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic);
/* Ask a topic for best effort only, where a publisher offers no more: whether that was changed. */
bool inlet_make_do(rcl_subscription_t *own, rcl_node_t *of, const rosidl_message_type_support_t *kind,
                   const char *topic);
bool inlet_take(rcl_subscription_t *own, rcl_serialized_message_t *message);

#endif
