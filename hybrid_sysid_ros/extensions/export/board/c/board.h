/* What a board gives to the loop: a clock, and a serial line. Generated; do not edit. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

#define BOARD_FREQUENCY 25000000u /* of the clock [Hz] */

/* Time since the start in ticks of the clock; in the emulator one is 40 instructions. */
uint64_t board_ticks(void);

/* A byte of the serial line, -1 where none waits. */
int board_received(void);

void board_send(const uint8_t *bytes, int count);

/* Sleep until the next byte, at most until the next tenth of a second. */
void board_wait(void);

/* What the console of the debugger shows. */
void board_print(const char *text, int count);

void board_exit(int code);

#endif
