/* What users have asked the loop to do, and whether it may move at all: as nodes/operation.py. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "control.h"

controller_state control;

static const char *way_back(void)
{
    return control.emergency ? "call the services reset and arm" : "call the service arm";
}

const char *operation_words(char *words)
{
    if (!control.armed) {
        snprintf(words, WORDS, "disarmed (%.300s): %s", control.reason, way_back());
    } else if (control.mode == DRIVE) {
        words[0] = 0;
    } else {
        snprintf(words, WORDS, "%s until the service enable is called",
                 control.mode == STOP ? "stopped" : "holding the outputs");
    }
    return words;
}

static void say(const char *which)
{
    char words[WORDS];

    operation_words(words);
    announce("%s: %s", which, *words ? words : "the loop drives");
}

enum loop_state operated(enum loop_state level)
{
    if (!control.armed) {
        return DISARMED;
    }
    return control.mode == STOP ? STOPPED : control.mode == HOLD && level < HOLDING ? HOLDING : level;
}

void become(enum loop_state next)
{
    control.times_in[next] += next != control.state;
    control.state = next;
}

void operation_begin(void)
{
    control.armed = value(CONTROLLER_ARMED) != 0.0;
    if (!control.armed) {
        snprintf(control.reason, sizeof control.reason, "not armed yet");
        say("at rest");
    }
}

static bool turn_to(enum mode next, char *words)
{
    const enum mode before = control.mode;

    if (next != STOP && !control.armed) {
        snprintf(words, WORDS, "the loop is disarmed (%.300s): %s", control.reason, way_back());
        return false;
    }
    if (next == HOLD && before == STOP) {
        snprintf(words, WORDS, "the loop is stopped, which a hold would end: call the service enable");
        return false;
    }
    control.mode = next;
    say(next == DRIVE ? "may move" : "at rest");
    if (before == HOLD && next == DRIVE && control.settled) {
        UNIT(lead)(&unit, control.home);
    }
    control.settled = control.settled && next == DRIVE;
    return true;
}

bool operation_enable(char *words)
{
    return turn_to(DRIVE, words);
}

bool operation_hold(char *words)
{
    return turn_to(HOLD, words);
}

bool operation_stop(char *words)
{
    return turn_to(STOP, words);
}

void operation_reset(void)
{
    if (control.emergency) {
        control.emergency = false;
        say("at rest");
    }
}

void stop_at_once(const char *why)
{
    double found[INPUTS];

    if (!control.emergency) {
        control.armed = false;
        control.emergency = true;
        snprintf(control.reason, sizeof control.reason, "emergency stop by %s", why);
        say("at rest");
    }
    at_rest(found);
    send_command(found, false);
}

bool operation_estop(char *words)
{
    (void)words;
    stop_at_once("the service estop or a stop by hand");
    return true;
}

bool operation_disarm(char *words)
{
    (void)words;
    control.armed = false;
    if (!*control.reason) {
        snprintf(control.reason, sizeof control.reason, "by the service disarm");
    }
    say("at rest");
    return true;
}

const char *doubt_in_words(void)
{
    return unit.guard_core[0].found < 0 ? "" : doubts[unit.guard_core[0].found];
}

const char *unready(void)
{
    const int64_t silent = estimator_silence();
    int k;

    if (silent < 0 || (double)silent / 1e9 > value(CONTROLLER_STALE_SECONDS)) {
        return "no estimates come on state_estimate: start the estimator and the sensors";
    }
    for (k = 0; k < STATES; k++) {
        if (!isfinite(control.newest.ahead[k])) {
            return "the estimates are no numbers: look at the estimator's diagnostics";
        }
    }
    if (unit.guard_failsafe[0].level > DRIVING) {
        static char words[WORDS];

        snprintf(words, sizeof words, "%s: wait until it has settled", doubt_in_words());
        return words;
    }
    return "";
}

bool operation_arm(char *words)
{
    if (control.emergency) {
        snprintf(words, WORDS, "%.300s is latched: call the service reset before", control.reason);
        return false;
    }
    if (*unready()) {
        snprintf(words, WORDS, "not ready to be armed: %s", unready());
        return false;
    }
    control.armed = true;
    control.mode = DRIVE;
    control.reason[0] = 0;
    say("may move");
    return true;
}
