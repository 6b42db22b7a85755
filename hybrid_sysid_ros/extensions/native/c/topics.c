#define _GNU_SOURCE /* sem_clockwait */
#include "topics.h"

#include <semaphore.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "rcl/graph.h"

#include "rig.h"

static sem_t arrivals;

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

bool outlet_open(outlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic)
{
    rcl_publisher_options_t options = rcl_publisher_get_default_options();

    options.qos = quality_of(topic, LOCKSTEP);
    own->publisher = rcl_get_zero_initialized_publisher();
    own->open = rcl_publisher_init(&own->publisher, of, kind, topic, &options) == RCL_RET_OK;
    return own->open;
}

void outlet_close(outlet *own, rcl_node_t *of)
{
    if (own->open) {
        (void)!rcl_publisher_fini(&own->publisher, of);
    }
    own->open = false;
}

bool outlet_is_read(const outlet *own)
{
    size_t count = 0;

    return own->open && rcl_publisher_get_subscription_count(&own->publisher, &count) == RCL_RET_OK && count > 0;
}

/* From a thread of the middleware: a wait set for each period would take longer than its estimate. */
static void hear(const void *given, size_t count)
{
    inlet *own = (inlet *)given;

    if (count && !atomic_exchange(&own->heard, true)) {
        (void)!sem_post(&arrivals);
    }
}

bool inlet_open_with(inlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic,
                     const rmw_qos_profile_t *quality)
{
    rcl_subscription_options_t options = rcl_subscription_get_default_options();

    options.qos = *quality;
    own->subscription = rcl_get_zero_initialized_subscription();
    return rcl_subscription_init(&own->subscription, of, kind, topic, &options) == RCL_RET_OK
           && rcl_subscription_set_on_new_message_callback(&own->subscription, hear, own) == RCL_RET_OK;
}

bool inlet_open(inlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic)
{
    const rmw_qos_profile_t quality = quality_of(topic, false);

    return inlet_open_with(own, of, kind, topic, &quality);
}

void inlet_close(inlet *own, rcl_node_t *of)
{
    (void)!rcl_subscription_fini(&own->subscription, of);
}

size_t inlet_writers(const inlet *own)
{
    size_t count = 0;

    return rcl_subscription_get_publisher_count(&own->subscription, &count) == RCL_RET_OK ? count : 0;
}

bool inlet_make_do(inlet *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic)
{
    rmw_qos_profile_t quality = quality_of(topic, false);
    rcl_allocator_t allocator = rcl_get_default_allocator();
    rcl_topic_endpoint_info_array_t found = rcl_get_zero_initialized_topic_endpoint_info_array();
    bool offers = false;
    size_t k;

    if (rcl_get_publishers_info_by_topic(
            of, &allocator, rcl_subscription_get_topic_name(&own->subscription), false, &found) == RCL_RET_OK) {
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
    quality.reliability = RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
    inlet_close(own, of);
    if (!inlet_open_with(own, of, kind, topic, &quality)) {
        refuse("ROS cannot listen to %s with best effort: %s", topic, rcl_get_error_string().str);
    }
    return true;
}

bool inlet_take(inlet *own, rcl_serialized_message_t *message)
{
    const bool found = rcl_take_serialized_message(&own->subscription, message, NULL, NULL) == RCL_RET_OK;

    if (!found) {
        rcl_reset_error();
    }
    return found;
}

void inlets_begin(void)
{
    (void)!sem_init(&arrivals, 0, 0);
}

void inlets_wait(int64_t most)
{
    const int64_t until = steady() + most;
    const struct timespec end = {until / SECOND, until % SECOND};

    (void)!sem_clockwait(&arrivals, CLOCK_MONOTONIC, &end);
}
