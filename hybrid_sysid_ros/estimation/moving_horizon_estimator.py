"""Moving-horizon estimation by Gauss-Newton."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.estimation.augmented import Augmented, augmented
from hybrid_sysid_ros.estimation.cholesky import factorise, solve_factorised
from hybrid_sysid_ros.estimation.extended_kalman_filter import copied, covariance_belief, diagonal, propagate
from hybrid_sysid_ros.estimation.filter import Filter
from hybrid_sysid_ros.estimation.history import Inputs
from hybrid_sysid_ros.estimation.kernels import (
    LATE,
    Channels,
    Kernels,
    assemble,
    beginning,
    clip,
    copy,
    drive_between,
    restart,
)
from hybrid_sysid_ros.estimation.memory import GATED, MAIN, NONE, RESET, USED
from hybrid_sysid_ros.estimation.nodes import SAME, Nodes, place
from hybrid_sysid_ros.estimation.tuning import Tuning

Array = NDArray[np.float64]

ITERATIONS = 2
"""Gauss-Newton steps for a measurement: the window before is the start, and a third changes nothing."""


class MovingHorizonEstimator(Filter):
    """The trajectory z_0 ... z_N over the last measurements that costs least.

        |z_0 - prior|^2_P0 + sum |z_k+1 - f(z_k, u_k)|^2_(Q dt) + sum |y_k - H z_k|^2_R,   |e|^2_M = e' M^-1 e

    See :class:`~.filter.Filter` for the rest. Each Gauss-Newton step is one pass of a Kalman filter forwards and one of
    a smoother backwards over the problem linearised about the trajectory, so that it costs as much as N updates. Steps
    are taken whole: their slopes are differences over what is uncertain, which the cost's own corners would stall. The
    arrival cost (prior, P0) of a node is what the filter's pass predicted there, from measurements that have left the
    window. A measurement out of order is put in its place within the window.

    Source: Rao, Rawlings, Mayne (2003), IEEE TAC 48(2), with the filtering update of the arrival cost; the passes: Bell
    (1994), SIAM J. Optim. 4(3), and Rauch, Tung, Striebel (1965).
    """

    windowed = True

    def kernels(self, system: System) -> Kernels:
        return _kernels(system)

    def window_of(self, tuning: Tuning, period: float) -> float:
        return tuning.horizon * period


_COMPILED: dict[Augmented, Kernels] = {}


def _kernels(system: System) -> Kernels:
    parts = augmented(system)
    if parts not in _COMPILED:
        _COMPILED[parts] = _compile(system, parts)
    return _COMPILED[parts]


def _compile(system: System, parts: Augmented) -> Kernels:
    move = parts.move
    begin_at = beginning(system, diagonal)
    forward = _forward(system, parts)

    def begin(
        cores: Any, channels: Channels, nodes: Nodes, inputs: Inputs, time: float, value: float, applied: float
    ) -> None:
        begin_at(cores, channels, nodes, inputs, time, value, applied)
        _as_prior(nodes[0])

    @inner
    def solve(core: Any, channels: Channels, nodes: Nodes, inputs: Inputs, first: int) -> None:
        """Gauss-Newton over the nodes from ``first`` on; their means are where it starts, and what it finds."""
        for iteration in range(ITERATIONS):
            forward(core, channels, nodes, inputs, first, iteration == 0)
            if nodes[core.count - 1].fate == RESET:
                return
            _backward(core, nodes, first)

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
        newest = nodes[core.count - 1].time
        oldest = nodes[_since(core, nodes, newest - core.span)].time
        if time <= oldest + SAME:
            return LATE
        node = place(core, nodes, time, value, channel)
        if node < 0:
            return LATE
        new = node
        while new > 1 and nodes[new - 1].time > newest:  # an interval of several steps
            new -= 1
        for k in range(new, node + 1):
            _guess(core, inputs, nodes[k - 1], nodes[k], move)
        solve(core, channels, nodes, inputs, _since(core, nodes, oldest))
        last = core.count - 1
        if nodes[last].fate == RESET and last > 0:
            _as_prior(nodes[last])
            nodes[0] = nodes[last]
            core.count, node = 1, 0
        return node  # type: ignore[no-any-return]

    return assemble(system, move=move, begin=numba.njit(begin, **OPTIONS), put=put, covariance=copied)


@inner
def _since(core: Any, nodes: Nodes, time: float) -> int:
    """Index of the first node that is not older."""
    index = core.count - 1
    while index > 0 and nodes[index - 1].time >= time - SAME:
        index -= 1
    return index


@inner
def _as_prior(node: Any) -> None:
    """Nothing is known of a node but its belief."""
    copy(node.mean, node.predicted)
    copied(node.root, node.predicted_covariance)


@inner
def _backward(core: Any, nodes: Nodes, first: int) -> None:
    """The smoother's means: s_k = z_k + P_k F' M^-1 (s_k+1 - m); z_k, P_k filtered, m, M predicted for k + 1."""
    last, difference, pulled = core.count - 1, core.column, core.direction
    copy(nodes[last].filtered, nodes[last].mean)
    for k in range(last - 1, first - 1, -1):
        node, following = nodes[k], nodes[k + 1]
        for i in range(difference.shape[0]):
            difference[i] = following.mean[i] - following.predicted[i]
        copied(following.predicted_covariance, core.product)
        factorise(core.product)
        solve_factorised(core.product, difference)
        for i in range(difference.shape[0]):
            pulled[i] = 0.0
            for j in range(difference.shape[0]):
                pulled[i] += following.transition[j, i] * difference[j]
        for i in range(difference.shape[0]):
            node.mean[i] = node.filtered[i]
            for j in range(difference.shape[0]):
                node.mean[i] += node.root[i, j] * pulled[j]
    for k in range(first, core.count):
        clip(core, nodes[k].mean)


@inner
def _guess(core: Any, inputs: Inputs, before: Any, node: Any, move: Any) -> None:
    """A new node's first trajectory: where the model leads to."""
    if node.time > before.time:
        move(core, before.mean, drive_between(core, inputs, before, node), node.time - before.time, node.mean)
    else:
        copy(before.mean, node.mean)


