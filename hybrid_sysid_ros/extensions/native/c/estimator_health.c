/* What the estimator says of itself. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "estimator.h"

static troubles loop_troubles, sensor_troubles;

static void band(double samples, double *low, double *high)
{
    const double all = samples * OUTPUTS, spread = 2.0 / (9.0 * all);
    const double root = 1.959963984540054 * sqrt(spread);

    *low = fmax(all * pow(1.0 - spread - root, 3.0) / samples, 0.0);
    *high = all * pow(1.0 - spread + root, 3.0) / samples;
}

/* The evidence against the newest estimate. */
static const char *doubted(char *words)
{
    int k;

    words[0] = 0;
    for (k = 0; k < OUTPUTS; k++) {
        if (unit.monitor_sensors[k].evidence >= 1.0) {
            snprintf(words + strlen(words), WORDS - strlen(words), "%s%.64s", *words ? ", " : "innovations of ",
                     output_names[k]);
        }
    }
    if (*words) {
        snprintf(words + strlen(words), WORDS - strlen(words), " are not as large as the model says");
    } else if (unit.monitor_watch[0].diverged) {
        return "the estimated input disturbance is at its limit";
    }
    return words;
}

static void judge_model(task *own)
{
    const long kept = estimation.seen < INNOVATIONS ? estimation.seen : INNOVATIONS;
    double sum = 0.0, low, high, worse;
    char words[WORDS];
    long k, counted = 0;

    for (k = 0; k < kept && k < WINDOW; k++) {
        const double one = estimation.innovations[(estimation.seen - 1 - k) % WINDOW];

        if (isfinite(one)) {
            sum += one;
            counted++;
        }
    }
    band(counted ? (double)counted : 1.0, &low, &high);
    task_begin(own, "model");
    task_number(own, "innovation_mean_square", counted ? sum / (double)counted : NAN);
    task_number(own, "innovation_band_low", low);
    task_number(own, "innovation_band_high", high);
    task_number(own, "doubt", unit.progress[0].doubt);
    for (k = 0; k < FOLLOWED; k++) {
        snprintf(words, sizeof words, "parameter_%s", followed_names[k]);
        task_number(own, words, (double)unit.out[2 * STATES + INPUTS + k]);
    }
    worse = counted ? sum / (double)counted / high : 0.0;
    if (worse > value(ESTIMATOR_INNOVATION_WARN)) {
        own->level = worse > value(ESTIMATOR_INNOVATION_ERROR) ? ERROR : WARN;
        snprintf(own->message, sizeof own->message, "innovations %.1f times as large as the model says", worse);
    } else if (unit.progress[0].doubt >= 1.0) {
        task_doubt(own, WARN, doubted(words));
    }
}

/* Say what has been found before what a task says else. */
static void task_found(task *own, const char *found)
{
    char words[2 * WORDS];

    snprintf(words, sizeof words, "%s%s%s", found, own->level == OK ? "" : "; ", own->level == OK ? "" : own->message);
    snprintf(own->message, sizeof own->message, "%.*s", (int)sizeof own->message - 1, words);
    own->level = own->level < WARN ? WARN : own->level;
}

int estimator_health(task *tasks)
{
    task *loop = &tasks[0], *sensor = &tasks[1];
    const double warn = value(ESTIMATOR_WARN_SHARE), error = value(ESTIMATOR_ERROR_SHARE);
    const double silent = (double)(steady() - estimation.entry.heard) / 1e9;
    char words[WORDS], out[WORDS] = "";
    long dropped = 0, frozen = 0;
    int k;

    task_begin(loop, "loop");
    trouble(&loop_troubles, "measurements missing", estimation.missing);
    trouble(&loop_troubles, "measurements too late", estimation.late);
    trouble(&loop_troubles, "measurements sooner than the parameter rate says", estimation.too_soon);
    trouble(&loop_troubles, "times that time began anew", estimation.restarts);
    trouble(&loop_troubles, "measurements before the first one of use", estimation.unusable);
    for (k = 0; k < REASONS; k++) {
        dropped += estimation.entry.dropped[k];
        if (k != UNRELATED) {
            snprintf(words, sizeof words, "measurements %s", reason_words[k]);
            trouble(&loop_troubles, words, estimation.entry.dropped[k]);
        }
    }
    task_judge(loop, &loop_troubles, estimation.updates, warn, error);
    task_whole(loop, "updates", estimation.updates);
    task_whole(loop, "late_measurements", estimation.late);
    task_whole(loop, "missing_measurements", estimation.missing);
    task_whole(loop, "dropped_measurements", dropped);
    task_whole(loop, "unusable_measurements", estimation.unusable);
    task_whole(loop, "repeated_measurements", estimation.repeated);
    task_whole(loop, "restarts", estimation.restarts);
    task_text(loop, "body", BODY);
    task_timing(loop, "execution", &estimation.execution);
    if (estimation.entry.heard && silent >= value(ESTIMATOR_STALE_SECONDS)) {
        loop->level = STALE;
        snprintf(loop->message, sizeof loop->message, "nothing on joint_states for %.1f s", silent);
    } else if (!estimation.newest.stamp && loop->level == OK) {
        snprintf(loop->message, sizeof loop->message, "waiting for measurements");
    }
    task_begin(sensor, "sensor");
    for (k = 0; k < OUTPUTS; k++) {
        frozen += unit.monitor_detectors[k].count;
    }
    trouble(&sensor_troubles, "readings that are no number", estimation.invalid - frozen);
    trouble(&sensor_troubles, "readings that the model does not believe", estimation.gated);
    trouble(&sensor_troubles, "estimates without a reading", estimation.blind);
    for (k = 0; k < OUTPUTS; k++) {
        snprintf(words, sizeof words, "times the same reading of %.64s", output_names[k]);
        trouble(&sensor_troubles, words, unit.monitor_detectors[k].count);
    }
    task_judge(sensor, &sensor_troubles, estimation.updates, warn, error);
    for (k = 0; k < OUTPUTS; k++) {
        snprintf(words, sizeof words, "frozen_%.64s", output_names[k]);
        task_whole(sensor, words, unit.monitor_detectors[k].count);
        snprintf(words, sizeof words, "left_out_%.64s", output_names[k]);
        task_whole(sensor, words, unit.monitor_sensors[k].count);
        if (unit.monitor_sensors[k].left_out) {
            snprintf(out + strlen(out), sizeof out - strlen(out), "%s%s", *out ? ", " : "", output_names[k]);
        }
    }
    if (*out) {
        snprintf(words, sizeof words, "%.200s contradicts the model and is left out", out);
        task_found(sensor, words);
    }
    if (unit.progress[0].reversed >= 0.0) {
        snprintf(words, sizeof words, "input %.64s acts reversed", input_names[(int)unit.progress[0].reversed]);
        task_found(sensor, words);
    }
    task_whole(sensor, "invalid_entries", estimation.invalid);
    task_whole(sensor, "unknown_inputs", estimation.unknown);
    task_whole(sensor, "gated_outliers", estimation.gated);
    task_whole(sensor, "resets", unit.progress[0].resets);
    task_whole(sensor, "blind_estimates", estimation.blind);
    task_text(sensor, "not_watched", NOT_WATCHED_SENSORS);
    judge_model(&tasks[2]);
    return 3;
}
