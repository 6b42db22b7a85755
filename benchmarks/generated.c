/* acados' generated solver of @name asked what a loop was asked: the numbers of the periods come by standard input. */
#include "acados_solver_@name.h"
#include "acados_c/ocp_nlp_interface.h"

#include <malloc.h>
#include <stdio.h>
#include <stdlib.h>

enum { FEEDBACK = 2, PREPARATION = 1, BOTH = 0 };

static double number(void)
{
    double value;

    if (scanf("%lf", &value) != 1) {
        exit(1);
    }
    return value;
}

static void follow(@{name}_solver_capsule *solver)
{
    double y[3] = {0.0};
    int i;

    for (i = 1; i <= @horizon; i++) {
        y[0] = number();
        ocp_nlp_cost_model_set(@{name}_acados_get_nlp_config(solver), @{name}_acados_get_nlp_dims(solver),
                               @{name}_acados_get_nlp_in(solver), i, "yref", y);
    }
}

int period(@{name}_solver_capsule *solver, int phase) /* what is counted */
{
    ocp_nlp_solver_opts_set(@{name}_acados_get_nlp_config(solver), @{name}_acados_get_nlp_opts(solver), "rti_phase",
                            &phase);
    return @{name}_acados_solve(solver);
}

int main(void)
{
    const size_t before = mallinfo2().uordblks;
    @{name}_solver_capsule *solver = @{name}_acados_create_capsule();
    const int periods = (int)number();
    int i, k;

    if (@{name}_acados_create(solver)) {
        return 1;
    }
    fprintf(stderr, "%zu\n", mallinfo2().uordblks - before);
    {
        ocp_nlp_config *config = @{name}_acados_get_nlp_config(solver);
        ocp_nlp_dims *dims = @{name}_acados_get_nlp_dims(solver);
        ocp_nlp_in *in = @{name}_acados_get_nlp_in(solver);
        ocp_nlp_out *out = @{name}_acados_get_nlp_out(solver);

        follow(solver);
        for (k = 0; k < periods; k++) {
            double x[@states], u;

            for (i = 0; i < @states; i++) {
                x[i] = number();
            }
            for (i = 0; i <= @horizon && k == 0; i++) {
                ocp_nlp_out_set(config, dims, out, in, i, "x", x);
            }
            ocp_nlp_constraints_model_set(config, dims, in, out, 0, "lbx", x);
            ocp_nlp_constraints_model_set(config, dims, in, out, 0, "ubx", x);
            if (period(solver, k ? FEEDBACK : BOTH)) {
                return 1;
            }
            ocp_nlp_out_get(config, dims, out, 0, "u", &u);
            printf("%.17g\n", u);
            if (k < periods - 1) {
                follow(solver); /* it reads the reference when it prepares */
            }
            period(solver, PREPARATION);
        }
    }
    return 0;
}
