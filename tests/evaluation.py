"""Compiled functions called once from Python, for tests."""

import casadi
import numpy as np

from hybrid_sysid_ros.core import compiled, trace
from hybrid_sysid_ros.core.call import call_slopes
from hybrid_sysid_ros.core.compilation import kernel


@kernel
def _call(address, x, u, p, w, h, s, out, slopes):
    call_slopes(address, x, u, p, w, h, s, out, slopes)


def evaluated(system, x, u, step, *, output=False, smoothing=0.0, learn=False):
    """The step or the output map at x (states,), u (inputs,), and its slopes (rows, columns)."""
    address, columns = compiled(system).slopes(output=output, smooth=smoothing > 0.0, learn=learn)
    rows = len(system.outputs) if output else len(system.states)
    out, slopes = np.full(rows, np.nan), np.full((rows, columns.count), np.nan)
    given = np.array(x, dtype=float), np.array(u, dtype=float), system.values, system.weights
    _call(address, *given, step, smoothing, out, slopes)
    return out, slopes


def parametric_step(system, *, step, smoothing=0.0):
    """The CasADi form of a step as an expression of symbols x, u and p: (x, u, p, following)."""
    weights = casadi.SX(casadi.DM(system.weights))
    traced = trace.step_of(system, smooth=smoothing > 0.0, weights=weights)
    following = casadi.substitute([traced.result], [traced.h, traced.s], [casadi.SX(step), casadi.SX(smoothing)])[0]
    return traced.x, traced.u, traced.p, following
