#include "process.h"

#include <stdarg.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

rcl_context_t context;
bool ended;
int64_t clock_time; /* of /clock [ns]; -1: it is not used */

int64_t steady(void)
{
    struct timespec time;

    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec * SECOND + time.tv_nsec;
}

int64_t now(void)
{
    struct timespec time;

    if (clock_time >= 0) {
        return clock_time;
    }
    clock_gettime(CLOCK_REALTIME, &time);
    return time.tv_sec * SECOND + time.tv_nsec;
}

void refuse(const char *words, ...)
{
    va_list given;

    va_start(given, words);
    fprintf(stderr, "error: ");
    vfprintf(stderr, words, given);
    fprintf(stderr, "\n");
    va_end(given);
    fflush(NULL);
    _exit(2); /* exit() would free what threads of the middleware still use */
}

void announce(const char *words, ...)
{
    va_list given;

    va_start(given, words);
    vprintf(words, given);
    putchar('\n');
    va_end(given);
    fflush(stdout);
}

void process_check(rcl_ret_t found, const char *what)
{
    if (found != RCL_RET_OK) {
        const char *why = rcl_get_error_string().str;
        char line[WORDS];
        size_t k;

        snprintf(line, sizeof line, "%.700s", why);
        for (k = 0; line[k]; k++) {
            line[k] = line[k] == '\n' ? ' ' : line[k];
        }
        refuse("ROS cannot make the node (%.40s): %s", what, line);
    }
}
