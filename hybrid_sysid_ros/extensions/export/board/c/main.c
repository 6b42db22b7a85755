/* The loop of @name on a board: it answers measurements that come on the serial line. Generated; do not edit.
 *
@about
 */
#include "@name.h"
#include "board.h"
#include "frames.h"

#include <string.h>

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "numbers are sent as they lie in memory, the lowest byte first"
#endif

/* The first byte of a content; the next two are the number that an answer repeats. */
enum { HELLO = 'H', RESET = 'R', FORGET_PLAN = 'F', OBSERVE = 'O', DECIDE = 'D', PREPARE = 'P' };
enum { IDENTITY = 'I', ESTIMATE = 'E', COMMAND = 'C', HEARTBEAT = 'B' };

static @{name}_memory loop;
static frames_receiver receiver;
static uint8_t content[FRAMES_LONGEST], coded[FRAMES_CODED];
static int length, kept; /* bytes of the content, and of the last answer in coded */
static int32_t last = -1; /* its number */
static uint16_t number;
static uint32_t answered, ticks; /* answers so far, and the time of a period's calls */
static @{name}_command command;

static void put(const void *from, size_t count)
{
    memcpy(content + length, from, count);
    length += (int)count;
}

static void begin(uint8_t kind)
{
    length = 0;
    put(&kind, 1);
    put(&number, 2);
}

static void send(void)
{
    kept = frames_encode(content, length, coded);
    last = number;
    board_send(coded, kept);
}

static void tell_identity(void)
{
    const uint8_t sizes[] = {
        sizeof(@{name}_real), @{NAME}_STATES, @{NAME}_INPUTS, @{NAME}_OUTPUTS, @{NAME}_HORIZON, @version};

    begin(IDENTITY);
    put(sizes, sizeof sizes);
    put(@{NAME}_MODEL, strlen(@{NAME}_MODEL));
    send();
}

static void tell_heartbeat(void)
{
    const uint32_t alive = (uint32_t)(board_ticks() / (BOARD_FREQUENCY / 1000u)); /* ms */
    static uint8_t beat[3 + 3 * sizeof alive + 4 + 2 + 1]; /* coded keeps the last answer */

    begin(HEARTBEAT);
    put(&alive, sizeof alive);
    put(&answered, sizeof answered);
    put(&receiver.wrong, sizeof receiver.wrong);
    board_send(beat, frames_encode(content, length, beat));
}

static const uint8_t *get(void *into, const uint8_t *from, size_t count)
{
    memcpy(into, from, count);
    return from + count;
}

static void observe(const uint8_t *given)
{
    static @{name}_measurement measurement;
    uint8_t known;

    given = get(&measurement.time, given, sizeof measurement.time);
    given = get(measurement.outputs, given, sizeof measurement.outputs);
    get(measurement.applied, given, sizeof measurement.applied);
    known = (uint8_t)@{name}_observe(&loop, &measurement, &command);
    begin(ESTIMATE);
    put(&known, 1);
    put(command.state, sizeof command.state);
    put(command.ahead, sizeof command.ahead);
    put(command.disturbance, sizeof command.disturbance);
    send();
}

static void decide(const uint8_t *given, uint64_t start)
{
    static @{name}_reference reference;
    static @{name}_real sent[@{NAME}_INPUTS];
    uint8_t status;

    given = get(sent, given, sizeof sent);
    get(reference.outputs, given, sizeof reference.outputs);
    @{name}_sent(&loop, sent);
    @{name}_decide(&loop, &reference, &command);
    ticks += (uint32_t)(board_ticks() - start);
    answered++;
    begin(COMMAND);
    status = (uint8_t)command.status;
    put(&status, 1);
    put(&ticks, sizeof ticks);
    put(command.inputs, sizeof command.inputs);
    send();
    ticks = 0;
}

static void take(int count)
{
    static const int observed = @measurement, decided = @request, prepared = sizeof(@{name}_real);
    const uint8_t kind = receiver.content[0], *const given = receiver.content + 3;
    const uint64_t start = board_ticks();
    @{name}_real elapsed;

    if (count < 3) {
        return;
    }
    memcpy(&number, receiver.content + 1, sizeof number);
    count -= 3;
    if (number == last && (kind == OBSERVE || kind == DECIDE)) { /* its answer was lost */
        board_send(coded, kept);
    } else if (kind == OBSERVE && count == observed) {
        observe(given);
        ticks += (uint32_t)(board_ticks() - start);
    } else if (kind == DECIDE && count == decided) {
        decide(given, start);
    } else if (kind == PREPARE && count == prepared) {
        get(&elapsed, given, sizeof elapsed);
        @{name}_prepare(&loop, elapsed);
        ticks += (uint32_t)(board_ticks() - start);
    } else if (kind == FORGET_PLAN) {
        @{name}_forget_plan(&loop);
    } else if (kind == RESET) {
        @{name}_reset(&loop);
        tell_identity();
        last = -1; /* who asks may count anew */
    } else if (kind == HELLO) {
        tell_identity();
    }
}

int main(void)
{
    uint64_t next = 0;

    if (!@{name}_init(&loop)) {
        board_print("the memory of the solver is too small\n", 38);
        return 1;
    }
    @{name}_reset(&loop);
    for (;;) {
        int byte = board_received();

        if (byte >= 0) {
            const uint32_t wrong = receiver.wrong;
            const int count = frames_receive(&receiver, (uint8_t)byte);

            if (count >= 0) {
                take(count);
            } else if (receiver.wrong != wrong) { /* it may have been a question */
                tell_heartbeat();
            }
        } else {
            if (board_ticks() >= next) {
                tell_heartbeat();
                next = board_ticks() + BOARD_FREQUENCY / 10u;
            }
            board_wait();
        }
    }
}
