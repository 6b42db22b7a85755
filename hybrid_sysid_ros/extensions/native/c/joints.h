/* Messages of joints: their numbers by name, and their form when they are written. */
#ifndef JOINTS_H
#define JOINTS_H

#include "cdr.h"
#include "validation.h"

#define LARGEST_MESSAGE (1 << 17) /* bytes */

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
