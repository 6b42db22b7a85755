"""Initial values of a fit: magnitudes in the training data, and linear systems by regression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.core import System, simulate
from hybrid_sysid_ros.core.parameters import scale_of
from hybrid_sysid_ros.core.symbolic import symbolic_closures, symbolic_features
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.models.hybrid_system import CLIP, Hybrid, kind_of
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.models.region import Region
from hybrid_sysid_ros.models.structure import Magnitudes
from hybrid_sysid_ros.support.arrays import Array

FEATURE_SCALE = 1.5
"""Scale of a network's feature, in root mean squares of the training data."""

REGRESSED_SHARE = 0.3
"""Share of a rate's variance that a regression must explain to be used."""


def magnitudes(system: System, experiments: Sequence[PreparedRecord]) -> Magnitudes:
    """Magnitudes in experiments for a rig's system: FEATURE_SCALE root mean squares, since single large values must not
    set the scale of a network. Magnitudes of states that no record shows come from a simulation with the initial values
    of a fit.
    """
    states, held = _samples(system, experiments)
    inputs = np.concatenate([item.inputs for item in experiments])
    seen = symbolic_features(system)(states.T, held.T)
    squares = [np.mean(values**2, axis=0) for values in (states, inputs, np.array(seen).T)]
    return Magnitudes(
        scales=np.asarray(FEATURE_SCALE * np.sqrt(np.concatenate(squares[:2]))),
        features=np.asarray(FEATURE_SCALE * np.sqrt(squares[2])),
        centre=np.concatenate([states.mean(axis=0), inputs.mean(axis=0)]),
        unshown=tuple(system.states[i].name for i in _unshown(system)),
    )


def _unshown(system: System) -> list[int]:
    """Declared states that no record shows."""
    known = system.record_map().reconstructible
    return [i for i in range(len(system.declared_states)) if i not in known]


def _samples(system: System, experiments: Sequence[PreparedRecord]) -> tuple[Array, Array]:
    """Declared states (samples, states) and mean inputs over the samples (samples, inputs). States that no record shows
    come from a simulation with the initial values of a fit.
    """
    declared = len(system.declared_states)
    states = np.concatenate([item.states[:, :declared] for item in experiments])
    if hidden := _unshown(system):
        start = system.with_values([item.start for item in system.parameters])
        runs = [
            simulate(start, item.states[0], item.inputs, step=item.sampling.step, every=item.sampling.every)
            for item in experiments
        ]
        simulated = np.concatenate(runs)[:, hidden]
        usable = (
            np.isfinite(simulated).all(axis=0)
            & (np.abs(simulated).max(axis=0) < 1e6)
            & (np.ptp(simulated, axis=0) > 1e-9)
        )
        states[:, hidden] = np.where(usable, np.nan_to_num(simulated[: len(states)]), 1.0)
    return states, np.concatenate([_over_samples(item) for item in experiments])


def _over_samples(experiment: PreparedRecord) -> Array:
    """The mean input from each sample to the next, (samples, inputs), the last one twice."""
    means = experiment.inputs.reshape(experiment.samples - 1, experiment.sampling.every, -1).mean(axis=1)
    return np.concatenate([means, means[-1:]])


def initialised(system: Hybrid, experiments: Sequence[PreparedRecord], *, seed: int) -> Hybrid:
    """A hybrid with initial values from its training data.

    A hybrid on closures gets the scales of features and closures (their root mean squares; its earlier scales of
    closures are shares of these) and the region. A block that begins at data, such as rules, gets its weights.
    """
    kind, count = kind_of(system.block), system.block.features
    if system.region is None and not kind.from_data:
        return system
    states, held = _samples(system.physics, experiments)
    points = np.array(symbolic_features(system.physics)(states.T, held.T)).T
    if system.region is not None:
        values = np.array(symbolic_closures(system.physics)(states.T, held.T))
        names = [item.name for item in system.physics.closures]
        sizes = np.sqrt(np.mean(values[[names.index(name) for name in system.on]] ** 2, axis=1))
        scales = [*FEATURE_SCALE * np.sqrt(np.mean(points**2, axis=0)), *system.scales[count:] * sizes]
        system = replace(system, scales=tuple(map(scale_of, scales)))
    points = points / system.scales[:count]
    if system.region is None:
        points = np.clip(points, -CLIP, CLIP)
    else:
        system = replace(system, region=Region.of(points))
    return (
        replace(system, network_weights=kind.initial_weights(system.block, points, seed)) if kind.from_data else system
    )


def regression(system: Linear, experiments: Sequence[PreparedRecord]) -> dict[str, float]:
    """Entries of a linear system by least squares over one sample, by the trapezoidal rule.

        (x(k + 1) - x(k)) / T = A (x(k) + x(k + 1)) / 2 + B u(k) + c - F sgn v

    for each rate of a measured state on which no unmeasured state acts in the rig's law at its initial values.
    """
    origin, known = system.origin, {item.name: item for item in system.parameters}
    names = [item.name for item in origin.declared_states]
    shown = [i for i in range(len(names)) if i in origin.record_map().reconstructible]
    drives = [item.name for item in origin.inputs]
    period = experiments[0].sampling.period
    middle = np.concatenate([0.5 * (item.states[1:] + item.states[:-1]) for item in experiments])
    change = np.concatenate([np.diff(item.states, axis=0) / period for item in experiments])
    means = [item.inputs.reshape(item.samples - 1, item.sampling.every, -1).mean(axis=1) for item in experiments]
    inputs, found = np.concatenate(means), {}
    for i in shown:
        row = names[i]
        if i in origin.kinematics or any(
            abs(known[f"{row}_per_{name}"].start) > 0.0 for name in system.unshown if f"{row}_per_{name}" in known
        ):
            continue
        signed = [(f"{row}_per_{names[j]}", 1.0, middle[:, j]) for j in shown]
        signed += [(f"{row}_damping", -1.0, middle[:, i])]
        signed += [(f"{row}_per_{name}", 1.0, inputs[:, j]) for j, name in enumerate(drives)]
        signed += [(f"{row}_offset", 1.0, np.ones(len(middle))), (f"{row}_coulomb", -1.0, np.sign(middle[:, i]))]
        used = [(name, sign, column) for name, sign, column in signed if name in known]
        columns = np.stack([column for *_, column in used], axis=1)
        sizes = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
        solution = np.linalg.lstsq(columns / sizes, change[:, i], rcond=1e-6)[0] / sizes
        left = change[:, i] - columns @ solution
        if np.var(left) > (1.0 - REGRESSED_SHARE) * np.var(change[:, i]) or not np.isfinite(solution).all():
            continue
        found.update({name: sign * float(value) for (name, sign, _), value in zip(used, solution, strict=True)})
    return {name: value for name, value in found.items() if not (name.endswith("_coulomb") and value <= 0.0)}
