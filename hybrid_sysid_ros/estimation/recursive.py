"""What recursive filters share, compiled: a belief is carried from node to node, and replayed where time goes back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.estimation.augmented import Augmented, augmented
from hybrid_sysid_ros.estimation.history import Inputs
from hybrid_sysid_ros.estimation.kernels import (
    Channels,
    Kernels,
    assemble,
    beginning,
    clip,
    copy,
    drive_between,
    restart,
)
from hybrid_sysid_ros.estimation.memory import GATED, MAIN, NONE, UNUSED, USED
from hybrid_sysid_ros.estimation.nodes import Nodes, after, place

Array = NDArray[np.float64]


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


_COMPILED: dict[tuple[str, Augmented], Kernels] = {}


def recursive(system: System, method: str, carry: Callable[[System, Augmented], Belief]) -> Kernels:
    """The kernels of a recursive method and an equation's form, compiled once in a process."""
    parts = augmented(system)
    key = (method, parts)
    if key not in _COMPILED:
        _COMPILED[key] = _compile(system, parts, carry(system, parts))
    return _COMPILED[key]


def _compile(system: System, parts: Augmented, belief: Belief) -> Kernels:
    states = len(system.states)
    predict, observe, condense, spread = belief.predict, belief.observe, belief.condense, belief.spread

    @inner
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
                if node.outliers > core.patience:
                    restart(core, channels, node, states, spread)
            return
        if node.channel == MAIN:
            node.outliers = 0
        node.fate = USED
        for i in range(mean.shape[0]):
            mean[i] += core.column[i] / variance * node.innovation
        clip(core, mean)
        condense(core, node.root, channel.row, channel.hum, variance, channel.noise)

    @inner
    def advance(core: Any, channels: Channels, inputs: Inputs, before: Any, node: Any) -> None:
        """The belief at a node from that at the one before."""
        copy(before.mean, node.mean)
        for i in range(node.mean.shape[0]):
            copy(before.root[i], node.root[i])
        node.outliers, node.fate = before.outliers, UNUSED
        h = node.time - before.time
        if h > 0.0:
            predict(core, node.mean, node.root, drive_between(core, inputs, before, node), h)
        if node.channel != NONE:
            weigh(core, channels, node)

    @inner
    def put(
        core: Any,
        channels: Channels,
        nodes: Nodes,
        inputs: Inputs,
        time: float,
        value: float,
        channel: int,
        since: float,
    ) -> int:
        node = place(core, nodes, time, value, channel)
        if node >= 0:
            for k in range(min(after(core, nodes, since), node), core.count):
                advance(core, channels, inputs, nodes[k - 1], nodes[k])
        return node  # type: ignore[no-any-return]

    return assemble(
        system,
        move=parts.move,
        begin=beginning(system, spread),
        put=put,
        covariance=belief.covariance,
    )
