"""The compiled code that recursive filters share: replay over the nodes, the innovation test, and what is answered."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.equations import Equation
from hybrid_sysid_ros.estimation.augmented import OPTIONS, Augmented, augmented
from hybrid_sysid_ros.estimation.history import Inputs, begin_history, mean_input, remember
from hybrid_sysid_ros.estimation.memory import GATED, MAIN, NONE, RESET, UNUSED, USED
from hybrid_sysid_ros.estimation.nodes import Nodes, after, place

Array = NDArray[np.float64]
Channels = NDArray[np.void]


@dataclass(frozen=True, kw_only=True)
class Belief:
    """How a method carries a mean and its covariance from node to node; compiled functions, all in place.

    ``root`` (size, size) is what the method keeps in place of the covariance: itself, or a square root of it.

    predict(core, mean, root, drive, h): one step. observe(core, root, row, hum): for a measurement of state ``row``
    (and of the hum, where ``hum`` is 1) write P h' into core.column and return h P h'. condense(core, root, row, hum,
    variance, noise): the root behind that measurement, ``variance`` being that of its innovation. spread(root,
    variances): the root of a diagonal covariance. covariance(root, out).
    """

    predict: Callable[..., None]
    observe: Callable[..., float]
    condense: Callable[..., None]
    spread: Callable[..., None]
    covariance: Callable[..., None]


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """Compiled functions of a method and a form of equation; they begin with the fields of a :class:`~.memory.Memory`.

    begin(..., time, value, applied): one node, at a measurement, nothing else known.
    absorb(..., time, value, channel, since, applied, lead, ahead, covariance): put a measurement in its place and
    replay from ``since`` [s] on; ``applied``: mean input from ``since`` to ``time``, NaN where the measurement tells
    none. Returns its node or -1, and writes as answer() does.
    answer(..., lead, ahead, covariance): the state ``lead`` [s] after the newest node, and the covariance there.
    """

    begin: Callable[..., None]
    absorb: Callable[..., int]
    answer: Callable[..., None]


@numba.njit(error_model="numpy", nogil=True)
def copy(source: Array, target: Array) -> None:
    """Compiled in no time, as an assignment of slices is not."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@numba.njit(error_model="numpy", nogil=True)
def clip(core: Any, mean: Array) -> None:
    """Hold a state within its bounds."""
    for i in range(mean.shape[0]):
        mean[i] = min(max(mean[i], core.low[i]), core.high[i])


def beginning(equation: Equation, spread: Callable[..., None]) -> Callable[..., None]:
    """See :class:`Kernels`, begin."""
    states = len(equation.states)

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


def looking_ahead(equation: Equation, move: Callable[..., None]) -> Callable[..., None]:
    """ahead(core, nodes, inputs, lead, out): the state later; every input that acts until then is known already."""
    states = len(equation.states)

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

    return numba.njit(ahead, **OPTIONS)  # type: ignore[no-any-return]


_COMPILED: dict[tuple[Any, ...], Kernels] = {}


def recursive(equation: Equation, method: str, carry: Callable[[Equation, Augmented], Belief]) -> Kernels:
    """The kernels of a recursive method and an equation's form, compiled once in a process."""
    key = (method, *equation.form)
    if key not in _COMPILED:
        parts = augmented(equation)
        _COMPILED[key] = _compile(equation, parts, carry(equation, parts))
    return _COMPILED[key]


def _compile(equation: Equation, parts: Augmented, belief: Belief) -> Kernels:
    states = len(equation.states)
    predict, observe, condense, spread = belief.predict, belief.observe, belief.condense, belief.spread
    covariance_of = belief.covariance
    ahead_of = looking_ahead(equation, parts.move)

    def weigh(core: Any, channels: Channels, node: Any) -> None:
        """Use a node's measurement, or don't."""
        channel = channels[node.channel]
        variance = observe(core, node.root, channel.row, channel.hum) + channel.noise
        mean = node.mean
        node.innovation = node.value - mean[channel.row] - channel.hum * mean[states + 1]
        node.normalised = node.innovation * node.innovation / variance
        if not node.normalised <= core.gate:
            node.fate = GATED
            if node.channel == MAIN:
                node.outliers += 1
                if node.outliers > core.patience:  # the measurement wins; what is slow is believed still
                    for i in range(states):
                        mean[i] = 0.0
                    mean[states + 1] = mean[states + 2] = 0.0
                    mean[channel.row] = node.value
                    spread(node.root, core.start)
                    node.outliers, node.fate = 0, RESET
            return
        if node.channel == MAIN:
            node.outliers = 0
        node.fate = USED
        for i in range(mean.shape[0]):
            mean[i] += core.column[i] / variance * node.innovation
        clip(core, mean)
        condense(core, node.root, channel.row, channel.hum, variance, channel.noise)

    compiled_weigh = numba.njit(weigh, **OPTIONS)

    def advance(core: Any, channels: Channels, inputs: Inputs, before: Any, node: Any) -> None:
        """The belief at a node from that at the one before."""
        copy(before.mean, node.mean)
        for i in range(node.mean.shape[0]):
            copy(before.root[i], node.root[i])
        node.outliers, node.fate = before.outliers, UNUSED
        h = node.time - before.time
        if h > 0.0:
            start = before.time - core.delay
            predict(core, node.mean, node.root, mean_input(inputs, start, start + h), h)
        if node.channel != NONE:
            compiled_weigh(core, channels, node)

    compiled_advance = numba.njit(advance, **OPTIONS)

    def answer(
        cores: Any, channels: Channels, nodes: Nodes, inputs: Inputs, lead: float, ahead: Array, covariance: Array
    ) -> None:
        core = cores[0]
        ahead_of(core, nodes, inputs, lead, ahead)
        covariance_of(nodes[core.count - 1].root, covariance)

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
        covariance: Array,
    ) -> int:
        core = cores[0]
        node = place(core, nodes, time, value, channel)
        if applied == applied:
            remember(inputs, time, applied)
        if node >= 0:
            for k in range(min(after(core, nodes, since), node), core.count):
                compiled_advance(core, channels, inputs, nodes[k - 1], nodes[k])
        compiled_answer(cores, channels, nodes, inputs, lead, ahead, covariance)
        return node

    return Kernels(
        begin=beginning(equation, spread),
        absorb=numba.njit(absorb, **OPTIONS),
        answer=compiled_answer,
    )
