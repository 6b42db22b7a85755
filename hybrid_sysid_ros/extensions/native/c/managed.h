/* A node from its beginning to its end: what it is asked, and what it reports. */
#ifndef MANAGED_H
#define MANAGED_H

#include "node.h"

void node_begin(node *own);
void node_serve(node *own);
void node_report(node *own, bool printed);
void node_end(node *own);
void node_close(node *own);

#endif
