"""The model with what else is unknown beside it: z = [x, d, s, c, theta], compiled.

    x+ = step(x, u + d + w; theta),  d+ = d,  (s, c)+ = rotation(w h) (s, c),  theta+ = theta

x is the model's state, d a disturbance of the input and w its white noise, s the hum in the sensor with its quadrature
c, theta the followed parameters. Everything but x moves by itself; the process noise makes it drift.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.adapters import kernels
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.rollout import stepped
from hybrid_sysid_ros.estimation.cholesky import factorise
from hybrid_sysid_ros.estimation.memory import LONGEST_STEP
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

SMALLEST = 1e-6
"""Change of a parameter or an input over which its effect is seen."""

ALIKE = 0.05
"""Share of a parameter's effect that an offset of the input may leave, where the two are taken for one: 1.6 % of the
shipped hybrid's centre, whose network reads the input as well; 16 % and more of its other parameters."""


@dataclass(frozen=True, kw_only=True)
class Augmented:
    """Compiled functions of one form of equation; core is a record of :func:`~.memory.core_type`.

    move(core, z, drive, h, following): one step of h [s] under the input ``drive``; ``following`` (size,) receives the
    new state, another array than z.
    linearise(core, z, covariance, drive, h, following, jacobian): the same for what lies about z as ``covariance``
    (size, size) says. ``following`` is the mean of that, ``jacobian`` (size, size) its slopes; core.push (size,)
    receives what a deviation of the input's noise adds, core.remainder (states, states) the covariance of what slopes
    leave out. Dry friction has corners that are narrower than what is uncertain: a derivative sees the beam stick or
    slip, a difference what lies between. So these are differences over the columns s of the covariance's root,

        slope = (f(z + r s) - f(z - r s)) / 2 r,  bend = (f(z + r s) - 2 f(z) + f(z - r s)) / r^2
        mean = f(z) + sum bend / 2,  covariance = sum slope slope' + sum bend bend' / 2

    where a normal e has E e^2 = 1 and var e^2 = 2. Source: the second-order divided-difference filter of Norgaard,
    Poulsen, Ravn (2000), Automatica 36(11), with the reach r of the unscented filter's points in place of sqrt(3): it
    sees the break-away of a beam that sticks.
    """

    move: Callable[..., None]
    linearise: Callable[..., None]


_COMPILED: dict[tuple[Any, ...], Augmented] = {}


def augmented(system: System) -> Augmented:
    """The functions of an equation's form, compiled once in a process."""
    key = system.form
    if key not in _COMPILED:
        _COMPILED[key] = _compile(system)
    return _COMPILED[key]


def _compile(system: System) -> Augmented:
    step = kernels(system).step
    states, weights = len(system.states), len(system.weights)

    @inner
    def move(core: Any, z: Array, drive: float, h: float, following: Array) -> None:
        for i in range(states + 3, z.shape[0]):
            core.numbers[core.followed[i - states - 3]] = min(max(z[i], core.low[i]), core.high[i])
            following[i] = z[i]
        core.drive[0] = drive + z[states]
        step(z[:states], core.drive, core.numbers, core.weights[:weights], h, following[:states])
        following[states] = z[states]
        cosine, sine = math.cos(core.turning * h), math.sin(core.turning * h)
        following[states + 1] = cosine * z[states + 1] + sine * z[states + 2]
        following[states + 2] = cosine * z[states + 2] - sine * z[states + 1]

    @inner
    def linearise(
        core: Any, z: Array, covariance: Array, drive: float, h: float, following: Array, jacobian: Array
    ) -> None:
        above, below, point, shift = core.points[0], core.points[1], core.points[2], core.points[3]
        factor, remainder, size = core.product, core.remainder, z.shape[0]
        reach = math.sqrt(1.0 + size)
        for i in range(size):
            shift[i] = 0.0
            for j in range(size):
                factor[i, j] = covariance[i, j]
                jacobian[i, j] = 1.0 if i == j else 0.0
                remainder[i, j] = 0.0
        factorise(factor)
        move(core, z, drive, h, following)
        for i in range(size + 1):  # the last one is the input's noise
            if i < size:
                for j in range(size):
                    point[j] = z[j] + reach * factor[j, i] if j >= i else z[j]
                move(core, point, drive, h, above)
                for j in range(i, size):
                    point[j] = z[j] - reach * factor[j, i]
                move(core, point, drive, h, below)
            else:
                force = reach * math.sqrt(core.input_noise / h)
                move(core, z, drive + force, h, above)
                move(core, z, drive - force, h, below)
            for j in range(states):
                slope, bend = (above[j] - below[j]) / (2.0 * reach), above[j] + below[j] - 2.0 * following[j]
                if i < size:
                    jacobian[j, i] = slope
                else:
                    core.push[j] = slope
                above[j] = bend / (reach * reach)
                shift[j] += 0.5 * above[j]
            for j in range(states):
                for k in range(states):
                    remainder[j, k] += 0.5 * above[j] * above[k]
        for j in range(states):
            following[j] += shift[j]
        for i in range(size - 1, -1, -1):  # from slopes over the columns of the factor to those over z
            for j in range(states):
                for k in range(i + 1, size):
                    jacobian[j, i] -= jacobian[j, k] * factor[k, i]
                jacobian[j, i] = jacobian[j, i] / factor[i, i] if factor[i, i] > 0.0 else 0.0
        cosine, sine = math.cos(core.turning * h), math.sin(core.turning * h)
        s, c = states + 1, states + 2
        jacobian[s, s], jacobian[s, c] = cosine, sine
        jacobian[c, s], jacobian[c, c] = -sine, cosine

    return Augmented(move=move, linearise=linearise)


def offset_gains(system: System, tuning: Tuning) -> Array | None:
    """For each followed parameter the input offset that does the same, per unit of it: (followed,), 0 where none does.

    None where no parameter is like an offset of the input. Raises UserError where one is and the disturbance is to be
    estimated as well: no measurement tells the two apart.
    """
    gains = np.zeros(len(tuning.followed))
    numbers = system.values
    names = [item.name for item in system.parameters]
    random = np.random.default_rng(0)
    samples = [(random.normal(size=len(system.states)), random.uniform(-5.0, 5.0, 1)) for _ in range(64)]

    def moved(values: Array, x: Array, u: Array) -> Array:
        return stepped(system.with_values(values), x, u, step=LONGEST_STEP)

    for k, name in enumerate(tuning.followed):
        index = names.index(name)
        other = numbers.copy()
        other[index] += SMALLEST
        by_input = [moved(numbers, x, u + SMALLEST) - moved(numbers, x, u) for x, u in samples]
        by_parameter = [moved(other, x, u) - moved(numbers, x, u) for x, u in samples]
        ratios = [b @ a / (a @ a) for a, b in zip(by_input, by_parameter, strict=True) if a @ a > 0.0]
        ratio = float(np.median(ratios)) if ratios else 0.0
        left = [np.linalg.norm(b - ratio * a) for a, b in zip(by_input, by_parameter, strict=True)]
        # Nearly everywhere: a difference across a corner of the law says nothing.
        if ratio and np.mean(np.array(left) <= ALIKE * np.linalg.norm(by_parameter, axis=1)) > 0.9:
            if tuning.disturbance_noise > 0.0:
                raise UserError(
                    f"parameter {name} can't be told from the input disturbance: set disturbance_noise to 0 to follow "
                    f"{name} in its place, or don't follow it"
                )
            gains[k] = ratio
    return gains if np.any(gains) else None
