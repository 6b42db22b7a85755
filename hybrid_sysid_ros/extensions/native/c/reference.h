/* The reference: a preview from messages, and what leads it on when the loop comes back. */
#ifndef REFERENCE_H
#define REFERENCE_H

#include "loop.h"

#define MOST_POINTS 4096

void reference_begin(void);
bool reference_is_there(void);
bool reference_covers(int64_t time);
/* Keep the reference of a message that is believed; time: its start where it has no stamp [ns]. Whether it was. */
bool reference_take(const rcl_serialized_message_t *message, validator *by, int64_t time, long *clipped);
void reference_at(int64_t time, double *outputs);
void reference_last(double *outputs);

#endif
