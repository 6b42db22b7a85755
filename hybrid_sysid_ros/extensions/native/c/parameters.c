/* The parameters of the nodes: values at the start, and the services by which others read and set them. */
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
#include "rcl_yaml_param_parser/parser.h"
#include "rosidl_runtime_c/primitives_sequence_functions.h"
#include "rosidl_runtime_c/string_functions.h"

#include "parameters.h"

typedef rcl_interfaces__msg__ParameterValue ros_value;

/* A value that somebody gives. */
typedef struct {
    int kind;
    double number;
    const char *text;
    const double *numbers;
    size_t count;
} given_value;

static parameter *find(node *own, const char *name)
{
    int k;

    for (k = 0; k < own->count; k++) {
        if (!strcmp(own->parameters[k].name, name)) {
            return &own->parameters[k];
        }
    }
    return NULL;
}

static double element(const given_value *value, int k)
{
    return value->kind == IS_NUMBERS ? value->numbers[k] : value->number;
}

/* Whether a parameter has a value now. */
static bool is_same(const parameter *own, const given_value *value)
{
    int k;

    if (own->kind == IS_TEXT) {
        return value->kind == IS_TEXT && !strcmp(own->text, value->text);
    }
    if (own->kind == IS_NUMBERS) {
        if (value->kind == IS_TEXT || (value->kind == IS_NUMBERS && value->count != (size_t)own->count)) {
            return false;
        }
        for (k = 0; k < own->count; k++) {
            if (element(value, k) != own->numbers[k]) {
                return false;
            }
        }
        return true;
    }
    return value->kind != IS_TEXT && value->kind != IS_NUMBERS && own->number == value->number;
}

/* Take a value; false with the reason in words where that is not possible. */
static bool take(node *of, parameter *own, const given_value *value, bool starts, char *words)
{
    static const char *const kinds[] = {"no value", "true or false", "a whole number", "a number", "a text", "", "", "",
                                        "a list of numbers"};
    const bool fits = own->kind == (enum kind)value->kind || (own->kind == IS_NUMBER && value->kind == IS_WHOLE)
                      || (own->kind == IS_NUMBERS && (value->kind == IS_NUMBER || value->kind == IS_WHOLE));

    if (!fits) {
        snprintf(words, WORDS, "parameter %s: it needs %s", own->name, kinds[own->kind]);
        return false;
    }
    if (is_same(own, value)) {
        return true;
    }
    if (!(own->live || (starts && own->given))) {
        snprintf(words, WORDS, own->given ? "parameter %s is read when the loop starts: start it with another value"
                 : "parameter %s is a part of the compiled loop: start the native loop again with another value, "
                   "which builds it anew", own->name);
        return false;
    }
    if (own->kind != IS_TEXT && own->ranged && !(own->low <= value->number && value->number <= own->high)) {
        snprintf(words, WORDS, "parameter %s is %g: it must be within %g and %g", own->name, value->number, own->low,
                 own->high);
        return false;
    }
    if (own->above >= 0 && !(value->number > of->parameters[own->above].number)) {
        snprintf(words, WORDS, "parameter %s is %g: it must be larger than %s, %g", own->name, value->number,
                 of->parameters[own->above].name, of->parameters[own->above].number);
        return false;
    }
    for (int k = 0; k < of->count; k++) {
        const parameter *other = &of->parameters[k];

        if (other->above >= 0 && &of->parameters[other->above] == own && !(other->number > value->number)) {
            snprintf(words, WORDS, "parameter %s is %g: %s must be larger, and is %g", own->name, value->number,
                     other->name, other->number);
            return false;
        }
    }
    own->number = value->number; /* no text and no list may change */
    return true;
}

/* ------------------------------------------------------------------ at the start */

