"""Observability: states that no sensor shows, and parameters that act like an offset of an input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Recurrence, System, rollouts
from hybrid_sysid_ros.core.rollout import one_step
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RUNS, STEPS = 6, 80
"""Number of free runs from random states, and their steps, in which a state must have an effect."""

UNSEEN = 1e-8
"""Share of the strongest direction's effect below which a direction counts as unobservable."""

LASTING = 0.999
"""Share of an unobservable deviation that may be left after a run."""

SMALLEST = 1e-6
"""Change of a parameter or an input for computing its effect."""

ALIKE = 0.05
"""Largest share of a parameter's effect that an offset of the input can't reproduce, for both to count as the same: it
is 1.6 % for the shipped hybrid's centre, whose network reads the input too, and 16 % or more for other parameters."""

BLIND = 1e15
"""Factor on the deviation of a sensor's noise that makes it tell nothing."""


def check_observable(system: System, tuning: Tuning, *, step: float) -> None:
    """Raise UserError where a state or an input's offset neither affects measurements nor decays by itself.

    The empirical observability Gramian (Krener, Ide 2009, IEEE CDC, eq. 8): free runs from either side of random states
    under random inputs, so that contacts slide. Deflections of bristles, which decay when they slide, and states of a
    recurrence, which are its memory, are not examined. tuning: the result of :meth:`~.tuning.Tuning.checked`.
    """
    if isinstance(system, Recurrence):
        return
    n, m, size = len(system.declared_states), len(system.inputs), len(system.states)
    offsets = [j for j in range(m) if tuning.disturbance_noise[j] > 0.0]
    count, random = n + len(offsets), np.random.default_rng(0)
    scales = np.array([value or 1e-3 for value in (*tuning.initial_deviation[:n], *(1.0 for _ in offsets))])
    moves = scales[:, None] * np.eye(count)
    x0 = np.zeros((count, 2, RUNS, size))
    x0[..., :n] = random.normal(size=(RUNS, n))
    inputs = np.zeros((count, 2, RUNS, STEPS, m)) + random.uniform(-5.0, 5.0, (RUNS, STEPS, m))
    for side, sign in enumerate((1.0, -1.0)):
        x0[:, side, :, :n] += sign * moves[:, None, :n]
        inputs[:, side, :, :, offsets] += sign * moves[:, n:].T[:, :, None, None]
    rows = np.arange(count * 2 * RUNS) * STEPS
    starts = np.column_stack([rows, rows, np.full_like(rows, STEPS), rows])
    states, outputs = rollouts(system, starts, x0.reshape(-1, size), inputs.reshape(-1, m), step=step)

    def effects(values: Array) -> Array:
        """Half the difference of the two sides, (moves, runs, steps, columns)."""
        sides = values.reshape(count, 2, RUNS, STEPS, -1)
        with np.errstate(invalid="ignore"):  # some laws diverge
            return np.asarray(0.5 * (sides[:, 0] - sides[:, 1]))

    seen = effects(np.column_stack([outputs, *_further(system, tuning, states, outputs)]))
    ends = effects(states)[:, :, -1, :n] / scales[:n]
    finite = np.all(np.isfinite(seen), axis=(0, 2, 3)) & np.all(np.isfinite(ends), axis=(0, 2))
    if not np.any(finite):
        return  # every run overflowed: nothing can be decided
    noise = np.array([*tuning.measurement_noise, *(channel.noise for channel in tuning.channels.values())])
    weighted = (seen[:, finite] / noise).reshape(count, -1)
    sizes = np.linalg.norm(weighted, axis=1)
    sizes[sizes == 0.0] = 1.0
    directions, strengths, _ = np.linalg.svd(weighted / sizes[:, None], full_matrices=False)
    hidden = directions[:, strengths <= UNSEEN * strengths[0]] / sizes[:, None]
    if not hidden.size:
        return
    hidden, _ = np.linalg.qr(hidden)
    stay = np.broadcast_to(np.eye(count)[:, None, n:], (count, int(finite.sum()), count - n))  # an offset is constant
    left = np.concatenate([ends[:, finite], stay], axis=2).reshape(count, -1).T / np.sqrt(finite.sum())
    _, lasting, mixed = np.linalg.svd(left @ hidden, full_matrices=False)
    if lasting[0] >= LASTING:
        worst = int(np.argmax(np.abs(hidden @ mixed[0])))
        shown = ", ".join([*(item.name for item in system.outputs), *tuning.channels])
        kind = type(system).__name__
        if worst < n:
            name = system.declared_states[worst].name
            raise UserError(f"{kind}: state {name} can't be told from {shown}: measure it too, or leave it out")
        name = system.inputs[offsets[worst - n]].name
        raise UserError(f"{kind}: an offset of input {name} can't be told from {shown}: set its disturbance_noise to 0")


