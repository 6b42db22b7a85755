"""Identification of a state-space model: its order, a subspace start, and the refinement."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.core.parameters import scale_of
from hybrid_sysid_ros.extensions.state_space import subspace
from hybrid_sysid_ros.extensions.state_space.order_selection import Selection, comparable, rows_for, select_order
from hybrid_sysid_ros.extensions.state_space.periods import spectrum_of
from hybrid_sysid_ros.extensions.state_space.refinement import (
    Refined,
    acting,
    calm,
    linear_radius,
    refine,
    shrunk,
    unit_states,
    weights_of,
    without_last,
)
from hybrid_sysid_ros.extensions.state_space.state_space import RIDGE, StateSpace
from hybrid_sysid_ros.extensions.state_space.tangents import Sizes
from hybrid_sysid_ros.identification.validation.scores import score_free_run
from hybrid_sysid_ros.models.fit import Fit, PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.threads import alone

UNSTABLE_GAIN = 0.1
"""Share of the squared error by which an unstable model has to be better than the best that is not: noise takes an
integrator for a pole on either side of the circle.
"""
WORSE = 1.1
"""Ratio of what free runs miss to what the fit misses from which lower orders are tried: states at the beginning then
explain what inputs do not, as a mode that hardly decays does by going on through the whole record.
"""
Progress = Callable[[str, int, float], None]


@dataclass(frozen=True, kw_only=True)
class StateSpaceSettings:
    """What a user may choose."""

    order: int = 0
    """0: by held-out blocks."""
    highest: int = 10
    """Highest order that is compared."""
    through: bool | None = None
    """Whether an input acts on the outputs at once; None: held-out blocks decide."""
    units: int = 0
    power: int = 0
    ridge: float = RIDGE
    """Weight of the squared weights of units, relative to the sum of squared outputs."""
    starts: int = 3
    """Random beginnings of the units, of which the best fit stays."""
    dead: tuple[int, ...] = ()
    """Samples by which each input may act later, (inputs,): taken if held-out blocks are predicted better by no more
    states, since what looks like a dead time may be a lag; none by default.
    """


def identify_state_space(
    records: Sequence[PreparedRecord],
    outputs: tuple[Variable, ...],
    inputs: tuple[Variable, ...],
    settings: StateSpaceSettings,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Fit:
    """Fit a model to all records at once by the error of its simulation.

    Raises UserError where the records are too short for the order, or a constant input or output can't be scaled.
    """
    began = time.perf_counter()
    tell = progress or (lambda stage, count, error: None)
    with alone():
        stretches, scales = _scaled(records)
        stretches, selection, dead = _with_dead_time(stretches, settings, records[0].sampling.initial_samples, tell)

        def system_of(fit: Refined, sizes: Sizes) -> StateSpace:
            return StateSpace(
                period=records[0].sampling.period,
                outputs=outputs,
                inputs=inputs,
                order=sizes.states,
                units=sizes.units,
                power=sizes.power,
                dead=dead,
                scales=scales,
                trials=tuple((float(item.order), item.error, item.spread) for item in selection.trials),
                map_weights=unit_states(fit.weights, sizes, stretches, fit.firsts)[0],
            )

        def missed(found: tuple[Refined, Sizes]) -> float:
            return _free_runs(system_of(*found), records)

        fits = [_linear(stretches, selection, settings, tell)]
        if not settings.order and missed(fits[0]) > WORSE * fits[0][0].mean_square:
            lower = [item.order for item in selection.trials if item.order < selection.order]
            fits += [_linear(stretches, replace(selection, order=order), settings, tell) for order in lower]
        count = sum(fit.evaluations for fit, _ in fits)
        best, linear = min(fits, key=missed)
        if settings.units:
            sizes, fits = replace(linear, units=settings.units, power=settings.power), []
            for number in range(settings.starts):
                first_guess = _with_units(best, linear, sizes, np.random.default_rng([seed, number]))
                stage = f"units, beginning {number + 1}"
                fit = _refined(first_guess, sizes, stretches, selection, settings, stage, tell, best.firsts)
                fits.append((fit, sizes))
            count += sum(fit.evaluations for fit, _ in fits)
            best, linear = min(fits, key=missed)
        system = system_of(best, linear)
    seconds = time.perf_counter() - began
    return Fit(system=system, relative_error=float(np.sqrt(best.mean_square)), seconds=seconds, evaluations=count)


def _linear(
    stretches: Sequence[subspace.Stretch], selection: Selection, settings: StateSpaceSettings, tell: Progress
) -> tuple[Refined, Sizes]:
    """The linear model of an order: a stable one where it is not much worse."""
    start = _start(stretches, selection)
    sizes = Sizes(states=selection.order, inputs=stretches[0][0].shape[1], outputs=stretches[0][1].shape[1])
    met = min(_mean_square(start, stretches), selection.error**2)
    calmed = [*stretches, calm(start.level, met, sizes.inputs)]
    best = _refined(weights_of(start, sizes), sizes, calmed, selection, settings, "linear", tell)
    best = without_last(best, sizes, stretches)
    if linear_radius(best.weights, sizes) > 1.0:
        held = shrunk(best.weights, sizes, 1.0)
        calmer = _refined(held, sizes, calmed, selection, settings, "stable", tell, widest=1.0)
        calmer = without_last(calmer, sizes, stretches)
        if calmer.mean_square < (1.0 + UNSTABLE_GAIN) * best.mean_square:
            best = replace(calmer, evaluations=best.evaluations + calmer.evaluations)
    return best, sizes


def _free_runs(system: StateSpace, records: Sequence[PreparedRecord]) -> float:
    """Mean part of the outputs' variance that free runs from their first samples miss. A fit has the states at the
    beginning as free numbers; where units make several of them explain the first samples, a run may begin in another.
    """
    width = len(system.states)
    blank = [replace(item, states=np.zeros((item.samples, width)), deviations=None) for item in records]
    missing = [1.0 - score_free_run(system, item).r2 for item in blank]
    return float(np.mean(missing)) if np.isfinite(missing).all() else np.inf


def _scaled(records: Sequence[PreparedRecord]) -> tuple[list[subspace.Stretch], tuple[float, ...]]:
    """Inputs and outputs from their means in their deviations, and these: means of outputs and inputs, deviations."""
    means, sizes = [], []
    for name in ("outputs", "inputs"):
        values = np.concatenate([getattr(record, name) for record in records])
        means.append(np.array([float(f"{value:.6g}") for value in values.mean(axis=0)]))
        sizes.append(np.array([scale_of(value) for value in values.std(axis=0)]))
    found = [
        (
            np.ascontiguousarray((record.inputs - means[1]) / sizes[1]),
            np.ascontiguousarray((record.outputs[: len(record.inputs)] - means[0]) / sizes[0]),
        )
        for record in records
    ]
    return found, tuple(np.concatenate([*means, *sizes]).tolist())


def _with_dead_time(
    stretches: list[subspace.Stretch], settings: StateSpaceSettings, known: int, tell: Progress
) -> tuple[list[subspace.Stretch], Selection, tuple[int, ...]]:
    """Stretches with the inputs that act, the choice of the order, and the inputs' dead times, if they are taken."""
    selection = _selected(stretches, settings, known, tell)
    if any(settings.dead):
        late = [acting(item, settings.dead) for item in stretches]
        waiting = _selected(late, settings, known, tell)
        if waiting.error <= selection.error and waiting.order <= selection.order:
            return late, waiting, settings.dead
    return stretches, selection, ()


