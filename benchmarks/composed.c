/* Plant and loop of @name in one process, without a middleware: how late each command is. Generated; do not edit. */
#define _GNU_SOURCE
#include "@name.h"
#include "@{name}_plant.h"

#include <fcntl.h>
#include <math.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#define SECOND 1000000000LL

static @{name}_memory loop;
static @{name}_plant_memory plant;

static long long now(void)
{
    struct timespec at;

    clock_gettime(CLOCK_MONOTONIC, &at);
    return at.tv_sec * SECOND + at.tv_nsec;
}

static double noise(void) /* standard normal, by Box and Muller (1958) */
{
    const double radius = (rand() + 1.0) / (RAND_MAX + 1.0), angle = 2.0 * M_PI * rand() / (RAND_MAX + 1.0);

    return sqrt(-2.0 * log(radius)) * cos(angle);
}

int main(int count, char **given)
{
    const long periods = count > 1 ? atol(given[1]) : 1000;
    const struct sched_param first = {.sched_priority = 80};
    long long *late = calloc((size_t)periods, sizeof *late), next;
    double error = 0.0, applied[@{NAME}_INPUTS];
    long k;
    int idle, j, step;

    if (late == NULL || !@{name}_init(&loop)) {
        return 1;
    }
    @{name}_reset(&loop);
    @{name}_plant_init(&plant);
    @{name}_plant_stand(&plant);
    idle = open("/dev/cpu_dma_latency", O_WRONLY); /* while it is open, no core sleeps so deeply that waking takes long */
    if (idle < 0 || write(idle, &(const int32_t){0}, sizeof(int32_t)) < 0) {
        fprintf(stderr, "cores may sleep\n");
    }
    if (sched_setscheduler(0, SCHED_FIFO, &first) || mlockall(MCL_CURRENT | MCL_FUTURE)) {
        fprintf(stderr, "without real-time priority\n");
    }
    for (j = 0; j < @{NAME}_INPUTS; j++) {
        applied[j] = plant.inputs[j];
    }
    next = now() + SECOND / 10;
    for (k = 0; k < periods; k++, next += @period_ns) {
        const struct timespec at = {next / SECOND, next % SECOND};
        @{name}_measurement measurement;
        @{name}_reference reference;
        @{name}_command command;

        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
        measurement.time = (double)k * @period;
        for (j = 0; j < @{NAME}_OUTPUTS; j++) {
            measurement.outputs[j] = plant.outputs[j] + @white * noise()
                + @hum * sqrt(2.0) * sin(2.0 * M_PI * @hertz * measurement.time); /* without any it looks frozen */
        }
        for (j = 0; j < @{NAME}_INPUTS; j++) {
            measurement.applied[j] = applied[j];
        }
        for (j = 0; j < @{NAME}_HORIZON; j++) { /* of its only output */
            reference.outputs[j] = @amplitude * sin(2.0 * M_PI * @frequency * (measurement.time + (j + 1) * @interval));
        }
        @{name}_step(&loop, &measurement, &reference, &command);
        late[k] = now() - next;
        for (j = 0; j < @{NAME}_INPUTS; j++) {
            plant.inputs[j] = applied[j] = command.inputs[j];
        }
        error += pow(plant.outputs[0] - @amplitude * sin(2.0 * M_PI * @frequency * measurement.time), 2.0);
        for (step = 0; step < @steps; step++) {
            @{name}_plant_step(&plant);
        }
        @{name}_prepare(&loop, @period);
    }
    printf("%.17g\n", sqrt(error / (double)periods));
    for (k = 0; k < periods; k++) {
        printf("%lld\n", late[k]);
    }
    return 0;
}
