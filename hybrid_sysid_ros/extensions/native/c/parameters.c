/* The parameters of the nodes: what may be given to them, and their values at the start. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "rcl_yaml_param_parser/parser.h"

#include "parameters.h"

parameter *parameter_find(node *own, const char *name)
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

bool parameter_take(node *of, parameter *own, const given_value *value, bool starts, char *words)
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
            parameter *known = parameter_find(own, name);
            bool elsewhere = !strcmp(name, "start_type_description_service");

            for (k = 0; k < OTHER_PARAMETERS && !elsewhere; k++) {
                elsewhere = !strcmp(name, other_parameters[k]);
            }
            if (known == NULL && !elsewhere) {
                refuse("parameter %s: the native loop has none of this name", name);
            }
            if (known != NULL && !parameter_take(own, known, &value, true, words)) {
                refuse("%s", words);
            }
        }
    }
    if (found != NULL) {
        rcl_yaml_node_struct_fini(found);
    }
}
