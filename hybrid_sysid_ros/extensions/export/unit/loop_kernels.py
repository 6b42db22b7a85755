"""A period of a loop as kernels: what estimator and controller do in Python around their compiled functions.

They are written in the subset that is translated to C, and numba never compiles them. An export compares them with
Python's classes, call by call.
"""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.control.cascade import ROUNDING
from hybrid_sysid_ros.control.mpc.linearisation import assign
from hybrid_sysid_ros.control.mpc.quadratic_program import clear_working_set, factorise
from hybrid_sysid_ros.control.mpc.shooting import prepare_program, shift
from hybrid_sysid_ros.estimation.belief import (
    numbers_at,
)
from hybrid_sysid_ros.extensions.export.unit.controller_kernels import control, supervise
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
    if loop.supervision is None:
        control(loop)
    else:
        supervise(loop, loop.supervision)


def stabilise(loop: PrintedLoop) -> None:
    """The command of the stabiliser below the controller, which plans once in each of its own periods."""
    progress, instance, gains = loop.progress[0], loop.instance, loop.gains
    m, n = gains.shape
    if progress.planned == 0 or progress.age > (1.0 - ROUNDING) * loop.settings.interval:
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
        prepare(loop, loop.settings.interval)


def prepare(loop: PrintedLoop, elapsed: float) -> None:
    """Shift the plan, and in real time linearise there."""
    progress, settings = loop.progress[0], loop.settings
    if loop.supervision is not None:
        progress.unplanned += elapsed
        if progress.unsolved != 0:
            _solve_meanwhile(loop)
    if progress.cold != 0:
        return
    shift(loop.prediction, loop.horizon, min(elapsed / settings.interval, 1.0))
    if settings.real_time:
        prepare_program(loop.prediction, loop.horizon, loop.program)
        progress.prepared = 1 if factorise(loop.program) else 0


def _solve_meanwhile(loop: PrintedLoop) -> None:
    """Let the exact MPC solve the instance that the policy has answered; the answer stays."""
    progress, answered, status = loop.progress[0], np.empty(loop.plan.shape[0]), loop.progress[0].status
    assign(answered, loop.plan)
    control(loop)
    assign(loop.plan, answered)
    progress.status, progress.unsolved = status, 0


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
    clear_working_set(loop.program)
    progress.cold, progress.prepared, progress.planned, progress.fresh = 1, 0, 0, 0
    if loop.supervision is not None:
        progress.unplanned, progress.unsolved = 0.0, 0
        progress.waiting = loop.supervision.patience if loop.supervision.steps else 0
        for i in range(loop.supervision.inputs.shape[0]):
            for j in range(loop.plan.shape[0]):
                loop.supervision.inputs[i, j] = math.nan
