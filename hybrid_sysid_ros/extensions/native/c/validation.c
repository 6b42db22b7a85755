#include "validation.h"

#include <string.h>

#define RESTARTED SECOND /* a stamp this far before the last one begins a new experiment, or is a fault */
#define SET 20000000     /* by which a clock that was set differs at least */

const char *const reason_words[REASONS] = {
    "too large", "unreadable", "lists of other lengths than the names", "times that do not rise", "names missing",
    "of other joints", "not a number", "out of range", "stamp ahead of the clock", "stamp long past",
    "stamp before the last one", "from another publisher",
};

void validator_begin(validator *own, bool timed, double ahead, double behind, double silence)
{
    memset(own, 0, sizeof *own);
    own->timed = timed;
    own->ahead = (int64_t)(ahead * 1e9);
    own->behind = behind < 9e9 ? (int64_t)(behind * 1e9) : INT64_MAX / 2;
    own->silence = timed ? (int64_t)(silence * 1e9) : 0;
}

void validator_forget(validator *own)
{
    own->stamp = own->heard = own->back = 0;
    own->chosen = false;
}

bool validator_accepts_source(validator *own, cdr_text source)
{
    const bool same = own->chosen && source.length == strlen(own->source)
                      && !memcmp(source.text, own->source, source.length);

    if (!same && own->heard && steady() - own->heard < own->silence) {
        own->dropped[OTHER]++;
        return false;
    }
    return true;
}

void validator_select_source(validator *own, cdr_text source)
{
    const size_t length = source.length < LONGEST_SOURCE - 1 ? source.length : LONGEST_SOURCE - 1;

    memcpy(own->source, source.text, length);
    own->source[length] = 0;
    own->chosen = true;
    own->heard = steady();
}

enum stamp_order validator_order(validator *own, int64_t stamp)
{
    const int64_t time = own->timed ? now() : 0;
    enum stamp_order found = NEW;

    if (own->timed && (stamp < time - own->behind || stamp > time + own->ahead)) {
        own->dropped[stamp > time ? AHEAD : LONG_PAST]++;
        return REFUSED;
    }
    if (own->stamp && stamp <= own->stamp) {
        found = stamp == own->stamp ? DUPLICATE : LATE;
        if (stamp < own->stamp - RESTARTED) {
            const int64_t before = own->back;
            const bool near = own->timed && own->behind < INT64_MAX / 2;

            own->back = stamp;
            if (!near && stamp != own->first && !(0 < before && before <= stamp && stamp < before + RESTARTED)) {
                own->dropped[BACKWARDS]++;
                return REFUSED;
            }
            found = RESTART;
        } else if (own->timed && own->stamp - stamp > SET
                   && own->offset - (time - steady()) > own->stamp - stamp - SET) {
            found = RESTART;
        }
    }
    if (found != LATE) {
        if (!own->stamp || found == RESTART) {
            own->first = stamp;
        }
        own->stamp = stamp;
        own->back = 0;
        own->offset = own->timed ? time - steady() : 0;
    }
    return found;
}

enum stamp_order validator_admit(validator *own, cdr_text source, int64_t stamp)
{
    const enum stamp_order found = validator_accepts_source(own, source) ? validator_order(own, stamp) : REFUSED;

    if (found != REFUSED) {
        validator_select_source(own, source);
    }
    return found;
}
