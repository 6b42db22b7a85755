/* What all of this process has in common: its clocks, its context, and how it refuses and announces. */
#ifndef PROCESS_H
#define PROCESS_H

#include <stdbool.h>
#include <stdint.h>

#include "rcl/error_handling.h"
#include "rcl/rcl.h"

#define SECOND INT64_C(1000000000)
#define WORDS 768 /* bytes of a sentence at most */

extern rcl_context_t context;
extern bool ended;
extern int64_t clock_time; /* of /clock [ns]; -1: it is not used */

int64_t now(void);    /* of the ROS clock [ns] */
int64_t steady(void); /* of a clock that nobody sets [ns] */
void forget_start(void); /* what is only read of libraries, most of it when they start, leaves memory until it is read */
#define CHECK(call) process_check((call), #call)
void process_check(rcl_ret_t found, const char *what);
void refuse(const char *words, ...) __attribute__((format(printf, 1, 2), noreturn));
void announce(const char *words, ...) __attribute__((format(printf, 1, 2)));

#endif