def _forward(system: System, parts: Augmented) -> Callable[..., None]:
    """A Kalman filter over the problem linearised about the trajectory, from the first node's prior on."""
    linearise, belief = parts.linearise, covariance_belief(system, parts)
    observe, condense = belief.observe, belief.condense
    states = len(system.states)

    @inner
    def weigh(core: Any, channels: Channels, node: Any, judge: bool) -> None:
        """Use a node's measurement; judge: decide first whether to believe it."""
        channel = channels[node.channel]
        variance = observe(core, node.root, channel.row, channel.hum) + channel.noise
        innovation = node.value - node.filtered[channel.row] - channel.hum * node.filtered[states + 1]
        if judge:
            node.innovation, node.normalised = innovation, innovation * innovation / variance
            node.fate = USED if node.normalised <= core.gate else GATED
            if node.channel == MAIN:
                node.outliers = 0 if node.fate == USED else node.outliers + 1
        if node.fate != USED:
            return
        for i in range(node.filtered.shape[0]):
            node.filtered[i] += core.column[i] / variance * innovation
        condense(core, node.root, channel.row, channel.hum, variance, channel.noise)

    @inner
    def forward(core: Any, channels: Channels, nodes: Nodes, inputs: Inputs, first: int, judge: bool) -> None:
        for k in range(first, core.count):
            node = nodes[k]
            if k > first:
                before = nodes[k - 1]
                h = node.time - before.time
                if h > 0.0:
                    drive = drive_between(core, inputs, before, node)
                    linearise(core, before.mean, before.root, drive, h, node.predicted, node.transition)
                else:
                    copy(before.mean, node.predicted)
                    for i in range(node.mean.shape[0]):
                        for j in range(node.mean.shape[0]):
                            node.transition[i, j] = 1.0 if i == j else 0.0
                for i in range(node.mean.shape[0]):
                    for j in range(node.mean.shape[0]):
                        node.predicted[i] += node.transition[i, j] * (before.filtered[j] - before.mean[j])
                copied(before.root, node.predicted_covariance)
                propagate(core, node.predicted_covariance, node.transition, h, states)
                if judge:
                    node.outliers = before.outliers
            copy(node.predicted, node.filtered)
            copied(node.predicted_covariance, node.root)
            if node.channel != NONE and node.fate != RESET:
                weigh(core, channels, node, judge and k > first)
        node = nodes[core.count - 1]
        if node.outliers > core.patience and node.channel == MAIN and core.count - 1 > first:
            copy(node.filtered, node.mean)
            restart(core, channels, node, states, diagonal)
            clip(core, node.mean)

    return forward
