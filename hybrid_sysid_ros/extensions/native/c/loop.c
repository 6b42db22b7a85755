/* Estimator and controller one behind the other: an estimate is answered before it is published. */
#include "loop.h"

UNIT(memory) unit;

void loop_begin(void)
{
    if (!UNIT(init)(&unit)) {
        refuse("the memory of the loop's solver is too small: report this");
    }
    UNIT(reset)(&unit);
    estimator_serves(controller_answer, controller_repeat);
}

int loop_inlets(inlet **inlets)
{
    const int count = estimator_inlets(inlets);

    return count + controller_inlets(inlets + count);
}

void loop_receive(const inlet *from, const rcl_serialized_message_t *message)
{
    (void)(estimator_receive(from, message) || controller_receive(from, message));
}

void loop_look(void)
{
    estimator_look();
    controller_look();
}
