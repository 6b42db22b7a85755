/* Frames on a serial line: consistent overhead byte stuffing (Cheshire, Baker 1999), CRC-32 and a zero at the end.
 * No memory but the receiver's. Generated; do not edit.
 */
#ifndef FRAMES_H
#define FRAMES_H

#include <stdint.h>

#define FRAMES_LONGEST @longest /* bytes of content */
#define FRAMES_CODED (FRAMES_LONGEST + 4 + (FRAMES_LONGEST + 4) / 254 + 2)

typedef struct {
    uint8_t content[FRAMES_LONGEST + 4];
    int count; /* bytes of content so far */
    int left; /* bytes until the next code */
    int code;
    uint32_t wrong; /* frames that were cut, too long or damaged */
} frames_receiver;

/* Take a byte: the length of the content where it ends a whole frame, else -1. */
int frames_receive(frames_receiver *receiver, uint8_t byte);

/* Write a frame of a content; return its length. coded: FRAMES_CODED bytes. */
int frames_encode(const uint8_t *content, int count, uint8_t *coded);

uint32_t frames_checksum(const uint8_t *bytes, int count);

#endif
