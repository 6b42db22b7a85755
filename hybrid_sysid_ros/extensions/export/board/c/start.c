/* Start of a Cortex-M board of Arm's MPS2 family, its clock, its serial line and the debugger's console. Another board
 * needs another file of this kind: what it gives is in board.h. Generated; do not edit.
 */
#include "board.h"

#define SYSTICK ((volatile uint32_t *)0xE000E010u) /* control, reload, now */
#define INTERRUPTS (*(volatile uint32_t *)0xE000E100u)
#define COPROCESSORS (*(volatile uint32_t *)0xE000ED88u)
#define UART ((volatile uint32_t *)0x40004000u) /* data, state, control, interrupt, divisor */
#define TURN (BOARD_FREQUENCY / 10u) /* ticks between two interrupts of the clock */
#define WAITING 4096u /* bytes that may wait: a power of two */

extern uint32_t board_stack_top[], board_data_load[], board_data_begin[], board_data_end[];
extern uint32_t board_zero_begin[], board_zero_end[];
int main(void);
void board_reset(void);

static volatile uint32_t turns, head, tail;
static volatile uint8_t waiting[WAITING];

static int ask_debugger(int what, const void *argument)
{
    register int answer __asm__("r0") = what;
    register const void *given __asm__("r1") = argument;

    __asm__ volatile("bkpt 0xAB" : "+r"(answer) : "r"(given) : "memory");
    return answer;
}

void board_print(const char *text, int count)
{
    for (int i = 0; i < count; i++) {
        ask_debugger(0x03, text + i);
    }
}

void board_exit(int code)
{
    const uint32_t reason[2] = {0x20026u, (uint32_t)code};

    ask_debugger(0x20, reason);
    for (;;) {
    }
}

uint64_t board_ticks(void)
{
    uint32_t before, now;

    do { /* again where a turn ended in between */
        before = turns;
        now = SYSTICK[2];
    } while (before != turns);
    return (uint64_t)before * TURN + (TURN - 1u - now);
}

int board_received(void)
{
    int byte = -1;

    if (head != tail) {
        byte = waiting[tail % WAITING];
        tail++;
    }
    return byte;
}

void board_send(const uint8_t *bytes, int count)
{
    for (int i = 0; i < count; i++) {
        while (UART[1] & 1u) {
        }
        UART[0] = bytes[i];
    }
}

void board_wait(void)
{
    __asm__ volatile("cpsid i" ::: "memory"); /* a byte that comes now still wakes it */
    if (head == tail) {
        __asm__ volatile("wfi");
    }
    __asm__ volatile("cpsie i" ::: "memory");
}

static void on_clock(void)
{
    turns++;
}

static void on_byte(void)
{
    UART[3] = 2u;
    while (UART[1] & 2u) {
        waiting[head % WAITING] = (uint8_t)UART[0]; /* what nobody takes is overwritten: its checksum is wrong then */
        head++;
    }
}

static void on_fault(void)
{
    board_print("fault\n", 6);
    board_exit(3);
}

void board_reset(void)
{
    const uint32_t *from = board_data_load;

    COPROCESSORS |= 0xFu << 20; /* the floating-point unit */
    __asm__ volatile("dsb\n\tisb");
    for (uint32_t *to = board_data_begin; to < board_data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = board_zero_begin; to < board_zero_end; to++) {
        *to = 0;
    }
    SYSTICK[1] = TURN - 1u;
    SYSTICK[2] = 0;
    SYSTICK[0] = 7u;
    UART[4] = 16u;
    UART[2] = 1u | 2u | 8u; /* sends, receives, and interrupts where it has received */
    INTERRUPTS = 1u;
    board_exit(main());
}

__attribute__((section(".vectors"), used)) static void (*const vectors[17])(void) = {
    (void (*)(void))board_stack_top, board_reset, on_fault, on_fault, on_fault, on_fault, on_fault,
    [15] = on_clock, [16] = on_byte,
};
