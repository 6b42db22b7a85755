/* How the loop comes to rest, and how it stays where it is. */
#include <math.h>
#include <string.h>

#include "control.h"

void rest_with(enum layer layer)
{
    double found[INPUTS];

    memcpy(found, rest, sizeof found);
    if (layer == RESTED) {
        at_rest(found);
    }
    control.layers[layer]++;
    control.settled = false;
    control.returning = true;
    become(operated(RESTING));
    send_command(found, true);
}

bool is_long(void)
{
    return !control.sound || (double)(time_of_loop() - control.sound) / 1e9 > value(CONTROLLER_ZERO_AFTER);
}

void hold_command(void)
{
    if (is_long()) {
        rest_with(ZEROED);
        return;
    }
    control.layers[HELD]++;
    send_command(control.input, true);
}

void stop_moving(void)
{
    const double seconds = value(CONTROLLER_STOP_SECONDS);
    double share = 1.0, found[INPUTS];
    int j;

    if (seconds > 0.0 && !control.emergency) {
        share = fmin((double)(time_of_loop() - control.acted) / 1e9 / seconds, 1.0);
    }
    at_rest(found);
    for (j = 0; j < INPUTS; j++) {
        const double away = control.input[j] - found[j], room = share * (input_high[j] - input_low[j]);

        found[j] += copysign(fmax(fabs(away) - room, 0.0), away);
    }
    control.layers[STOPPED_LAYER]++;
    become(operated(RESTING));
    control.settled = false;
    control.returning = true;
    send_command(found, true);
}
