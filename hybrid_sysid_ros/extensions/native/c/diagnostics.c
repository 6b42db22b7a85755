#include "diagnostics.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "joints.h"

#define SHORTEST 1e-6
#define ROOM (1 << 16)

/* ------------------------------------------------------------------ durations */

static void histogram_add(histogram *own, double seconds)
{
    const double bucket = seconds > SHORTEST ? PER_DECADE * log10(seconds / SHORTEST) : 0.0;

    own->counts[bucket < BUCKETS - 1 ? (int)bucket : BUCKETS - 1]++;
    own->count++;
    own->longest = seconds > own->longest ? seconds : own->longest;
}

static double percentile(const histogram *own, double percent)
{
    double found;
    int64_t sum = 0;
    int k = 0;

    if (!own->count) {
        return NAN;
    }
    while (k < BUCKETS - 1 && (double)(sum += own->counts[k]) < percent / 100.0 * (double)own->count) {
        k++;
    }
    found = SHORTEST * pow(10.0, (k + 1.0) / PER_DECADE);
    return found < own->longest ? found : own->longest;
}

void timing_add(timing *own, double seconds)
{
    histogram_add(&own->window, seconds);
    histogram_add(&own->total, seconds);
}

void task_timing(task *own, const char *name, timing *durations)
{
    const histogram *parts[2] = {&durations->total, &durations->window};
    const char *ends[2] = {"", "_window"};
    char key[96];
    int k;

    for (k = 0; k < 2; k++) {
        snprintf(key, sizeof key, "%s_ms%s_p50", name, ends[k]);
        task_number(own, key, 1e3 * percentile(parts[k], 50.0));
        snprintf(key, sizeof key, "%s_ms%s_p99", name, ends[k]);
        task_number(own, key, 1e3 * percentile(parts[k], 99.0));
        snprintf(key, sizeof key, "%s_ms%s_max", name, ends[k]);
        task_number(own, key, parts[k]->count ? 1e3 * parts[k]->longest : NAN);
    }
    memset(&durations->window, 0, sizeof durations->window);
}

/* ------------------------------------------------------------------ tasks */

void task_begin(task *own, const char *name)
{
    own->name = name;
    own->level = OK;
    own->count = 0;
    snprintf(own->message, sizeof own->message, "running");
}

static reported *next(task *own, const char *key)
{
    reported *value = &own->values[own->count];

    own->count += own->count < MOST_VALUES - 1;
    memset(value, 0, sizeof *value);
    snprintf(value->key, sizeof value->key, "%s", key);
    return value;
}

void task_whole(task *own, const char *key, long value)
{
    reported *made = next(own, key);

    made->is_whole = true;
    made->number = (double)value;
    snprintf(made->text, sizeof made->text, "%ld", value);
}

void task_number(task *own, const char *key, double value)
{
    reported *made = next(own, key);

    made->number = value;
    snprintf(made->text, sizeof made->text, isnan(value) ? "nan" : "%.6g", value);
}

void task_text(task *own, const char *key, const char *value)
{
    reported *made = next(own, key);

    made->is_text = true;
    snprintf(made->text, sizeof made->text, "%s", value);
}

/* Warn of a doubt, before what is known already. */
void task_doubt(task *own, enum level level, const char *words)
{
    char before[WORDS];

    memcpy(before, own->message, sizeof before);
    if (own->level == OK) {
        snprintf(own->message, sizeof own->message, "%s", words);
    } else {
        snprintf(own->message, sizeof own->message, "%.300s; %.400s", words, before);
    }
    own->level = own->level > level ? own->level : level;
}

void trouble(troubles *own, const char *words, long count)
{
    int k;

    for (k = 0; k < own->count && strcmp(own->items[k].words, words); k++) {
    }
    if (k < MOST_TROUBLES) {
        if (k == own->count) {
            snprintf(own->items[k].words, sizeof own->items[k].words, "%s", words);
            own->count++;
        }
        own->items[k].now = count;
    }
}

void task_judge(task *own, troubles *by, long total, double warn, double error)
{
    long tries = total - by->total, sum = 0, most = 0;
    char words[WORDS] = "";
    int k;

    for (;;) { /* the most frequent first */
        int worst = -1;

        for (k = 0; k < by->count; k++) {
            const long grown = by->items[k].now - by->items[k].before;

            if (grown > 0 && (worst < 0 || grown > by->items[worst].now - by->items[worst].before)) {
                worst = k;
            }
        }
        if (worst < 0) {
            break;
        }
        const long grown = by->items[worst].now - by->items[worst].before;
        const size_t at = strlen(words);

        snprintf(words + at, sizeof words - at, "%s%ld %s", sum ? ", " : "", grown, by->items[worst].words);
        by->items[worst].before = by->items[worst].now;
        most = sum ? most : grown;
        sum += grown;
    }
    by->total = total;
    if (sum) {
        tries = tries > most ? tries : most;
        own->level = (double)sum >= error * (double)tries ? ERROR : (double)sum >= warn * (double)tries ? WARN : OK;
        snprintf(own->message, sizeof own->message, "%.700s, of %ld", words, tries);
    }
}

void tasks_publish(const task *tasks, int count, const char *node, const char *rig, const rcl_publisher_t *publisher)
{
    static uint8_t data[ROOM];
    cdr_writer writer = cdr_open(data, sizeof data);
    char name[256];
    int k, j;

    cdr_write_time(&writer, now());
    cdr_write_text(&writer, "");
    cdr_write_whole(&writer, (uint32_t)count);
    for (k = 0; k < count; k++) {
        snprintf(name, sizeof name, "%s: %s", node, tasks[k].name);
        cdr_write_byte(&writer, (uint8_t)tasks[k].level);
        cdr_write_text(&writer, name);
        cdr_write_text(&writer, tasks[k].message);
        cdr_write_text(&writer, rig);
        cdr_write_whole(&writer, (uint32_t)tasks[k].count);
        for (j = 0; j < tasks[k].count; j++) {
            cdr_write_text(&writer, tasks[k].values[j].key);
            cdr_write_text(&writer, tasks[k].values[j].text);
        }
    }
    if (writer.at <= writer.room) {
        cdr_publish(publisher, data, writer.at);
    }
}

static double peak_memory(void)
{
    FILE *status = fopen("/proc/self/status", "r");
    char line[256];
    double found = NAN;

    while (status != NULL && fgets(line, sizeof line, status)) {
        if (sscanf(line, "VmHWM: %lf", &found) == 1) {
            found *= 1.024e-3;
            break;
        }
    }
    if (status != NULL) {
        fclose(status);
    }
    return found;
}

static void print_text(const char *text)
{
    putchar('"');
    for (; *text; text++) {
        if (*text == '"' || *text == '\\') {
            putchar('\\');
        }
        putchar((unsigned char)*text < ' ' ? ' ' : *text);
    }
    putchar('"');
}

void tasks_print(const task *tasks, int count, const char *node)
{
    int k, j;

    printf("{\"node\": \"%s\"", node);
    for (k = 0; k < count; k++) {
        for (j = 0; j < tasks[k].count; j++) {
            const reported *value = &tasks[k].values[j];

            printf(", ");
            print_text(value->key);
            printf(": ");
            if (value->is_text) {
                print_text(value->text);
            } else if (!isfinite(value->number)) {
                printf("null");
            } else {
                printf(value->is_whole ? "%.0f" : "%.17g", value->number);
            }
        }
    }
    printf(", \"memory_mb\": %.6g}\n", peak_memory());
    fflush(stdout);
}
