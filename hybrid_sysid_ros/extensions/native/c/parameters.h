/* The parameters of a node: what they begin with, and who may change them. */
#ifndef PARAMETERS_H
#define PARAMETERS_H

#include "node.h"

void parameters_begin(node *own);
void parameters_open(node *own);
void parameters_serve(node *own);

#endif
