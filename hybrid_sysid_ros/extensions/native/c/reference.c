#include "reference.h"

#include <math.h>
#include <string.h>

static int points;
static int64_t times[MOST_POINTS];
static double values[MOST_POINTS][OUTPUTS];

void reference_begin(void)
{
    points = 0;
}

bool reference_is_there(void)
{
    return points > 0;
}

bool reference_covers(int64_t time)
{
    return points > 0 && times[points - 1] >= time;
}

bool reference_take(const rcl_serialized_message_t *message, validator *by, int64_t time, long *clipped)
{
    static slot_reader reader;
    static int64_t new_times[MOST_POINTS];
    static double new_values[MOST_POINTS][OUTPUTS];
    cdr_reader bytes = cdr_begin(message);
    cdr_text source;
    const uint8_t *names;
    uint32_t count, name_count, j;
    int64_t stamp;
    bool absent = false, wrong = false, no_number = false, outside = false;
    int k;

    if (reader.found == NULL) {
        reader = slot_reader_of(measured_slots, OUTPUTS, 0);
    }
    if (message->buffer_length > LARGEST_MESSAGE) {
        by->dropped[TOO_LARGE]++;
        return false;
    }
    stamp = cdr_read_time(&bytes);
    source = cdr_read_text(&bytes);
    name_count = cdr_read_whole(&bytes);
    bytes.at = bytes.wrong ? bytes.at : (bytes.at + 3) / 4 * 4;
    names = bytes.data + bytes.at;
    for (j = 0; j < name_count && !bytes.wrong; j++) {
        cdr_read_text(&bytes);
    }
    if (bytes.wrong) {
        by->dropped[UNREADABLE]++;
        return false;
    }
    slot_reader_look(&reader, names, (size_t)(bytes.data + bytes.at - names), name_count);
    count = cdr_read_whole(&bytes);
    if (reader.named < 0 || count == 0 || count > MOST_POINTS) {
        by->dropped[bytes.wrong ? UNREADABLE : count > MOST_POINTS ? TOO_LARGE : MALFORMED]++;
        return false;
    }
    if (!validator_accepts_source(by, source)) {
        return false;
    }
    for (j = 0; j < count && !bytes.wrong; j++) {
        cdr_numbers lists[FIELDS + 1];
        int field;

        for (field = 0; field < FIELDS + 1; field++) { /* positions, velocities, accelerations, effort */
            lists[field] = cdr_read_numbers(&bytes);
            wrong = wrong || (field != 2 && lists[field].count && lists[field].count != name_count);
        }
        lists[2] = lists[3];
        new_times[j] = (stamp ? stamp : time) + cdr_read_time(&bytes);
        if (j && new_times[j] <= new_times[j - 1] && !bytes.wrong) {
            by->dropped[NO_ORDER]++;
            return false;
        }
        for (k = 0; k < OUTPUTS; k++) {
            const slot *own = &measured_slots[k];
            double value = reader.found[k] < 0 ? NAN : cdr_number(lists[own->field], (size_t)reader.found[k]);

            value = tracked[k] ? value : 0.0;
            absent = absent || (tracked[k] && reader.found[k] < 0);
            no_number = no_number || isnan(value);
            outside = outside || !(fabs(value) <= BEYOND);
            new_values[j][k] = value;
        }
    }
    if (bytes.wrong || wrong) {
        by->dropped[bytes.wrong ? UNREADABLE : MALFORMED]++;
        return false;
    }
    if (outside) {
        by->dropped[absent ? UNNAMED : no_number ? NO_NUMBER : OUT_OF_RANGE]++;
        return false;
    }
    if (stamp && by->timed && validator_order(by, stamp) == REFUSED) {
        return false;
    }
    validator_select_source(by, source);
    points = (int)count;
    memcpy(times, new_times, sizeof *times * count);
    for (j = 0; j < count; j++) {
        for (k = 0; k < OUTPUTS; k++) {
            const double value = fmin(fmax(new_values[j][k], reach_low[k]), reach_high[k]);

            wrong = wrong || value != new_values[j][k];
            values[j][k] = value;
        }
    }
    *clipped += wrong;
    return true;
}

void reference_at(int64_t time, double *outputs)
{
    int left = 0, right = points - 1, k;
    double share;

    if (points == 1) {
        memcpy(outputs, values[0], sizeof values[0]);
        return;
    }
    while (right - left > 1) { /* times[left] <= time < times[right], but at the ends */
        const int middle = (left + right) / 2;

        if (times[middle] <= time) {
            left = middle;
        } else {
            right = middle;
        }
    }
    share = (double)(time - times[left]) / (double)(times[right] - times[left]);
    share = fmin(fmax(share, 0.0), 1.0);
    for (k = 0; k < OUTPUTS; k++) {
        outputs[k] = (1.0 - share) * values[left][k] + share * values[right][k];
    }
}

void reference_last(double *outputs)
{
    memcpy(outputs, values[points - 1], sizeof values[0]);
}
