"""The nodes of time of an estimator, compiled: where measurements are put in their place, in whatever order they come.

core and nodes are records of :mod:`~hybrid_sysid_ros.estimation.memory`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.estimation.memory import NONE, UNUSED

Nodes = NDArray[np.void]

SAME = 1e-6
"""Stamps less than this apart [s] are one."""


@inner
def place(core: Any, nodes: Nodes, time: float, value: float, channel: int) -> int:
    """Give a measurement its node and return the index; ``channel`` NONE: a time to predict to, without one.

    Behind the newest node come as many nodes as the interval has steps. The beliefs from that index on are not those of
    the measurements any more. -1: it is older than all nodes, or there already.
    """
    newest = nodes[core.count - 1].time
    if time > newest + SAME:
        steps = max(1, math.ceil((time - newest) / core.step - core.slack))
        for k in range(1, steps):
            _put(nodes, _room(core, nodes), newest + (time - newest) * k / steps, 0.0, NONE)
        index = _room(core, nodes)
        _put(nodes, index, time, value, channel)
        return index
    index = core.count
    while index > 0 and nodes[index - 1].time > time + SAME:
        index -= 1
    k = index - 1  # the last node that is not newer; there may be more of this very time
    while k >= 0 and nodes[k].time >= time - SAME:
        if channel != NONE and nodes[k].channel == channel:
            return -1
        k -= 1
    if core.count == nodes.shape[0]:
        index -= _forget(core, nodes)
    if index < 1:
        return -1
    for k in range(core.count, index, -1):
        nodes[k] = nodes[k - 1]
    core.count += 1
    _put(nodes, index, max(time, nodes[index - 1].time), value, channel)
    return index


@inner
def after(core: Any, nodes: Nodes, time: float) -> int:
    """Index of the first node later than ``time``, 1 at least."""
    index = core.count
    while index > 1 and nodes[index - 1].time > time + SAME:
        index -= 1
    return index


@inner
def _room(core: Any, nodes: Nodes) -> int:
    """Index of a new last node."""
    if core.count == nodes.shape[0]:
        _forget(core, nodes)
    core.count += 1
    return core.count - 1


@inner
def _forget(core: Any, nodes: Nodes) -> int:
    """Keep the newest nodes only; return how many went."""
    gone = core.count - core.keep
    for k in range(core.keep):
        nodes[k] = nodes[gone + k]
    core.count = core.keep
    return gone


@inner
def _put(nodes: Nodes, index: int, time: float, value: float, channel: int) -> None:
    node = nodes[index]
    node.time, node.value, node.channel = time, value, channel
    node.fate = UNUSED
    node.innovation = node.normalised = math.nan
