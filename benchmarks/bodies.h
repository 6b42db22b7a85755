/* What a unit's own test takes for its count of instructions: nanoseconds. */
#define _POSIX_C_SOURCE 199309L
#include <time.h>

static double nanoseconds(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e9 * (double)now.tv_sec + (double)now.tv_nsec;
}
