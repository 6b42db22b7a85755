#ifndef PARAMETER_H
#define PARAMETER_H

#include <stdbool.h>

enum kind { IS_BOOL = 1, IS_WHOLE, IS_NUMBER, IS_TEXT, IS_NUMBERS = 8 }; /* as in rcl_interfaces/ParameterType */

/* A parameter, as msgs_config declares it. What is not live is a part of the compiled loop, or read at the start. */
typedef struct {
    const char *name, *description, *constraints;
    enum kind kind;
    int count; /* of numbers in the list */
    double number;
    const char *text;
    const double *numbers;
    bool ranged, live, given; /* given: it may have another value at the start than the loop was made with */
    double low, high;
    int above; /* another parameter than which it must be larger, or -1 */
} parameter;

#endif
