#include "cdr.h"

#include <math.h>
#include <string.h>

#define HEAD 4 /* bytes of the encapsulation, from behind which positions are aligned */

cdr_reader cdr_begin(const rcl_serialized_message_t *message)
{
    cdr_reader reader = {message->buffer, message->buffer_length, HEAD, false};

    reader.wrong = reader.size < HEAD || reader.data[1] != 1;
    return reader;
}

static bool cdr_has(cdr_reader *reader, size_t align, size_t bytes)
{
    const size_t at = HEAD + (reader->at - HEAD + align - 1) / align * align;

    if (reader->wrong || at > reader->size || bytes > reader->size - at) {
        reader->wrong = true;
        return false;
    }
    reader->at = at;
    return true;
}

uint32_t cdr_read_whole(cdr_reader *reader)
{
    uint32_t value = 0;

    if (cdr_has(reader, 4, 4)) {
        memcpy(&value, reader->data + reader->at, 4);
        reader->at += 4;
    }
    return value;
}

int64_t cdr_read_time(cdr_reader *reader)
{
    const uint32_t seconds = cdr_read_whole(reader), rest = cdr_read_whole(reader);

    return (int64_t)(int32_t)seconds * SECOND + (int64_t)rest;
}

cdr_text cdr_read_text(cdr_reader *reader)
{
    const size_t bytes = cdr_read_whole(reader);
    cdr_text found = {"", 0};

    if (bytes && cdr_has(reader, 1, bytes)) {
        found.text = (const char *)reader->data + reader->at;
        found.length = found.text[bytes - 1] ? bytes : bytes - 1;
        reader->at += bytes;
    }
    return found;
}

cdr_numbers cdr_read_numbers(cdr_reader *reader)
{
    const size_t count = cdr_read_whole(reader);
    cdr_numbers found = {NULL, 0};

    if (count && count <= reader->size / 8 && cdr_has(reader, 8, 8 * count)) {
        found.first = reader->data + reader->at;
        found.count = count;
        reader->at += 8 * count;
    } else if (count) {
        reader->wrong = true;
    }
    return found;
}

double cdr_number(cdr_numbers numbers, size_t index)
{
    double value = NAN;

    if (index < numbers.count) {
        memcpy(&value, numbers.first + 8 * index, 8);
    }
    return value;
}

cdr_writer cdr_open(uint8_t *data, size_t room)
{
    static const uint8_t head[HEAD] = {0, 1, 0, 0};
    cdr_writer writer = {data, room, HEAD};

    memcpy(data, head, HEAD);
    return writer;
}

static void cdr_write(cdr_writer *writer, size_t align, const void *bytes, size_t count)
{
    const size_t at = HEAD + (writer->at - HEAD + align - 1) / align * align;

    if (at + count <= writer->room) {
        memset(writer->data + writer->at, 0, at - writer->at);
        memcpy(writer->data + at, bytes, count);
    }
    writer->at = at + count;
}

void cdr_write_byte(cdr_writer *writer, uint8_t value)
{
    cdr_write(writer, 1, &value, 1);
}

void cdr_write_whole(cdr_writer *writer, uint32_t value)
{
    cdr_write(writer, 4, &value, 4);
}

void cdr_write_time(cdr_writer *writer, int64_t time)
{
    cdr_write_whole(writer, (uint32_t)(int32_t)(time / SECOND));
    cdr_write_whole(writer, (uint32_t)(time % SECOND));
}

void cdr_write_text(cdr_writer *writer, const char *text)
{
    const size_t bytes = strlen(text) + 1;

    cdr_write_whole(writer, (uint32_t)bytes);
    cdr_write(writer, 1, text, bytes);
}

size_t cdr_write_numbers(cdr_writer *writer, size_t count)
{
    const double none = NAN;
    size_t k;

    cdr_write_whole(writer, (uint32_t)count);
    for (k = 0; k < count; k++) {
        cdr_write(writer, 8, &none, 8);
    }
    return writer->at - 8 * count;
}

void cdr_write_words(cdr_writer *writer, const void *values, size_t count)
{
    cdr_write(writer, 8, values, 8 * count);
}

void cdr_put_whole(uint8_t *data, size_t at, uint32_t value)
{
    memcpy(data + at, &value, 4);
}

void cdr_put_time(uint8_t *data, size_t at, int64_t time)
{
    cdr_put_whole(data, at, (uint32_t)(int32_t)(time / SECOND));
    cdr_put_whole(data, at + 4, (uint32_t)(time % SECOND));
}

bool cdr_publish(const rcl_publisher_t *publisher, uint8_t *data, size_t size)
{
    rcl_serialized_message_t message = {data, size, size, rcl_get_default_allocator()};

    return rcl_publish_serialized_message(publisher, &message, NULL) == RCL_RET_OK;
}
