/* What printf of newlib needs. Generated; do not edit. */
#include "board.h"

#include <stddef.h>
#include <sys/stat.h>

static char heap[8192] __attribute__((aligned(8)));
static int used;

void *_sbrk(ptrdiff_t by);
int _write(int file, const char *text, int count);
int _read(int file, char *text, int count);
int _close(int file);
int _lseek(int file, int offset, int from);
int _fstat(int file, struct stat *found);
int _isatty(int file);
int _getpid(void);
int _kill(int process, int signal);
void _exit(int code);

void *_sbrk(ptrdiff_t by)
{
    void *found = (void *)-1;

    if (by <= (ptrdiff_t)sizeof heap - used) {
        found = heap + used;
        used += (int)by;
    }
    return found;
}

int _write(int file, const char *text, int count)
{
    (void)file;
    board_print(text, count);
    return count;
}

int _read(int file, char *text, int count)
{
    (void)file, (void)text, (void)count;
    return 0;
}

int _close(int file)
{
    (void)file;
    return -1;
}

int _lseek(int file, int offset, int from)
{
    (void)file, (void)offset, (void)from;
    return 0;
}

int _fstat(int file, struct stat *found)
{
    (void)file;
    found->st_mode = S_IFCHR;
    return 0;
}

int _isatty(int file)
{
    (void)file;
    return 1;
}

int _getpid(void)
{
    return 1;
}

int _kill(int process, int signal)
{
    (void)process, (void)signal;
    return -1;
}

void _exit(int code)
{
    board_exit(code);
    for (;;) {
    }
}
