"""First equation: the dead times of a record, and the simplest linear equation that is near to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from hybrid_sysid_ros.support.arrays import Array

CONSTANTS, DAMPINGS = np.geomspace(1.0 / 60.0, 3.0, 24), np.array([0.05, 0.2, 0.5, 1.0, 2.5])
"""Where the search for an equation begins: time constants in periods of the band, and damping ratios."""
LONGEST, FASTEST = 3.0, 1.5
"""Longest time constant, in records; fastest pole, over a step of the fit."""
MORE, NOISY = 1.15, 2.0
"""Error of a simpler equation, in the least one of all forms and in the sensor's noise, up to which it is taken."""
MOST = 20_000
"""Samples at the beginning of a record by which the equation is found."""
DELAYS = np.unique(np.round(np.geomspace(1.0, 1000.0, 40)).astype(int)).tolist()
"""Dead times that are tried, in samples."""
MOST_STEPS, MOST_OUTPUTS, FEW = 3000, 4, 30
"""Steps and outputs by which dead times are found, and how often the longest one that is tried fits into a record."""
ONE_LINE, FEW_PERIODS = 0.9, 4
"""Share of a sine's power in the lines about its frequency, and periods from which it is one."""
GAIN = 0.95
"""Error that a dead time must leave, in that without it: a lag of higher order looks like a short one."""


def late(values: Array, samples: int) -> Array:
    """A signal so many samples later; its first value stood before."""
    return np.concatenate([np.full(samples, values[0]), values[: len(values) - samples]])


def delays_of(outputs: Sequence[Array], inputs: Sequence[Array], every: int, step: float, band: float) -> list[int]:
    """Samples by which each input acts later, one input after the other: those with which the changes of the nearest
    equations are nearest to the record's; 0 where these are hardly nearer, and of an input of one frequency, where a
    dead time is as good as a lag. Of many outputs the best explained decide.

    every: samples in a step [s]. band: frequency below which the outputs vary [Hz].
    """
    us = [values[: MOST_STEPS * every] for values in inputs]
    ys = [values[: MOST_STEPS * every] for values in outputs]
    searches = [_Search(y, us, every, step, band, EQUATION_FORMS[1], by_changes=True) for y in ys]
    for search in searches:
        search.begin()
    searches.sort(key=lambda search: float(np.sum(search.solved(search.point)[0] ** 2)))
    searches, found = searches[:MOST_OUTPUTS], [0] * len(us)

    def error(chosen: Sequence[int]) -> float:
        shifted = [late(values, delay) for values, delay in zip(us, chosen, strict=True)]
        return float(np.sqrt(sum(search.driven_by(shifted).least(1e-4) for search in searches)))

    for k in [k for k in range(len(us)) if not is_sine(us[k])]:
        tried = [delay for delay in DELAYS if delay * FEW < len(us[k])]
        errors = {delay: error([*found[:k], delay, *found[k + 1 :]]) for delay in (0, *tried)}
        best = min(errors, key=lambda delay: errors[delay])
        found[k] = best if errors[best] < GAIN * errors[0] else 0
    return found


def is_sine(values: Array) -> bool:
    """Whether nearly all of a signal's power is at one frequency."""
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)))) ** 2
    line = int(np.argmax(power))
    return bool(power[max(line - 2, 0) : line + 3].sum() > ONE_LINE * power.sum() > 0.0) and line > FEW_PERIODS


@dataclass(frozen=True, kw_only=True)
class EquationForm:
    """What an equation has: lags, whether a rate goes with the inputs at once, and whether the output does."""

    order: int
    by_rate: bool = False
    direct: bool = False


EQUATION_FORMS = (
    EquationForm(order=1),
    EquationForm(order=2),
    EquationForm(order=1, direct=True),
    EquationForm(order=2, by_rate=True),
    EquationForm(order=2, by_rate=True, direct=True),
)
"""Forms of an equation, the simplest first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Equation:
    """T y' = pull with a lag of first order, else T^2 y'' = pull - 2 d T y', where pull = gains u + offset - y; beside
    that the inputs move y' by rates u and y by shares u, at once.
    """

    form: EquationForm
    gains: Array
    """Of the output by each input at rest, (inputs,)."""
    rates: Array
    """(inputs,) [1/s]; zero where the form has none."""
    shares: Array
    """(inputs,); zero where the form has none."""
    offset: float
    constant: float
    """T [s]."""
    damping: float
    """d."""
    error: float
    """Root mean square of the simulation's error."""
    change_error: float
    """The same of its changes from step to step."""


def equation_of(output: Array, inputs: Sequence[Array], every: int, step: float, band: float, noise: float) -> Equation:
    """The simplest equation whose simulation of a record errs hardly more than any form's, or than the noise, and so do
    its changes from step to step. A share at once must show in these, else it stands for a dead time or a curve. T and
    d are searched; gains, rates, shares, offset and initial state follow by least squares (variable projection).
    """
    y, us, found = output[: MOST * every], [u[: MOST * every] for u in inputs], list[Equation]()
    for form in EQUATION_FORMS:
        found.append(_Search(y, us, every, step, band, form).equation())
        if found[-1].error <= NOISY * noise:
            break
    least = min(item.change_error for item in found if not item.form.direct)
    shown = [item for item in found if item.form.direct and MORE * item.change_error < least]
    found = shown or [item for item in found if not item.form.direct]
    enough = max(MORE * min(item.change_error for item in found), NOISY * noise)
    found = [item for item in found if item.change_error <= enough]
    enough = max(MORE * min(item.error for item in found), NOISY * noise)
    return next(item for item in found if item.error <= enough)


