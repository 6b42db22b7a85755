/* What DAQP can do and no loop needs: it could eliminate equalities before it solves a program, in 11 kB. Generated; do
 * not edit.
 */
#include "eq_elim.h"

int __wrap_daqp_eq_update(DAQPWorkspace *work, DAQPProblem *problem, int mask,
                          int (*update)(int, DAQPWorkspace *, DAQPProblem *));

/* In place of DAQP's own, by the linker: there is nothing to eliminate, and the whole program is solved. */
int __wrap_daqp_eq_update(DAQPWorkspace *work, DAQPProblem *problem, int mask,
                          int (*update)(int, DAQPWorkspace *, DAQPProblem *))
{
    (void)work;
    (void)problem;
    (void)mask;
    (void)update;
    return DAQP_EQ_NOT_REDUCED;
}
