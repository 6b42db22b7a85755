"""A period of a loop as kernels: estimator, stabiliser, and the controller's own kernels.

They are written in the subset that is translated to C, and numba never compiles them. An export compares them with
Python's classes, call by call.
"""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.control.cascade import ROUNDING
from hybrid_sysid_ros.control.mpc import calls
from hybrid_sysid_ros.control.mpc.calls import prepare_mpc, solve_instance
from hybrid_sysid_ros.control.mpc.linearisation import assign
from hybrid_sysid_ros.control.safety.supervision import answer_supervised, begin_supervision, prepare_supervised
from hybrid_sysid_ros.estimation.belief import numbers_at
from hybrid_sysid_ros.extensions.export.unit.estimator_kernels import estimate, show
from hybrid_sysid_ros.extensions.export.unit.printed_loop import WAITING, PrintedLoop


def observe(loop: PrintedLoop, time: float) -> bool:
    """The estimate of a measurement at ``time`` [s]; False while there is none."""
    core, out, instance, progress = loop.memory[0][0], loop.out, loop.instance, loop.progress[0]
    n, m = core.states, core.inputs
    if not estimate(loop, time):
        progress.status = WAITING
        return False
    for a in range(n):
        instance.state[a] = out[n + a]
    for j in range(m):
        instance.disturbance[j] = out[2 * n + j]
        for i in range(core.followed):
            deviation = out[2 * n + m + i] - loop.initial.parameters[i]
            instance.disturbance[j] += deviation * loop.initial.offsets[i, j]
    return True


def expect(loop: PrintedLoop) -> None:
    """The readings that the newest estimate expects, in place of those that came."""
    core, out = loop.memory[0][0], loop.out
    n, m, first = core.states, core.inputs, core.size - core.followed
    z, shown = np.zeros(core.size), np.zeros(core.outputs)
    for a in range(n):
        z[a] = out[a]
    for j in range(m):
        z[n + j] = out[2 * n + j]
    for i in range(core.followed):
        z[first + i] = out[2 * n + m + i]
    show(loop, z, shown)
    assign(loop.outputs, shown)


def decide(loop: PrintedLoop) -> None:
    """The command for the newest estimate."""
    assign(loop.instance.previous, loop.command)
    if loop.gains.shape[0] > 0:
        stabilise(loop)
    else:
        answer(loop)
        assign(loop.command, loop.plan)


def answer(loop: PrintedLoop) -> None:
    """The plan's first inputs, of the policy or of the exact MPC."""
    mpc = loop.mpc
    if loop.supervisor is None:
        solve_instance(mpc, loop.instance, mpc.iterations)
    else:
        answer_supervised(loop.supervisor, loop.instance, solve_instance, mpc.iterations)
    loop.progress[0].status = mpc.call[0].status
    assign(loop.plan, mpc.horizon.planned[0])


def stabilise(loop: PrintedLoop) -> None:
    """The command of the stabiliser below the controller, which plans once in each of its own periods."""
    progress, instance, gains = loop.progress[0], loop.instance, loop.gains
    m, n = gains.shape
    if progress.planned == 0 or progress.age > (1.0 - ROUNDING) * loop.mpc.interval:
        for j in range(m):
            if progress.planned == 0:
                for a in range(n):
                    instance.previous[j] += gains[j, a] * instance.state[a]
            else:
                instance.previous[j] = loop.plan[j]
        answer(loop)
        progress.planned, progress.fresh, progress.age = 1, 1, 0.0
    for j in range(m):
        u = 0.0
        for a in range(n):
            u += gains[j, a] * loop.out[n + a]
        u = loop.plan[j] - u
        loop.command[j] = min(max(0.0 if math.isnan(u) else u, loop.low[j]), loop.high[j])


def look_forward(loop: PrintedLoop, elapsed: float) -> None:
    """Prepare for the next period, ``elapsed`` [s] after this one."""
    progress = loop.progress[0]
    if loop.gains.shape[0] == 0:
        prepare(loop, elapsed)
        return
    progress.age += elapsed
    if progress.fresh != 0:
        progress.fresh = 0
        prepare(loop, loop.mpc.interval)


def prepare(loop: PrintedLoop, elapsed: float) -> None:
    """Shift the plan, and in real time linearise there."""
    if loop.supervisor is None:
        prepare_mpc(loop.mpc, elapsed)
    else:
        prepare_supervised(loop.supervisor, loop.instance, elapsed, solve_instance, loop.mpc.iterations)


def rebase(loop: PrintedLoop) -> float:
    """Count time, and the integrals of inputs, from the newest measurement on; return its time until now [s]."""
    progress = loop.progress[0]
    cores, _, moments, _, inputs = loop.memory
    by, last = progress.newest, inputs.shape[0] - 1
    for k in range(cores[0].count):
        moments[k].time -= by
    for i in range(inputs.shape[0]):
        inputs[i, 0] -= by
    for j in range(1, inputs.shape[1]):
        whole = inputs[last, j]
        for i in range(inputs.shape[0]):
            inputs[i, j] -= whole
    progress.newest = 0.0
    progress.last -= by
    return by


def forget_estimate(loop: PrintedLoop) -> None:
    """Forget the measurements."""
    progress, core = loop.progress[0], loop.memory[0][0]
    known = numbers_at(core.applied)
    for j in range(core.inputs):
        known[j] = 0.0
    progress.started, progress.last = 0, math.nan


def forget_plan(loop: PrintedLoop) -> None:
    """Forget the last plan; the last command holds."""
    progress = loop.progress[0]
    progress.planned, progress.fresh = 0, 0
    if loop.supervisor is None:
        calls.forget_plan(loop.mpc)
    else:
        begin_supervision(loop.supervisor)
