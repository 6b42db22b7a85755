/* What the files of the controller share. */
#ifndef CONTROL_H
#define CONTROL_H

#include "reference.h"

#define value(which) value_of(&controller_node, which)

enum mode { DRIVE, HOLD, STOP }; /* what the services have asked for last */
enum loop_state { DRIVING, SLOWED, HOLDING, RESTING, STOPPED, DISARMED, STATES_OF_LOOP };
enum layer { EXACT, POLICY_LAYER, SHIFTED, HELD, ZEROED, RESTED, STOPPED_LAYER, NO_REFERENCE, LAYERS };
enum status { WAITING, SOLVED, ITERATED, NOT_CONVERGED, FAILED, POLICY, KEPT, BY_GUARD, STATUSES }; /* as the unit's */

typedef struct {
    enum mode mode;
    bool armed, emergency;
    char reason[WORDS]; /* why the loop may not move */
    enum loop_state state;
    int64_t stamp; /* of the newest estimate */
    int64_t sound; /* when an answer was sound last */
    int64_t acted; /* when a command was sent last */
    bool settled, returning;
    double home[OUTPUTS]; /* where the outputs were found, where a reference begins after rest */
    double input[INPUTS]; /* the newest command */
    bool answered_once;
    UNIT(command) newest;
    bool blind; /* nothing may be made of it */
    validator wishes;
    timing execution, age;
    long layers[LAYERS], statuses[STATUSES], times_in[STATES_OF_LOOP], clipped, past_end, repeated;
} controller_state;

extern controller_state control;

const char *operation_words(char *words); /* what to do to go on, "" where the loop drives */
void operation_begin(void);
bool operation_enable(char *words);
bool operation_hold(char *words);
bool operation_stop(char *words);
bool operation_arm(char *words);
bool operation_disarm(char *words);
bool operation_estop(char *words);
void operation_reset(void);
enum loop_state operated(enum loop_state level);
void become(enum loop_state next);
void stop_at_once(const char *why);
const char *doubt_in_words(void); /* why the guard allowed no more than it did last */
const char *unready(void); /* what is in the way of arming, or "" */

void output_begin(node *own);
bool output_open(node *own);
void output_open_commands(node *own);
void output_close(node *own);
bool output_is_open(void);
void output_show(void); /* the predicted trajectory, where somebody reads it */
void repeat_command(void);
void send_command(const double *inputs, bool limited);
void at_rest(double *found);
void rest_with(enum layer layer);
void hold_command(void);
void stop_moving(void);
bool is_long(void);
bool moves(void);
int64_t time_of_loop(void);

int controller_health(task *tasks);

#endif
