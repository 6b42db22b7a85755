/* The services by which others read and set the parameters of a node. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "rcl_interfaces/msg/detail/floating_point_range__functions.h"
#include "rcl_interfaces/msg/detail/integer_range__functions.h"
#include "rcl_interfaces/msg/detail/parameter_descriptor__functions.h"
#include "rcl_interfaces/msg/detail/parameter_value__functions.h"
#include "rcl_interfaces/msg/detail/set_parameters_result__functions.h"
#include "rcl_interfaces/srv/describe_parameters.h"
#include "rcl_interfaces/srv/get_parameter_types.h"
#include "rcl_interfaces/srv/get_parameters.h"
#include "rcl_interfaces/srv/list_parameters.h"
#include "rcl_interfaces/srv/set_parameters.h"
#include "rcl_interfaces/srv/set_parameters_atomically.h"
#include "rosidl_runtime_c/primitives_sequence_functions.h"
#include "rosidl_runtime_c/string_functions.h"

#include "parameters.h"

typedef rcl_interfaces__msg__ParameterValue ros_value;

static bool to_ros(const parameter *own, ros_value *value)
{
    value->type = (uint8_t)own->kind;
    value->bool_value = own->kind == IS_BOOL && own->number != 0.0;
    value->integer_value = own->kind == IS_WHOLE ? (int64_t)own->number : 0;
    value->double_value = own->kind == IS_NUMBER ? own->number : 0.0;
    if (own->kind == IS_TEXT) {
        return rosidl_runtime_c__String__assign(&value->string_value, own->text);
    }
    if (own->kind == IS_NUMBERS) {
        if (!rosidl_runtime_c__double__Sequence__init(&value->double_array_value, (size_t)own->count)) {
            return false;
        }
        memcpy(value->double_array_value.data, own->numbers, (size_t)own->count * sizeof(double));
    }
    return true;
}

static void tell_change(node *own, const parameter *changed)
{
    static uint8_t data[2048];
    cdr_writer writer = cdr_open(data, sizeof data);
    uint64_t whole = 0;
    int k;

    cdr_write_time(&writer, now());
    cdr_write_text(&writer, rcl_node_get_fully_qualified_name(&own->handle));
    cdr_write_whole(&writer, 0);
    cdr_write_whole(&writer, 1);
    cdr_write_text(&writer, changed->name);
    cdr_write_byte(&writer, (uint8_t)changed->kind);
    cdr_write_byte(&writer, changed->kind == IS_BOOL && changed->number != 0.0);
    whole = changed->kind == IS_WHOLE ? (uint64_t)(int64_t)changed->number : 0;
    cdr_write_words(&writer, &whole, 1);
    cdr_write_words(&writer, &changed->number, 1);
    cdr_write_text(&writer, changed->kind == IS_TEXT ? changed->text : "");
    for (k = 0; k < 5; k++) {
        cdr_write_whole(&writer, 0);
    }
    cdr_write_whole(&writer, 0);
    if (own->events.open && writer.at <= writer.room) {
        cdr_publish(&own->events.publisher, data, writer.at);
    }
}

static void set(node *own, const rcl_interfaces__msg__Parameter *asked,
                rcl_interfaces__msg__SetParametersResult *result)
{
    parameter *known = parameter_find(own, asked->name.data);
    const ros_value *value = &asked->value;
    given_value found = {value->type, NAN, NULL, NULL, 0};
    char words[WORDS] = "";

    if (value->type == IS_BOOL) {
        found.number = value->bool_value;
    } else if (value->type == IS_WHOLE) {
        found.number = (double)value->integer_value;
    } else if (value->type == IS_NUMBER) {
        found.number = value->double_value;
    } else if (value->type == IS_TEXT) {
        found.text = value->string_value.data;
    } else if (value->type == IS_NUMBERS) {
        found.numbers = value->double_array_value.data;
        found.count = value->double_array_value.size;
    }
    if (known == NULL) {
        snprintf(words, sizeof words, "parameter %.200s: the native loop has none of this name", asked->name.data);
    } else if (parameter_take(own, known, &found, false, words)) {
        result->successful = true;
        tell_change(own, known);
    }
    rosidl_runtime_c__String__assign(&result->reason, words);
}

#define SERVICE(kind) ROSIDL_GET_SRV_TYPE_SUPPORT(rcl_interfaces, srv, kind)
/* Serve the requests of a kind: what it needs is in `answer`, by request and response. */
#define SERVE(index, kind, answer)                                                                                     \
    do {                                                                                                               \
        rcl_interfaces__srv__##kind##_Request request;                                                                 \
        rcl_interfaces__srv__##kind##_Response response;                                                               \
        rmw_request_id_t from;                                                                                         \
        rcl_interfaces__srv__##kind##_Request__init(&request);                                                         \
        rcl_interfaces__srv__##kind##_Response__init(&response);                                                       \
        if (node_is_asked(own, &own->services[index], &from, &request)) {                                              \
            answer;                                                                                                    \
            (void)!rcl_send_response(&own->services[index], &from, &response);                                         \
        }                                                                                                              \
        rcl_interfaces__srv__##kind##_Request__fini(&request);                                                         \
        rcl_interfaces__srv__##kind##_Response__fini(&response);                                                       \
    } while (0)

