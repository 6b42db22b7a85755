/* The states of a node, and who may change them. */
#ifndef LIFECYCLE_H
#define LIFECYCLE_H

#include "node.h"

void lifecycle_open(node *own);
void lifecycle_serve(node *own);
void lifecycle_bring_up(node *own);

#endif
