"""The inputs of the last moments, compiled: for models with an input delay, and for going back in time.

Kept as the integral of the input at the ends of its intervals, oldest first, so that a mean is one difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner

Inputs = NDArray[np.void]
"""Records of type :data:`~hybrid_sysid_ros.estimation.memory.INPUT`."""


@inner
def begin_history(inputs: Inputs, time: float, value: float) -> None:
    """The input has been ``value`` for ever, until ``time`` [s]."""
    length = inputs.shape[0]
    for i in range(length):
        back = length - 1 - i
        inputs[i].time = time - back
        inputs[i].integral = -back * value


@inner
def remember(inputs: Inputs, time: float, value: float) -> None:
    """From the last time to this one the input was ``value`` in the mean."""
    last = inputs.shape[0] - 1
    for i in range(last):
        inputs[i] = inputs[i + 1]
    inputs[last].integral += (time - inputs[last].time) * value
    inputs[last].time = time


@inner
def mean_input(inputs: Inputs, start: float, stop: float) -> float:
    """Mean input over [start, stop]; after the last known time the last value is held."""
    return (_integral(inputs, stop) - _integral(inputs, start)) / (stop - start)


@inner
def _integral(inputs: Inputs, time: float) -> float:
    right = inputs.shape[0] - 1
    while right > 1 and inputs[right - 1].time > time:  # most questions are about the newest ones
        right -= 1
    left, right = inputs[right - 1], inputs[right]
    share = (time - left.time) / (right.time - left.time)
    return left.integral + share * (right.integral - left.integral)
