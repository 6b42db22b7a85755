#include "topics.h"

#include <stdio.h>
#include <string.h>

#include "rcl/graph.h"

#include "rig.h"

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

bool inlet_open(rcl_subscription_t *own, rcl_node_t *of, const rosidl_message_type_support_t *kind, const char *topic)
{
    rcl_subscription_options_t options = rcl_subscription_get_default_options();

    options.qos = quality_of(topic, false);
    *own = rcl_get_zero_initialized_subscription();
    return rcl_subscription_init(own, of, kind, topic, &options) == RCL_RET_OK;
}

bool inlet_make_do(rcl_subscription_t *own, rcl_node_t *of, const rosidl_message_type_support_t *kind,
                   const char *topic)
{
    rcl_subscription_options_t options = rcl_subscription_get_default_options();
    rcl_allocator_t allocator = rcl_get_default_allocator();
    rcl_topic_endpoint_info_array_t found = rcl_get_zero_initialized_topic_endpoint_info_array();
    bool offers = false;
    size_t k;

    if (rcl_get_publishers_info_by_topic(
            of, &allocator, rcl_subscription_get_topic_name(own), false, &found) == RCL_RET_OK) {
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
    (void)!rcl_subscription_fini(own, of);
    *own = rcl_get_zero_initialized_subscription();
    CHECK(rcl_subscription_init(own, of, kind, topic, &options));
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
