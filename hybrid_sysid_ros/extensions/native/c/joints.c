#include "joints.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ------------------------------------------------------------------ what comes */

slot_reader slot_reader_of(const slot *slots, int count, int optional)
{
    slot_reader own = {slots, count, optional, NULL, NULL, 0, 0};

    own.found = calloc((size_t)count + 1, sizeof *own.found);
    own.names = malloc(LARGEST_MESSAGE);
    return own;
}

void slot_reader_look(slot_reader *own, const uint8_t *names, size_t size, uint32_t count)
{
    bool twice = false;
    int k;

    if (size == own->names_size && own->named && !memcmp(names, own->names, size)) {
        return;
    }
    own->named = 0;
    own->names_size = size;
    memcpy(own->names, names, size);
    for (k = 0; k < own->count; k++) {
        size_t at = 0;
        uint32_t j;

        own->found[k] = -1;
        for (j = 0; j < count; j++) {
            uint32_t bytes;

            at = (at + 3) / 4 * 4;
            memcpy(&bytes, names + at, 4);
            if (bytes && bytes - 1 == strlen(own->slots[k].entry)
                && !memcmp(names + at + 4, own->slots[k].entry, bytes - 1)) {
                twice = twice || own->found[k] >= 0;
                own->found[k] = (int)j;
                own->named++;
            }
            at += 4 + bytes;
        }
    }
    own->named = twice ? -1 : own->named;
}

bool joints_unpack(const rcl_serialized_message_t *message, validator *by, joint_states *found)
{
    cdr_reader reader = cdr_begin(message);
    uint32_t k;
    int field;

    if (message->buffer_length > LARGEST_MESSAGE) {
        by->dropped[TOO_LARGE]++;
        return false;
    }
    found->stamp = cdr_read_time(&reader);
    found->source = cdr_read_text(&reader);
    found->count = cdr_read_whole(&reader);
    reader.at = reader.wrong ? reader.at : (reader.at + 3) / 4 * 4;
    found->names = reader.data + reader.at;
    for (k = 0; k < found->count && !reader.wrong; k++) {
        cdr_read_text(&reader);
    }
    found->names_size = (size_t)(reader.data + reader.at - found->names);
    for (field = 0; field < FIELDS; field++) {
        found->lists[field] = cdr_read_numbers(&reader);
    }
    if (reader.wrong) {
        by->dropped[UNREADABLE]++;
        return false;
    }
    for (field = 0; field < FIELDS; field++) {
        if (found->lists[field].count && found->lists[field].count != found->count) {
            by->dropped[MALFORMED]++;
            return false;
        }
    }
    return true;
}

bool joints_read(const joint_states *joints, slot_reader *reader, validator *by, double *values)
{
    const int needed = reader->count - reader->optional;
    int k, wrong = -1;

    slot_reader_look(reader, joints->names, joints->names_size, joints->count);
    if (reader->named <= 0) {
        by->dropped[reader->named ? MALFORMED : UNRELATED]++;
        return false;
    }
    for (k = 0; k < reader->count; k++) {
        const slot *own = &reader->slots[k];

        values[k] = reader->found[k] < 0 ? NAN : cdr_number(joints->lists[own->field], (size_t)reader->found[k]);
        if (!(own->low <= values[k] && values[k] <= own->high) && (k < needed || !isnan(values[k]))) {
            wrong = wrong < 0 ? k : wrong;
        }
    }
    if (wrong >= 0) {
        by->dropped[reader->named < reader->count ? UNNAMED : isnan(values[wrong]) ? NO_NUMBER : OUT_OF_RANGE]++;
        for (k = 0; k < reader->count; k++) {
            if (!(reader->slots[k].low <= values[k] && values[k] <= reader->slots[k].high)) {
                values[k] = NAN;
            }
        }
    }
    return true;
}

/* ------------------------------------------------------------------ what goes */

static cdr_writer head_of(const message_form *form, const char *source, size_t room)
{
    cdr_writer writer = cdr_open(calloc(1, room), room);
    int k;

    cdr_write_time(&writer, 0);
    cdr_write_text(&writer, source);
    cdr_write_whole(&writer, (uint32_t)form->names);
    for (k = 0; k < form->names; k++) {
        cdr_write_text(&writer, form->name[k]);
    }
    return writer;
}

static size_t room_for(const message_form *form, const char *source, int points)
{
    size_t room = 64 + strlen(source);
    int k;

    for (k = 0; k < form->names; k++) {
        room += strlen(form->name[k]) + 12;
    }
    return room + (size_t)points * (80 + 24 * (size_t)form->names);
}

static void take_places(written_message *own, const message_form *form, int point, const size_t *first)
{
    int k;

    for (k = 0; k < form->numbers; k++) {
        own->at[point * form->numbers + k] = first[form->places[k].field] + 8 * (size_t)form->places[k].index;
    }
}

written_message joints_written(const message_form *form, const char *source)
{
    cdr_writer writer = head_of(form, source, room_for(form, source, 1));
    written_message own = {writer.data, 0, form->numbers, 1, NULL};
    size_t first[FIELDS];
    int field;

    own.at = calloc((size_t)form->numbers, sizeof *own.at);
    for (field = 0; field < FIELDS; field++) {
        first[field] = cdr_write_numbers(&writer, form->lists[field] ? (size_t)form->names : 0);
    }
    take_places(&own, form, 0, first);
    own.size = writer.at;
    return own;
}

written_message trajectory_written(const message_form *form, int points, double interval, const char *source)
{
    cdr_writer writer = head_of(form, source, room_for(form, source, points));
    written_message own = {writer.data, 0, form->numbers, points, NULL};
    int point, field;

    own.at = calloc((size_t)form->numbers * (size_t)points, sizeof *own.at);
    cdr_write_whole(&writer, (uint32_t)points);
    for (point = 0; point < points; point++) {
        size_t first[FIELDS];

        for (field = 0; field < FIELDS; field++) {
            if (field == FIELDS - 1) {
                cdr_write_numbers(&writer, 0); /* accelerations */
            }
            first[field] = cdr_write_numbers(&writer, form->lists[field] ? (size_t)form->names : 0);
        }
        take_places(&own, form, point, first);
        cdr_write_time(&writer, llround(interval * (point + 1) * 1e9));
    }
    own.size = writer.at;
    return own;
}

void message_write(written_message *own, int point, const double *values)
{
    int k;

    for (k = 0; k < own->numbers; k++) {
        memcpy(own->data + own->at[point * own->numbers + k], &values[k], 8);
    }
}

bool message_publish(written_message *own, int64_t stamp, const rcl_publisher_t *publisher)
{
    cdr_put_time(own->data, 4, stamp);
    return cdr_publish(publisher, own->data, own->size);
}
