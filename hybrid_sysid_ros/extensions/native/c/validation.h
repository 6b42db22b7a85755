/* Which messages of a topic are believed, and which publisher, as in nodes/validation.py. Times are [ns]. */
#ifndef VALIDATION_H
#define VALIDATION_H

#include "cdr.h"

#define LONGEST_SOURCE 256

enum reason {
    TOO_LARGE, UNREADABLE, MALFORMED, NO_ORDER, UNNAMED, UNRELATED, NO_NUMBER, OUT_OF_RANGE, AHEAD, LONG_PAST,
    BACKWARDS, OTHER, REASONS
};
extern const char *const reason_words[REASONS];

enum stamp_order { REFUSED, NEW, DUPLICATE, LATE, RESTART };

typedef struct {
    bool timed; /* whether stamps are of a clock */
    int64_t ahead, behind, silence;
    int64_t stamp, first, heard, back, offset;
    bool chosen;
    char source[LONGEST_SOURCE];
    long dropped[REASONS];
} validator;

void validator_begin(validator *own, bool timed, double ahead, double behind, double silence);
void validator_forget(validator *own);
bool validator_accepts_source(validator *own, cdr_text source);
void validator_select_source(validator *own, cdr_text source);
enum stamp_order validator_order(validator *own, int64_t stamp);
enum stamp_order validator_admit(validator *own, cdr_text source, int64_t stamp);

#endif
