"""The compiled code that estimators share: how they begin, put a measurement in its place, and answer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.estimation.history import Inputs, begin_history, mean_input, remember
from hybrid_sysid_ros.estimation.memory import MAIN, RESET
from hybrid_sysid_ros.estimation.nodes import Nodes

Array = NDArray[np.float64]
Channels = NDArray[np.void]

LATE, LOST = -1, -2
"""In place of a node: the measurement came too late; the numbers of the answer are not finite."""


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """Compiled functions of a method and a form of equation; they begin with the fields of a :class:`~.memory.Memory`.

    begin(..., time, value, applied): one node, at a measurement, nothing else known.
    absorb(..., time, value, channel, since, applied, lead, ahead, covariance): put a measurement in its place and
    replay from ``since`` [s] on; ``applied``: mean input from ``since`` to ``time``, NaN where the measurement tells
    none. Returns its node, LATE or LOST, and writes as answer() does.
    answer(..., lead, ahead, covariance): the state ``lead`` [s] after the newest node, and the covariance there.
    """

    begin: Callable[..., None]
    absorb: Callable[..., int]
    answer: Callable[..., None]


@inner
def copy(source: Array, target: Array) -> None:
    """Compiled in no time, as an assignment of slices is not."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@inner
def clip(core: Any, mean: Array) -> None:
    """Hold a state within its bounds."""
    for i in range(mean.shape[0]):
        mean[i] = min(max(mean[i], core.low[i]), core.high[i])


@inner
def drive_between(core: Any, inputs: Inputs, before: Any, node: Any) -> float:
    """Mean of the input that acts between two nodes, a delay after it was given."""
    start, stop = before.time - core.delay, node.time - core.delay
    return mean_input(inputs, start, stop) if stop > start else 0.0  # type: ignore[no-any-return]


@inner
def restart(core: Any, channels: Channels, node: Any, states: int, spread: Any) -> None:
    """After a run of outliers the measurement wins; what is slow is believed still."""
    for i in range(states):
        node.mean[i] = 0.0
    node.mean[states + 1] = node.mean[states + 2] = 0.0
    node.mean[channels[MAIN].row] = node.value
    spread(node.root, core.start)
    node.outliers, node.fate = 0, RESET


def beginning(system: System, spread: Callable[..., None]) -> Callable[..., None]:
    """See :class:`Kernels`, begin."""
    states = len(system.states)

    def begin(
        cores: Any, channels: Channels, nodes: Nodes, inputs: Inputs, time: float, value: float, applied: float
    ) -> None:
        core, node = cores[0], nodes[0]
        core.count = 1
        node.time, node.value, node.channel = time, value, MAIN
        node.outliers, node.fate = 0, RESET
        node.innovation = node.normalised = 0.0
        for i in range(node.mean.shape[0]):
            node.mean[i] = core.given[i - states - 3] if i >= states + 3 else 0.0
        node.mean[channels[MAIN].row] = value
        spread(node.root, core.start)
        begin_history(inputs, time, applied)

    return numba.njit(begin, **OPTIONS)  # type: ignore[no-any-return]


def _looking_ahead(system: System, move: Callable[..., None]) -> Callable[..., None]:
    """ahead(core, nodes, inputs, lead, out): the state later; every input that acts until then is known already."""
    states = len(system.states)

    @inner
    def ahead(core: Any, nodes: Nodes, inputs: Inputs, lead: float, out: Array) -> None:
        newest = nodes[core.count - 1]
        z, following = core.column, core.direction
        copy(newest.mean, z)
        steps = 0 if lead <= 0.0 else math.ceil(lead / core.step - core.slack)
        begin = newest.time - core.delay
        h = lead / steps if steps > 0 else 0.0
        for k in range(steps):
            drive = mean_input(inputs, begin + k * h, begin + (k + 1) * h)
            move(core, z, drive, h, following)
            copy(following, z)
        copy(z[:states], out)

    return ahead


def assemble(
    system: System,
    *,
    move: Callable[..., None],
    begin: Callable[..., None],
    put: Callable[..., int],
    covariance: Callable[..., None],
) -> Kernels:
    """The kernels of a method from its compiled parts.

    move: of :class:`~.augmented.Augmented`. begin: of :class:`Kernels`. put(core, channels, nodes, inputs, time, value,
    channel, since): put a measurement in its place and bring the beliefs up to date; its node or LATE.
    covariance(root, out): the covariance of a belief.
    """
    ahead_of = _looking_ahead(system, move)

    def answer(
        cores: Any, channels: Channels, nodes: Nodes, inputs: Inputs, lead: float, ahead: Array, out: Array
    ) -> None:
        core = cores[0]
        ahead_of(core, nodes, inputs, lead, ahead)
        covariance(nodes[core.count - 1].root, out)

    compiled_answer = numba.njit(answer, **OPTIONS)

    def absorb(
        cores: Any,
        channels: Channels,
        nodes: Nodes,
        inputs: Inputs,
        time: float,
        value: float,
        channel: int,
        since: float,
        applied: float,
        lead: float,
        ahead: Array,
        out: Array,
    ) -> int:
        if applied == applied:
            remember(inputs, time, applied)
        node = put(cores[0], channels, nodes, inputs, time, value, channel, since)
        compiled_answer(cores, channels, nodes, inputs, lead, ahead, out)
        return node if _finite(ahead) and _finite(out.ravel()) else LOST

    return Kernels(begin=begin, absorb=numba.njit(absorb, **OPTIONS), answer=compiled_answer)


@inner
def _finite(values: Array) -> bool:
    total = 0.0
    for value in values:
        total += 0.0 * value  # no zero where the value is infinite or no number
    return total == 0.0