def _selected(
    stretches: Sequence[subspace.Stretch], settings: StateSpaceSettings, known: int, tell: Progress
) -> Selection:
    if settings.order:
        _check_length(stretches, settings.order)
        if settings.through is not None:
            return Selection(order=settings.order, through=settings.through, trials=())
    orders = [settings.order] if settings.order else comparable(stretches, settings.highest)
    return select_order(
        stretches,
        orders=orders,
        through=settings.through,
        known=known,
        progress=lambda order, error: tell(f"order {order}, held-out blocks", order, error),
    )


def _check_length(stretches: Sequence[subspace.Stretch], order: int) -> None:
    """Raise UserError where the samples are fewer than a subspace of that order needs."""
    m, p = stretches[0][0].shape[1], stretches[0][1].shape[1]
    rows = rows_for(order)
    columns = sum(max(len(inputs) - 2 * rows + 1, 0) for inputs, _ in stretches)
    if columns < 3 * rows * (m + p):
        raise UserError(
            f"state space: {sum(len(inputs) for inputs, _ in stretches)} samples are too few for order {order}, which "
            f"needs {2 * rows + 3 * rows * (m + p)} in a row; give longer records or a lower order"
        )


def _start(stretches: Sequence[subspace.Stretch], selection: Selection) -> subspace.Matrices:
    """The best of the subspace starts in time and, for periodic records, in frequency."""
    m, p = stretches[0][0].shape[1], stretches[0][1].shape[1]
    rows = rows_for(selection.order)
    factors = [subspace.in_time(stretches, rows)]
    spectra = [found for found in map(spectrum_of, stretches) if found is not None]
    if spectra and 2 * sum(len(item.z) for item in spectra) > 2 * rows * (m + p):
        factors.append(subspace.in_frequency(spectra, rows))
    models = []
    for factor in factors:
        a, c = subspace.poles_and_readout(subspace.observability(factor, rows, m, p)[0], selection.order, p)
        models.append(subspace.completed(a, c, stretches, selection.through))
    return min(models, key=lambda model: _mean_square(model, stretches))