/* Serve requests with the names of parameters: `fill` makes the answer to each name that is known. */
#define ANSWER_EACH(index, kind, type, answers, fill)                                                                  \
    SERVE(index, kind, {                                                                                               \
        rcl_interfaces__msg__##type##__Sequence__init(&response.answers, request.names.size);                          \
        for (k = 0; k < response.answers.size; k++) {                                                                  \
            const parameter *found = parameter_find(own, request.names.data[k].data);                                  \
                                                                                                                       \
            if (found != NULL) {                                                                                       \
                fill(found, &response.answers.data[k]);                                                                \
            }                                                                                                          \
        }                                                                                                              \
    })

static void describe(const parameter *own, rcl_interfaces__msg__ParameterDescriptor *found)
{
    rosidl_runtime_c__String__assign(&found->name, own->name);
    rosidl_runtime_c__String__assign(&found->description, own->description);
    rosidl_runtime_c__String__assign(&found->additional_constraints, own->constraints);
    found->type = (uint8_t)own->kind;
    found->read_only = !own->live;
    found->dynamic_typing = own->kind == IS_NUMBERS;
    if (own->ranged && own->kind == IS_NUMBER
        && rcl_interfaces__msg__FloatingPointRange__Sequence__init(&found->floating_point_range, 1)) {
        found->floating_point_range.data[0].from_value = own->low;
        found->floating_point_range.data[0].to_value = own->high;
    } else if (own->ranged && own->kind == IS_WHOLE
               && rcl_interfaces__msg__IntegerRange__Sequence__init(&found->integer_range, 1)) {
        found->integer_range.data[0].from_value = (int64_t)own->low;
        found->integer_range.data[0].to_value = (int64_t)own->high;
        found->integer_range.data[0].step = 1;
    }
}

static void list(node *own, rcl_interfaces__msg__ListParametersResult *found)
{
    int k;

    if (rosidl_runtime_c__String__Sequence__init(&found->names, (size_t)own->count)) {
        for (k = 0; k < own->count; k++) {
            rosidl_runtime_c__String__assign(&found->names.data[k], own->parameters[k].name);
        }
    }
}

void parameters_open(node *own)
{
    static const char *const names[PARAMETER_SERVICES] = {
        "~/describe_parameters", "~/get_parameters", "~/get_parameter_types", "~/list_parameters", "~/set_parameters",
        "~/set_parameters_atomically"};
    const rosidl_service_type_support_t *kinds[PARAMETER_SERVICES] = {
        SERVICE(DescribeParameters), SERVICE(GetParameters), SERVICE(GetParameterTypes), SERVICE(ListParameters),
        SERVICE(SetParameters), SERVICE(SetParametersAtomically)};
    rcl_service_options_t options = rcl_service_get_default_options();
    int k;

    options.qos = rmw_qos_profile_parameters;
    for (k = 0; k < PARAMETER_SERVICES; k++) {
        own->services[k] = rcl_get_zero_initialized_service();
        CHECK(rcl_service_init(&own->services[k], &own->handle, kinds[k], names[k], &options));
        node_listen(own, &own->services[k]);
    }
}

void parameters_serve(node *own)
{
    size_t k;

    ANSWER_EACH(0, DescribeParameters, ParameterDescriptor, descriptors, describe);
    ANSWER_EACH(1, GetParameters, ParameterValue, values, to_ros);
    SERVE(2, GetParameterTypes, {
        rosidl_runtime_c__uint8__Sequence__init(&response.types, request.names.size);
        for (k = 0; k < response.types.size; k++) {
            const parameter *found = parameter_find(own, request.names.data[k].data);

            response.types.data[k] = found == NULL ? 0 : (uint8_t)found->kind;
        }
    });
    SERVE(3, ListParameters, list(own, &response.result));
    SERVE(4, SetParameters, {
        rcl_interfaces__msg__SetParametersResult__Sequence__init(&response.results, request.parameters.size);
        for (k = 0; k < response.results.size; k++) {
            set(own, &request.parameters.data[k], &response.results.data[k]);
        }
    });
    SERVE(5, SetParametersAtomically, {
        for (k = 0; k < request.parameters.size && (k == 0 || response.result.successful); k++) {
            response.result.successful = false;
            set(own, &request.parameters.data[k], &response.result);
        }
    });
}