def _further(system: System, tuning: Tuning, states: Array, outputs: Array) -> list[Array]:
    """Readings of the tuning's channels."""
    names, shown = [item.name for item in system.states], [item.name for item in system.outputs]
    return [
        outputs[:, shown.index(channel.of)] if channel.of in shown else states[:, names.index(channel.of)]
        for channel in tuning.channels.values()
    ]


def offset_gains(system: System, tuning: Tuning, *, step: float) -> Array | None:
    """For each followed parameter the equivalent offset of the inputs per unit, (followed, inputs); 0: none.

    None where no parameter is equivalent to an offset of the inputs. Raises UserError where one is and that offset is
    estimated as well, since no measurement can distinguish them.
    """
    m = len(system.inputs)
    gains = np.zeros((len(tuning.followed), m))
    values, names = system.values, [item.name for item in system.parameters]
    random = np.random.default_rng(0)
    samples = [(random.normal(size=len(system.states)), random.uniform(-5.0, 5.0, m)) for _ in range(64)]

    def moved(at: Array, x: Array, u: Array) -> Array:
        return one_step(system.with_values(at), x, u, step=step)

    for k, name in enumerate(tuning.followed):
        other = values.copy()
        other[names.index(name)] += SMALLEST
        by_parameter = [moved(other, x, u) - moved(values, x, u) for x, u in samples]
        by_input = [
            np.column_stack([moved(values, x, u + SMALLEST * one) - moved(values, x, u) for one in np.eye(m)])
            for x, u in samples
        ]
        found = [np.linalg.lstsq(a, b, rcond=None)[0] for a, b in zip(by_input, by_parameter, strict=True) if np.any(a)]
        gain = np.median(found, axis=0) if found else np.zeros(m)
        left = [np.linalg.norm(b - a @ gain) for a, b in zip(by_input, by_parameter, strict=True)]
        # A difference across a corner of the law is meaningless, so nearly all must agree.
        alike = np.array(left) <= ALIKE * np.linalg.norm(by_parameter, axis=1)
        if np.any(gain) and np.mean(alike) > 0.9:
            gain[np.abs(gain) < 1e-6 * np.max(np.abs(gain))] = 0.0
            for j, item in enumerate(system.inputs):
                if gain[j] and tuning.disturbance_noise[j] > 0.0:
                    raise UserError(
                        f"parameter {name} can't be distinguished from an offset of input {item.name}: set its "
                        f"disturbance_noise to 0 to follow {name} in its place, or don't follow it"
                    )
            gains[k] = gain
    return gains if np.any(gains) else None


def spare_sensors(system: System, tuning: Tuning, *, step: float) -> NDArray[np.bool_]:
    """Which outputs (outputs,) can be left out because the others tell the state without them."""
    tuning = tuning.checked(system)
    noise = tuning.measurement_noise

    def is_spare(k: int) -> bool:
        if len(noise) + len(tuning.channels) == 1:
            return False
        without = tuple(BLIND * value if j == k else value for j, value in enumerate(noise))
        try:
            check_observable(system, replace(tuning, measurement_noise=without), step=step)
        except UserError:
            return False
        return True

    return np.array([is_spare(k) for k in range(len(noise))])
