/* Commands and plans leave by these topics; what is sent is a number within the actuator's limits. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "sensor_msgs/msg/joint_state.h"
#include "std_msgs/msg/float64_multi_array.h"
#include "trajectory_msgs/msg/joint_trajectory.h"

#include "control.h"

#define LONGEST 0.05 /* s, as long as a first command may count */

static outlet commands, efforts, plans;
static written_message command, plan;

void output_begin(node *own)
{
    command = joints_written(&command_form, own->signature);
    plan = trajectory_written(&plan_form, HORIZON, INTERVAL, own->signature);
}

bool output_open(node *own)
{
    return outlet_open(&efforts, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Float64MultiArray),
                       "effort_command")
           && outlet_open(&plans, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(trajectory_msgs, msg, JointTrajectory),
                          "predicted_trajectory");
}

void output_open_commands(node *own)
{
    outlet_open(&commands, &own->handle, ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, JointState), "joint_command");
}

bool output_is_open(void)
{
    return commands.open;
}

void output_close(node *own)
{
    if (commands.open) { /* the last command must arrive */
        (void)!rcl_publisher_wait_for_all_acked(&commands.publisher, RCL_MS_TO_NS(100));
        rcl_reset_error();
    }
    outlet_close(&commands, &own->handle);
    outlet_close(&efforts, &own->handle);
    outlet_close(&plans, &own->handle);
}

int64_t time_of_loop(void)
{
    return LOCKSTEP ? control.stamp : steady();
}

bool moves(void)
{
    return memcmp(control.input, rest, sizeof control.input) != 0;
}

void repeat_command(void)
{
    if (!control.answered_once) {
        return;
    }
    if (commands.open) {
        message_publish(&command, control.stamp, &commands.publisher);
    }
    if (outlet_is_read(&efforts)) {
        uint8_t data[32 + 8 * INPUTS];
        cdr_writer writer = cdr_open(data, sizeof data);

        cdr_write_whole(&writer, 0);
        cdr_write_whole(&writer, 0);
        cdr_write_whole(&writer, INPUTS);
        cdr_write_words(&writer, control.input, INPUTS);
        cdr_publish(&efforts.publisher, data, writer.at);
    }
}

/* Publish a command that answers the newest estimate; limited: no faster than the actuators can follow. Whatever it is,
 * it is a number within the actuator's limits. */
void send_command(const double *inputs, bool limited)
{
    const int64_t time = time_of_loop();
    const double elapsed = control.acted ? (double)(time - control.acted) / 1e9 : fmin(INTERVAL, LONGEST);
    UNIT(real) sent[INPUTS];
    int j;

    for (j = 0; j < INPUTS; j++) {
        const double room = input_rate[j] * fmax(elapsed, 0.0);
        double u = isfinite(inputs[j]) ? inputs[j] : rest[j];

        u = limited ? fmin(fmax(u, control.input[j] - room), control.input[j] + room) : u;
        control.input[j] = fmin(fmax(u, input_low[j]), input_high[j]);
        sent[j] = (UNIT(real))control.input[j];
    }
    control.acted = time;
    UNIT(sent)(&unit, sent);
    message_write(&command, 0, control.input);
    control.answered_once = true;
    repeat_command();
}

/* Inputs at rest: of a rig with a stabiliser what that makes of the newest state, without which it would fall. */
void at_rest(double *found)
{
    if (control.stamp != 0 && !control.blind) {
        UNIT(at_rest)(&unit, found);
    } else {
        memcpy(found, rest, sizeof control.input);
    }
}

void output_show(void)
{
    double numbers[STATES + INPUTS];
    int i, k;

    if (!outlet_is_read(&plans)) {
        return;
    }
    for (i = 0; i < HORIZON; i++) {
        for (k = 0; k < STATES; k++) {
            numbers[k] = (double)unit.horizon_states[(i + 1) * STATES + k];
        }
        for (k = 0; k < INPUTS; k++) {
            numbers[STATES + k] = (double)unit.horizon_planned[i * INPUTS + k];
        }
        message_write(&plan, i, numbers);
    }
    message_publish(&plan, control.stamp + REACH, &plans.publisher);
}
