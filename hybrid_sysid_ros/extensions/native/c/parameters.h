/* The parameters of a node: what they begin with, and who may change them. */
#ifndef PARAMETERS_H
#define PARAMETERS_H

#include "node.h"

/* A value that somebody gives. */
typedef struct {
    int kind;
    double number;
    const char *text;
    const double *numbers;
    size_t count;
} given_value;

parameter *parameter_find(node *own, const char *name); /* NULL where there is none */
/* Take a value; false with the reason in words where that is not possible. */
bool parameter_take(node *of, parameter *own, const given_value *value, bool starts, char *words);

void parameters_begin(node *own);
void parameters_open(node *own);
void parameters_serve(node *own);

#endif
