/* What the nodes say of themselves: durations, and tasks with their levels, as nodes/diagnostics.py has them. */
#ifndef DIAGNOSTICS_H
#define DIAGNOSTICS_H

#include "cdr.h"

#define PER_DECADE 200
#define BUCKETS (8 * PER_DECADE)
#define MOST_VALUES 96
#define MOST_TROUBLES 32

/* Durations from 1 us to 100 s. */
typedef struct {
    int64_t counts[BUCKETS], count;
    double longest;
} histogram;

typedef struct {
    histogram window, total;
} timing;

void timing_add(timing *own, double seconds);

enum level { OK, WARN, ERROR, STALE };

typedef struct {
    char key[96];
    bool is_text, is_whole;
    double number;
    char text[WORDS];
} reported;

typedef struct {
    const char *name;
    enum level level;
    char message[WORDS];
    int count;
    reported values[MOST_VALUES];
} task;

/* Faults since the start; a task is judged by those since its last report. */
typedef struct {
    int count;
    struct {
        char words[96];
        long now, before;
    } items[MOST_TROUBLES];
    long total;
} troubles;

void task_begin(task *own, const char *name);
void task_whole(task *own, const char *key, long value);
void task_number(task *own, const char *key, double value);
void task_text(task *own, const char *key, const char *value);
void task_timing(task *own, const char *name, timing *durations);
void task_doubt(task *own, enum level level, const char *words);
void trouble(troubles *own, const char *words, long count);
void task_judge(task *own, troubles *by, long total, double warn, double error);

/* Publish tasks as a DiagnosticArray; node: its full name without the first slash. */
void tasks_publish(const task *tasks, int count, const char *node, const char *rig, const rcl_publisher_t *publisher);
/* Print them as a line of JSON with the largest memory. */
void tasks_print(const task *tasks, int count, const char *node);

#endif
