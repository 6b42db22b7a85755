/* What the controller says of itself. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "control.h"

static const char *const state_words[STATES_OF_LOOP] = {
    "driving", "slowed", "holding", "resting", "stopped", "disarmed"};
static const char *const layer_words[LAYERS] = {
    "exact", "policy", "shifted_plan", "held", "zeroed", "rested", "stopped", "no_reference"};
static const char *const status_words[STATUSES] = {
    "waiting", "solved", "iterated", "not_converged", "failed", "policy", "held", "rested"};

static troubles loop_troubles, policy_troubles;
static long doubts_before; /* until the last report: a loop slows for less than the time between two */

int controller_health(task *tasks)
{
    task *main_task = &tasks[0], *policy = &tasks[1];
    const double warn = value(CONTROLLER_WARN_SHARE), error = value(CONTROLLER_ERROR_SHARE);
    const enum loop_state level = (enum loop_state)unit.guard_failsafe[0].level;
    const bool by_guard = level > DRIVING && control.state > DRIVING && control.state < STOPPED;
    const bool acts = !strcmp(controller_parameters[CONTROLLER_DISTRUST].text, "act");
    const bool was_doubted = unit.guard_core[0].doubted != doubts_before;
    char words[WORDS], key[96];
    long answers = 0, dropped = 0;
    int k;

    for (k = 0; k < NO_REFERENCE; k++) {
        answers += control.layers[k];
    }
    doubts_before = unit.guard_core[0].doubted;
    task_begin(main_task, "loop");
    trouble(&loop_troubles, "answers without a reference", control.layers[NO_REFERENCE]);
    trouble(&loop_troubles, "commands held", control.layers[HELD]);
    trouble(&loop_troubles, "commands at rest", control.layers[ZEROED]);
    trouble(&loop_troubles, "answers after the end of the reference", control.past_end);
    trouble(&loop_troubles, "references beyond the travel", control.clipped);
    for (k = 0; k < REASONS; k++) {
        dropped += control.wishes.dropped[k];
        if (k != UNRELATED) {
            snprintf(words, sizeof words, "references %s", reason_words[k]);
            trouble(&loop_troubles, words, control.wishes.dropped[k]);
        }
    }
    task_judge(main_task, &loop_troubles, answers, warn, error);
    task_text(main_task, "state", state_words[control.state]);
    operation_words(words);
    task_text(main_task, "state_reason",
              by_guard || control.state == SLOWED ? doubt_in_words()
              : control.state == RESTING          ? "there is no sound estimate, or no answer to it"
                                                  : words);
    task_text(main_task, "ready", *unready() ? unready() : "yes");
    for (k = 0; k < STATES_OF_LOOP; k++) {
        snprintf(key, sizeof key, "times_%s", state_words[k]);
        task_whole(main_task, key, control.times_in[k]);
    }
    for (k = 0; k < DOUBTS; k++) {
        snprintf(key, sizeof key, "evidence_%s", doubt_names[k]);
        task_number(main_task, key, unit.guard_kinds[k].value);
    }
    task_text(main_task, "policy", controller_parameters[CONTROLLER_POLICY].text);
    task_whole(main_task, "commands", answers);
    for (k = 0; k < LAYERS; k++) {
        if (control.layers[k]) {
            snprintf(key, sizeof key, "layer_%s", layer_words[k]);
            task_whole(main_task, key, control.layers[k]);
        }
    }
    task_whole(main_task, "dropped_references", dropped);
    task_whole(main_task, "clipped_references", control.clipped);
    task_whole(main_task, "repeated_estimates", control.repeated);
    task_text(main_task, "body", BODY);
    task_text(main_task, "not_watched", NOT_WATCHED_LOOP);
    task_timing(main_task, "execution", &control.execution);
    task_timing(main_task, "estimate_age", &control.age);
    if (was_doubted || level > DRIVING || control.state == SLOWED) {
        char own[WORDS], *rest = main_task->message;

        snprintf(own, sizeof own, "%s%s%s%.200s%s%.300s", acts ? state_words[control.state] : "", acts ? ": " : "",
                 doubt_in_words(), acts ? "" : " (distrust is tell)", main_task->level == OK ? "" : "; ",
                 main_task->level == OK ? "" : rest);
        if (level > SLOWED) {
            main_task->level = ERROR;
        } else if (main_task->level < WARN) {
            main_task->level = WARN;
        }
        snprintf(main_task->message, sizeof main_task->message, "%s", own);
    }
    if (*words && (main_task->level == OK || control.emergency)) {
        main_task->level = control.emergency && main_task->level < WARN ? WARN : main_task->level;
        snprintf(main_task->message, sizeof main_task->message, "%s", words);
    } else if (!control.stamp && main_task->level == OK) {
        snprintf(main_task->message, sizeof main_task->message, "waiting for estimates");
    } else if (estimator_silence() >= 0 && (double)estimator_silence() / 1e9 > value(CONTROLLER_STALE_SECONDS)) {
        main_task->level = STALE;
        snprintf(main_task->message, sizeof main_task->message, "nothing on state_estimate for %.1f s",
                 (double)estimator_silence() / 1e9);
    }
    task_begin(policy, "policy");
    trouble(&policy_troubles, "plans not converged", control.statuses[NOT_CONVERGED]);
    trouble(&policy_troubles, "plans failed", control.statuses[FAILED]);
    trouble(&policy_troubles, "plans held", control.statuses[KEPT]);
    task_judge(policy, &policy_troubles, answers, warn, error);
    for (k = 0; k < STATUSES; k++) {
        if (control.statuses[k]) {
            snprintf(key, sizeof key, "status_%s", status_words[k]);
            task_whole(policy, key, control.statuses[k]);
        }
    }
    return 2;
}
