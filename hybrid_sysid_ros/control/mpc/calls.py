"""A call of the exact MPC as a kernel: its answer, how that was found, and what is left of the last plan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows, keep_hard
from hybrid_sysid_ros.control.mpc.quadratic_program import Program, clear_working_set, factorise
from hybrid_sysid_ros.control.mpc.sequential import ASSURED
from hybrid_sysid_ros.control.mpc.shooting import (
    CONVERGE,
    FEEDBACK,
    IMPROVE,
    UNCHECKED,
    answer,
    linearise_program,
    plan_within,
    restore_trajectory,
    shift_trajectory,
)
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array

SOLVED, ITERATED, NOT_CONVERGED, FAILED, POLICY, HELD = range(1, 7)
"""How an answer was found: see :class:`~hybrid_sysid_ros.control.controller.Status`."""

CALL = np.dtype([*((name, "i8") for name in ("cold", "way", "status", "iterations")), ("residual", "f8")])
"""The last call of an exact MPC: whether there is no plan, by which way the next call is answered in real time, how the
answer was found, by how many iterations, and its residual.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class MpcMemory(Shared):
    """An exact MPC, and what it remembers."""

    prediction: PredictionModel
    horizon: Horizon
    """Its ``planned`` inputs are the last answer."""
    program: Program
    call: NDArray[np.void]
    """(1,) of :data:`CALL`."""
    real_time: int
    """Whether a call makes one step."""
    checked: int
    """Whether the plan of such a step is simulated."""
    iterations: int
    """Most iterations of a call."""
    tolerance: float
    interval: float
    """Length of an interval of the horizon [s]."""


@inner
def forget_plan(mpc: MpcMemory) -> None:
    """Forget the last plan."""
    clear_working_set(mpc.program)
    call = mpc.call[0]
    call.cold, call.way = 1, CONVERGE
    mpc.horizon.progress[0].foreseen = 0


@inner
def solve_instance(mpc: MpcMemory, instance: Instance, iterations: int) -> None:
    """A call of the exact MPC."""
    solve_within(mpc, instance, iterations, True)


@inner
def solve_within(mpc: MpcMemory, instance: Instance, iterations: int, anew: bool) -> None:
    """Steps of a call, at most ``iterations``. anew: False goes on with the last call."""
    call = mpc.call[0]
    way = call.way if anew and mpc.real_time != 0 and call.cold == 0 else CONVERGE
    cold, before = anew and call.cold != 0, 0 if anew else call.iterations
    call.way = CONVERGE
    found = answer(mpc.prediction, mpc.horizon, mpc.program, instance, iterations, mpc.tolerance, cold, way, anew)
    call.iterations, call.residual = before + found.iterations, found.residual
    if found.iterations > 0:
        call.cold = 0
        call.status = SOLVED if found.solved else NOT_CONVERGED if way == CONVERGE else ITERATED
    else:
        call.status = FAILED
        plan_rest(mpc, instance)


@inner
def plan_rest(mpc: MpcMemory, instance: Instance) -> None:
    """Plan what is left of the last plan, or the previous inputs, and from there to the hard bounds of terms, as fast
    as the limits of rates allow: a bound may have dropped too fast for a solution.
    """
    horizon = mpc.horizon
    if mpc.call[0].cold != 0:
        hold(horizon, instance)
    else:
        plan_within(horizon, instance)
    if horizon.limits.hard.any():
        known = True
        for j in range(instance.previous.shape[0]):
            known = known and math.isfinite(instance.previous[j])
        if known:
            keep_hard(mpc.prediction, horizon, instance.previous, horizon.planned)
            if mpc.call[0].cold == 0:
                assign_rows(horizon.planned, horizon.inputs)


@inner
def prepare_mpc(mpc: MpcMemory, elapsed: float) -> None:
    """Shift the plan by the time until the next call [s], and in real time linearise there.

    Where the last steps did not cost what was predicted, the feedback phase of the next one would fail, too, and
    linearise again: then that call makes its step at once, from the state that it is given.
    """
    call = mpc.call[0]
    if call.cold != 0:
        return
    shift_trajectory(mpc.prediction, mpc.horizon, min(elapsed / mpc.interval, 1.0))
    if mpc.real_time != 0 and (mpc.checked == 0 or mpc.horizon.progress[0].foreseen >= ASSURED):
        linearise_plan(mpc)
    elif mpc.real_time != 0:
        call.way = IMPROVE


@inner
def shift_plan(mpc: MpcMemory) -> None:
    """Shift the last plan by an interval."""
    if mpc.call[0].cold == 0:
        shift_trajectory(mpc.prediction, mpc.horizon, 1.0)


@inner
def linearise_plan(mpc: MpcMemory) -> None:
    """Prepare the program around the last plan."""
    linearise_program(mpc.prediction, mpc.horizon, mpc.program)
    way = FEEDBACK if mpc.checked != 0 else UNCHECKED
    mpc.call[0].way = way if factorise(mpc.program) else CONVERGE


@inner
def adopt_plan(mpc: MpcMemory, disturbance: Array, inputs: Array, states: Array) -> None:
    """Take a plan as the last one: inputs (N, m), their states (N + 1, n), under a disturbance (m,)."""
    assign(mpc.horizon.disturbance, disturbance)
    assign_rows(inputs, mpc.horizon.inputs)
    assign_rows(states, mpc.horizon.states)
    call = mpc.call[0]
    call.cold, call.way = 0, CONVERGE


@inner
def hold(horizon: Horizon, instance: Instance) -> None:
    """Plan the previous inputs within their bounds; 0 or the nearest bound for what is no number."""
    limits = horizon.limits
    for i in range(horizon.planned.shape[0]):
        for j in range(horizon.planned.shape[1]):
            last = instance.previous[j] if math.isfinite(instance.previous[j]) else 0.0
            horizon.planned[i, j] = min(max(last, limits.low[j]), limits.high[j])


# ---------------------------------------------------------------------- for Python


@kernel
def forget_call(mpc: MpcMemory) -> None:
    """:func:`forget_plan` for Python."""
    forget_plan(mpc)


@kernel
def solve_call(mpc: MpcMemory, instance: Instance, iterations: int, anew: bool) -> int:
    """:func:`solve_within` for Python; the status."""
    solve_within(mpc, instance, iterations, anew)
    return mpc.call[0].status  # type: ignore[no-any-return]


@kernel
def give_up(mpc: MpcMemory, instance: Instance, cold: bool) -> None:
    """End a call without an answer. cold: there was no plan before it."""
    restore_trajectory(mpc.horizon, mpc.program)
    call = mpc.call[0]
    call.cold, call.status = 1 if cold else 0, FAILED
    plan_rest(mpc, instance)


@kernel
def adopt_call(mpc: MpcMemory, disturbance: Array, inputs: Array, states: Array) -> None:
    """:func:`adopt_plan` for Python."""
    adopt_plan(mpc, disturbance, inputs, states)


@kernel
def prepare_call(mpc: MpcMemory, elapsed: float) -> None:
    """:func:`prepare_mpc` for Python."""
    prepare_mpc(mpc, elapsed)


@kernel
def prepare_again(mpc: MpcMemory) -> None:
    """:func:`linearise_plan` for Python."""
    linearise_plan(mpc)
