/* What estimator and controller share: the unit, and the newest estimate. */
#ifndef LOOP_H
#define LOOP_H

#include "node.h"

typedef struct {
    int64_t stamp; /* of the measurement [ns] */
    int64_t began; /* when it came, in steady time [ns] */
    bool blind;    /* no reading has been usable for long: nothing may be made of it */
    UNIT(command) answer;
    double outputs[OUTPUTS]; /* expected */
    UNIT(real) applied[INPUTS]; /* what acted, NAN where nobody says */
} estimate;

extern UNIT(memory) unit;

void loop_begin(void);
int loop_inlets(inlet **inlets);
void loop_receive(const inlet *from, const rcl_serialized_message_t *message);
void loop_look(void); /* every 10 ms */

/* Who is asked with every estimate, and again where a measurement comes twice. */
void estimator_serves(void (*answers)(const estimate *found, enum stamp_order order), void (*repeats)(void));
int estimator_inlets(inlet **inlets);
bool estimator_receive(const inlet *from, const rcl_serialized_message_t *message);
void estimator_look(void);
bool estimator_is_heard(void);   /* whether somebody publishes measurements */
int64_t estimator_silence(void); /* since the newest estimate [ns]; -1 before the first */

int controller_inlets(inlet **inlets);
bool controller_receive(const inlet *from, const rcl_serialized_message_t *message);
void controller_look(void);
void controller_answer(const estimate *found, enum stamp_order order);
void controller_repeat(void);

static inline double value_of(const node *own, int parameter)
{
    return own->parameters[parameter].number;
}

#endif
