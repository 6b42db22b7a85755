/* What the files of the estimator share. */
#ifndef ESTIMATOR_H
#define ESTIMATOR_H

#include "loop.h"

#define WINDOW 4096 /* innovations whose mean is reported, at most */
#define value(which) value_of(&estimator_node, which)

typedef struct {
    validator entry;
    estimate newest;
    double innovations[WINDOW];
    long updates, missing, invalid, unknown, gated, late, unusable, repeated, restarts, too_soon, blind, seen;
    timing execution;
} estimator_state;

extern estimator_state estimation;

int estimator_health(task *tasks);

#endif