def _mean_square(model: subspace.Matrices, stretches: Sequence[subspace.Stretch]) -> float:
    """Mean squared error of a model's simulations."""
    return float(np.mean(np.concatenate([subspace.residuals(model, *item).ravel() for item in stretches]) ** 2))


def _refined(
    weights: Array,
    sizes: Sizes,
    stretches: Sequence[subspace.Stretch],
    selection: Selection,
    settings: StateSpaceSettings,
    stage: str,
    tell: Progress,
    firsts: Array | None = None,
    widest: float = np.inf,
) -> Refined:
    first_guess, starts = unit_states(weights, sizes, stretches, firsts)
    return refine(
        first_guess,
        sizes,
        stretches,
        through=selection.through,
        ridge=settings.ridge,
        iterations=200,
        firsts=starts,
        widest=widest,
        progress=lambda count, error: tell(stage, count, error) if count % 10 == 1 else None,
    )


def _with_units(linear: Refined, before: Sizes, sizes: Sizes, random: np.random.Generator) -> Array:
    """The weights of a linear model whose states have deviation one, with random units that do nothing yet."""
    weights = np.zeros(sizes.count)
    weights[: sizes.units_at] = linear.weights[: before.units_at]
    weights[sizes.readout_at :] = linear.weights[before.readout_at :]
    units = weights[sizes.units_at : sizes.readout_at].reshape(sizes.units, sizes.wide + sizes.states)
    units[:, : sizes.wide] = random.normal(size=(sizes.units, sizes.wide)) / np.sqrt(sizes.states)
    return weights


def options_of(options: Any) -> StateSpaceSettings:
    """The settings of a structure's options. Raises UserError for a power without units, and a first power."""
    given: dict[str, Any] = {name: int(options[name]) for name in ("order", "highest", "units", "power", "starts")}
    if given["power"] == 1:
        raise UserError("state space: a unit of power 1 is linear; take power 2 to 7, or 0 for tanh")
    if given["power"] and not given["units"]:
        raise UserError("state space: power is that of units; give their number, too (--option units=2)")
    through = {0: False, 1: True}.get(int(options["feedthrough"]))
    return StateSpaceSettings(**given, through=through, ridge=float(options["ridge"]))
