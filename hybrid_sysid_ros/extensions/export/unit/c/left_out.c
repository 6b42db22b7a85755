/* In place of what DAQP can do and no loop needs, 48 kB: to eliminate equalities, which is asked for and finds nothing;
 * integers, hierarchies and variational inequalities, for which nothing asks. Generated; do not edit.
 */
#include "api.h"
#include "avi.h"
#include "bnb.h"
#include "constants.h"
#include "eq_elim.h"
#include "hierarchical.h"
#include "presolve.h"

int daqp_eq_wanted(const DAQPWorkspace *work, const DAQPProblem *qp, const int mask)
{
    (void)work, (void)qp, (void)mask;
    return 0;
}

int daqp_eq_update(
    DAQPWorkspace *work, DAQPProblem *qp, int mask, int (*update_ldp)(int, DAQPWorkspace *, DAQPProblem *))
{
    (void)work, (void)qp, (void)mask, (void)update_ldp;
    return DAQP_EQ_NOT_REDUCED;
}

int daqp_eq_install(DAQPWorkspace *work)
{
    (void)work;
    return 0;
}

void daqp_eq_restore(DAQPWorkspace *work)
{
    (void)work;
}

void daqp_eq_deactivate(DAQPWorkspace *work)
{
    (void)work;
}

void daqp_eq_expand(DAQPResult *result, DAQPWorkspace *work)
{
    (void)result, (void)work;
}

void daqp_eq_set_primal_start(DAQPWorkspace *work, const c_float *x)
{
    (void)work, (void)x;
}

void free_daqp_eq(DAQPWorkspace *work)
{
    (void)work;
}

DAQPProblem *daqp_presolve(DAQPWorkspace *work, DAQPProblem *qp)
{
    (void)work;
    return qp;
}

int daqp_bnb(DAQPWorkspace *work)
{
    (void)work;
    return DAQP_EXIT_NONCONVEX;
}

int daqp_bnb_lb(DAQPWorkspace *work, const c_float lb)
{
    (void)work, (void)lb;
    return DAQP_EXIT_NONCONVEX;
}

int daqp_hiqp(DAQPWorkspace *work, c_float *lambda)
{
    (void)work, (void)lambda;
    return DAQP_EXIT_NONCONVEX;
}

int daqp_solve_avi(DAQPWorkspace *work)
{
    (void)work;
    return DAQP_EXIT_NONCONVEX;
}
