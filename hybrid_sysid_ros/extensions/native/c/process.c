#define _GNU_SOURCE /* dl_iterate_phdr */
#include "process.h"

#include <link.h>
#include <stdarg.h>
#include <stdio.h>
#include <sys/mman.h>
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

static int forget_segments(struct dl_phdr_info *of, size_t size, void *given)
{
    const uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE);
    int k;

    (void)size;
    (void)given;
    for (k = 0; k < of->dlpi_phnum; k++) {
        const ElfW(Phdr) *part = &of->dlpi_phdr[k];
        const uintptr_t begin = of->dlpi_addr + part->p_vaddr, end = (begin + part->p_memsz) / page * page;
        const uintptr_t whole = (begin + page - 1) / page * page;

        if (part->p_type == PT_LOAD && !(part->p_flags & PF_W) && end > whole) {
            (void)!madvise((void *)whole, end - whole, MADV_DONTNEED);
        }
    }
    return 0;
}

void forget_start(void)
{
    dl_iterate_phdr(forget_segments, NULL);
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