class _Search:
    """The search for T and d of one output, in steps."""

    def __init__(
        self, output: Array, inputs: Sequence[Array], every: int, step: float, band: float, form: EquationForm,
        by_changes: bool = False,
    ) -> None:  # fmt: skip
        """by_changes: errors are those of changes from step to step, which a slow error hardly moves."""
        self.every, self.step, self.band, self.form, self.by_changes = every, step, band, form, by_changes
        self.driven_by(inputs)
        self.y = output[::every][: len(self.us[0])]
        low, high = (CONSTANTS[0] / band, DAMPINGS[0] / 10.0), (LONGEST * step * len(self.y), 10.0 * DAMPINGS[-1])
        self.ends = np.log([low, high])[:, : form.order]

    def driven_by(self, inputs: Sequence[Array]) -> _Search:
        """Take these inputs (samples,) as held means over each step."""
        every = self.every
        self.us = [values[: len(values) // every * every].reshape(-1, every).mean(axis=1) for values in inputs]
        return self

    def equation(self) -> Equation:
        """The equation that is nearest."""
        self.begin()
        self.least()
        errors, found, constant, damping = self.solved(self.point)
        count, form = len(self.us), self.form
        gains, *more = found[: count * (1 + form.by_rate + form.direct)].reshape(-1, count)
        rates = more.pop(0) / constant if form.by_rate else np.zeros(count)
        shares = more.pop(0) if form.direct else np.zeros(count)
        size, moved = self.size, np.diff(errors)
        return Equation(
            form=form, gains=gains + shares, rates=rates, shares=shares, offset=float(found[-form.order - 1]),
            constant=constant, damping=damping, error=size * float(np.sqrt(np.mean(errors**2))),
            change_error=size * float(np.sqrt(np.mean(moved**2))),
        )  # fmt: skip

    def solved(self, point: Array) -> tuple[Array, Array, float, float]:
        """Errors in the output's size (steps,), numbers that follow, T and d, of log T and log d."""
        damping = float(np.exp(point[1])) if self.form.order == 2 else 0.0
        fastest = damping + np.sqrt(damping**2 - 1.0) if damping > 1.0 else 1.0
        constant = max(float(np.exp(point[0])), fastest * self.step / FASTEST)
        rows, aim = responses_of(self.us, self.step / constant, damping, self.form), self.y
        if self.by_changes:
            rows, aim = np.diff(rows, axis=0), np.diff(aim)
        small = np.asarray(np.linalg.qr(np.column_stack([rows, aim]), mode="r"))  # faster than lstsq of tall rows
        found = np.asarray(np.linalg.lstsq(small[:, :-1], small[:, -1], rcond=None)[0], dtype=np.float64)
        return np.asarray((rows @ found - aim) / self.size), found, float(constant), damping

    @property
    def size(self) -> float:
        """Norm of what is to be explained."""
        aim = np.diff(self.y) if self.by_changes else self.y
        return float(np.linalg.norm(aim - aim.mean())) or 1.0

    def begin(self) -> None:
        """Go to the best one of the beginnings."""
        beginnings = np.log([[t / self.band, d] for t in CONSTANTS for d in DAMPINGS])
        beginnings = np.unique(beginnings[:, : self.form.order], axis=0)
        first = min(beginnings, key=lambda point: float(np.sum(self.solved(point)[0] ** 2)))
        self.point = np.clip(first, self.ends[0] + 1e-9, self.ends[1] - 1e-9)

    def least(self, tolerance: float = 1e-8) -> float:
        """The least sum of squares from where the last search ended, but for a relative tolerance."""
        best = least_squares(lambda point: self.solved(point)[0], self.point, bounds=self.ends, ftol=tolerance)
        self.point = np.clip(best.x, self.ends[0] + 1e-9, self.ends[1] - 1e-9)
        return 2.0 * float(best.cost)


def responses_of(inputs: Sequence[Array], step: float, damping: float, form: EquationForm) -> Array:
    """Of y' = u - y, or y'' = u - y - 2 d y', to each input alone, to its rate, to what it adds at once, to an offset
    and to the initial states, (samples, columns); the inputs are held.
    """
    law = np.array([[-1.0]]), np.array([[1.0]])
    if form.order == 2:
        law = np.array([[0.0, 1.0], [-1.0, -2.0 * damping]]), np.array([[0.0], [1.0]])
    kept, given, *_ = cont2discrete((*law, np.eye(form.order), np.zeros((form.order, 1))), step)
    impulse = np.zeros(len(inputs[0]))
    impulse[0] = 1.0
    if form.order == 1:
        a, b = float(kept[0, 0]), float(given[0, 0])
        poles, answers, free = [1.0, -a], [[0.0, b]], [[1.0]]
    else:
        a, b, c, d, e, f = (float(value) for value in (*kept.ravel(), *given.ravel()))
        poles, free = [1.0, -a - d, a * d - b * c], [[1.0, -d], [0.0, b]]
        answers = [[0.0, e, b * f - d * e], [0.0, f, c * e - a * f]][: 1 + form.by_rate]
    driven = [lfilter(numerator, poles, u) for numerator in answers for u in inputs]
    rest = [lfilter(numerator, poles, impulse) for numerator in free]
    return np.column_stack([*driven, *(inputs if form.direct else ()), np.ones(len(impulse)), *rest])