/* Whether a pattern of a parameter file, such as / ** / estimator without blanks, is that of a node. */
static bool matches(const char *pattern, const char *name)
{
    const char *own = strrchr(pattern, '/') == NULL ? pattern : strrchr(pattern, '/') + 1;
    const char *last = strrchr(name, '/') + 1;

    if (!strcmp(pattern, "/**") || !strcmp(pattern, name) || !strcmp(pattern, name + 1)) {
        return true;
    }
    return !strncmp(pattern, "/**/", 4) && !strcmp(own, last);
}

static given_value given(const rcl_variant_t *value)
{
    given_value found = {0, NAN, NULL, NULL, 0};

    if (value->bool_value) {
        found.kind = IS_BOOL;
        found.number = *value->bool_value;
    } else if (value->integer_value) {
        found.kind = IS_WHOLE;
        found.number = (double)*value->integer_value;
    } else if (value->double_value) {
        found.kind = IS_NUMBER;
        found.number = *value->double_value;
    } else if (value->string_value) {
        found.kind = IS_TEXT;
        found.text = value->string_value;
    } else if (value->double_array_value) {
        found.kind = IS_NUMBERS;
        found.numbers = value->double_array_value->values;
        found.count = value->double_array_value->size;
    }
    return found;
}

void parameters_begin(node *own)
{
    rcl_params_t *found = NULL;
    char words[WORDS];
    size_t j, i;
    int k;

    CHECK(rcl_arguments_get_param_overrides(&context.global_arguments, &found));
    for (j = 0; found != NULL && j < found->num_nodes; j++) {
        if (!matches(found->node_names[j], rcl_node_get_fully_qualified_name(&own->handle))) {
            continue;
        }
        for (i = 0; i < found->params[j].num_params; i++) {
            const char *name = found->params[j].parameter_names[i];
            const given_value value = given(&found->params[j].parameter_values[i]);
            parameter *known = find(own, name);
            bool elsewhere = !strcmp(name, "start_type_description_service");

            for (k = 0; k < OTHER_PARAMETERS && !elsewhere; k++) {
                elsewhere = !strcmp(name, other_parameters[k]);
            }
            if (known == NULL && !elsewhere) {
                refuse("parameter %s: the native loop has none of this name", name);
            }
            if (known != NULL && !take(own, known, &value, true, words)) {
                refuse("%s", words);
            }
        }
    }
    if (found != NULL) {
        rcl_yaml_node_struct_fini(found);
    }
}

/* ------------------------------------------------------------------ services */

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

static void set(node *own, const rcl_interfaces__msg__Parameter *asked, rcl_interfaces__msg__SetParametersResult *result)
{
    parameter *known = find(own, asked->name.data);
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
    } else if (take(own, known, &found, false, words)) {
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
        if (rcl_take_request(&own->services[index], &from, &request) == RCL_RET_OK) {                                  \
            answer;                                                                                                    \
            (void)!rcl_send_response(&own->services[index], &from, &response);                                         \
        }                                                                                                              \
        rcl_interfaces__srv__##kind##_Request__fini(&request);                                                         \
        rcl_interfaces__srv__##kind##_Response__fini(&response);                                                       \
    } while (0)

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
    }
}

void parameters_serve(node *own)
{
    size_t k;

    SERVE(0, DescribeParameters, {
        rcl_interfaces__msg__ParameterDescriptor__Sequence__init(&response.descriptors, request.names.size);
        for (k = 0; k < response.descriptors.size; k++) {
            const parameter *found = find(own, request.names.data[k].data);

            if (found != NULL) {
                describe(found, &response.descriptors.data[k]);
            }
        }
    });
    SERVE(1, GetParameters, {
        rcl_interfaces__msg__ParameterValue__Sequence__init(&response.values, request.names.size);
        for (k = 0; k < response.values.size; k++) {
            const parameter *found = find(own, request.names.data[k].data);

            if (found != NULL) {
                to_ros(found, &response.values.data[k]);
            }
        }
    });
    SERVE(2, GetParameterTypes, {
        rosidl_runtime_c__uint8__Sequence__init(&response.types, request.names.size);
        for (k = 0; k < response.types.size; k++) {
            const parameter *found = find(own, request.names.data[k].data);

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
