/* Serialised messages (CDR, little endian), read and written in place: nothing is allocated for a message. */
#ifndef CDR_H
#define CDR_H

#include <stddef.h>

#include "process.h"

#define FIELDS 3 /* position, velocity and effort */

typedef struct {
    const uint8_t *data;
    size_t size, at;
    bool wrong; /* the bytes are no message of the kind */
} cdr_reader;

typedef struct {
    const char *text; /* not ended by a zero */
    size_t length;
} cdr_text;

/* Numbers as they lie in a message, which need not be aligned. */
typedef struct {
    const uint8_t *first;
    size_t count;
} cdr_numbers;

cdr_reader cdr_begin(const rcl_serialized_message_t *message);
uint32_t cdr_read_whole(cdr_reader *reader);
int64_t cdr_read_time(cdr_reader *reader); /* [ns] */
cdr_text cdr_read_text(cdr_reader *reader);
cdr_numbers cdr_read_numbers(cdr_reader *reader);
double cdr_number(cdr_numbers numbers, size_t index); /* NAN where there is none */

/* Writes into a buffer of fixed size; what does not fit is counted and left out. */
typedef struct {
    uint8_t *data;
    size_t room, at;
} cdr_writer;

cdr_writer cdr_open(uint8_t *data, size_t room);
void cdr_write_byte(cdr_writer *writer, uint8_t value);
void cdr_write_whole(cdr_writer *writer, uint32_t value);
void cdr_write_time(cdr_writer *writer, int64_t time);
void cdr_write_text(cdr_writer *writer, const char *text);
size_t cdr_write_numbers(cdr_writer *writer, size_t count); /* NAN; returns where the first one is */
void cdr_write_words(cdr_writer *writer, const void *values, size_t count); /* of eight bytes */
void cdr_put_whole(uint8_t *data, size_t at, uint32_t value);
void cdr_put_time(uint8_t *data, size_t at, int64_t time);
bool cdr_publish(const rcl_publisher_t *publisher, uint8_t *data, size_t size);

#endif
