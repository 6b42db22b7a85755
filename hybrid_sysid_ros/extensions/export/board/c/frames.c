/* Frames on a serial line; see frames.h. Generated; do not edit. */
#include "frames.h"

uint32_t frames_checksum(const uint8_t *bytes, int count)
{
    uint32_t found = 0xFFFFFFFFu;

    for (int i = 0; i < count; i++) {
        found ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            found = (found >> 1) ^ (0xEDB88320u & (0u - (found & 1u)));
        }
    }
    return ~found;
}

static int ended(const frames_receiver *receiver)
{
    const int count = receiver->count - 4;
    uint32_t told = 0;

    if (count < 1 || receiver->left > 0) {
        return -1;
    }
    for (int i = 0; i < 4; i++) {
        told |= (uint32_t)receiver->content[count + i] << 8 * i;
    }
    return told == frames_checksum(receiver->content, count) ? count : -1;
}

int frames_receive(frames_receiver *receiver, uint8_t byte)
{
    int length = -1;

    if (byte == 0) {
        length = ended(receiver);
        receiver->wrong += receiver->code != 0 && length < 0; /* zeros in a row are no frames */
        receiver->count = receiver->left = receiver->code = 0;
        return length;
    }
    if (receiver->left > 0) {
        receiver->left--;
    } else { /* byte is a code: a zero stands before it, unless the block had its full length */
        const int full = receiver->code == 0 || receiver->code == 0xFF;

        receiver->code = byte;
        receiver->left = byte - 1;
        if (full) {
            return -1;
        }
        byte = 0;
    }
    if (receiver->count < FRAMES_LONGEST + 4) {
        receiver->content[receiver->count] = byte;
        receiver->count++;
    } else {
        receiver->left = 0x7FFFFFFF; /* too long: nothing counts until its end */
    }
    return -1;
}

int frames_encode(const uint8_t *content, int count, uint8_t *coded)
{
    const uint32_t checksum = frames_checksum(content, count);
    int code = 0, at = 1; /* where the code of this block stands, and the next byte */

    for (int i = 0; i < count + 4; i++) {
        const uint8_t byte = i < count ? content[i] : (uint8_t)(checksum >> 8 * (i - count));

        if (byte != 0) {
            coded[at] = byte;
            at++;
        }
        if (byte == 0 || (at - code == 0xFF && i < count + 3)) {
            coded[code] = (uint8_t)(at - code);
            code = at;
            at++;
        }
    }
    coded[code] = (uint8_t)(at - code);
    coded[at] = 0;
    return at + 1;
}
