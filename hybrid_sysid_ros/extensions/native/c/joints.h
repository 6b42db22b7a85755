/* Messages of joints: their numbers by name, their form when they are written, and which of them are believed. */
#ifndef JOINTS_H
#define JOINTS_H

#include "cdr.h"

#define LARGEST_MESSAGE (1 << 17) /* bytes */
#define LONGEST_SOURCE 256

/* A number in a message: an entry's, in one of its lists, within its bounds. */
typedef struct {
    const char *entry;
    int field;
    double low, high;
} slot;

/* The form of messages that are written: their entries, which lists they have, and the place of each number. */
typedef struct {
    int field, index;
} place;

typedef struct {
    int names;
    const char *const *name;
    bool lists[FIELDS];
    int numbers;
    const place *places;
} message_form;

enum reason {
    TOO_LARGE, UNREADABLE, MALFORMED, NO_ORDER, UNNAMED, UNRELATED, NO_NUMBER, OUT_OF_RANGE, AHEAD, LONG_PAST,
    BACKWARDS, OTHER, REASONS
};
extern const char *const reason_words[REASONS];

enum stamp_order { REFUSED, NEW, DUPLICATE, LATE, RESTART };

/* Which messages of a topic are believed, and which publisher, as in nodes/validation.py. Times are [ns]. */
typedef struct {
    bool timed; /* whether stamps are of a clock */
    int64_t ahead, behind, silence;
    int64_t stamp, heard, back, offset;
    bool chosen;
    char source[LONGEST_SOURCE];
    long dropped[REASONS];
} validator;

typedef struct {
    cdr_text source;
    int64_t stamp;
    const uint8_t *names; /* as they lie in the message */
    size_t names_size;
    uint32_t count;
    cdr_numbers lists[FIELDS];
} joint_states;

/* Where the numbers of some slots were in the last message: the next one most often has the same names. */
typedef struct {
    const slot *slots;
    int count, optional; /* optional: how many of the last may be missing */
    int *found;
    uint8_t *names;
    size_t names_size;
    int named;
} slot_reader;


void validator_begin(validator *own, bool timed, double ahead, double behind, double silence);
void validator_forget(validator *own);
bool validator_accepts_source(validator *own, cdr_text source);
void validator_select_source(validator *own, cdr_text source);
enum stamp_order validator_order(validator *own, int64_t stamp);
enum stamp_order validator_admit(validator *own, cdr_text source, int64_t stamp);

slot_reader slot_reader_of(const slot *slots, int count, int optional);
void slot_reader_look(slot_reader *own, const uint8_t *names, size_t size, uint32_t count);
bool joints_unpack(const rcl_serialized_message_t *message, validator *by, joint_states *found);
bool joints_read(const joint_states *joints, slot_reader *reader, validator *by, double *values);

typedef struct {
    uint8_t *data;
    size_t size;
    int numbers, points;
    size_t *at;
} written_message;

written_message joints_written(const message_form *form, const char *source);
written_message trajectory_written(const message_form *form, int points, double interval, const char *source);
void message_write(written_message *own, int point, const double *values);
bool message_publish(written_message *own, int64_t stamp, const rcl_publisher_t *publisher);

#endif
