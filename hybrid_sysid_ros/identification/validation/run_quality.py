"""Run quality: whether the free run over a record can be judged, and if it is poor, of what kind the reason is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.shooting import fastest_growth, parts_from
from hybrid_sysid_ros.identification.starts import start_of
from hybrid_sysid_ros.support.arrays import Array

Kind = Literal["", "integrates", "unstable", "sign", "unit", "offset", "unexplained"]
OFFSET = 1e-3
"""Error of an input that nobody can exclude, in the input's range over the record."""
UNTOLD = 0.5
"""Spread of a run's end in the output's deviation, above which the run says nothing about the model."""
EXPONENTIAL = 32.0
"""Growth of the spread over the second half of a run, above which it is no power of time."""
POOR, ALIKE, NEAR = 0.5, 0.8, 1.25
"""R2 below which a run is poor, squared correlation above which a factor explains it, and factors that explain
nothing.
"""
THROUGHOUT, LARGE = 2.0, 0.05
"""Offset of an output in the deviation of its error in each half, and in its own deviation, from which it is one."""


@dataclass(frozen=True, kw_only=True)
class RunQuality:
    """Whether a free run can be judged."""

    kind: Kind
    """What is wrong, "" for nothing."""
    sentence: str

    @property
    def judged(self) -> bool:
        """Whether the free run says something about the model."""
        return self.kind not in ("integrates", "unstable")


GOOD = RunQuality(kind="", sentence="")


def run_quality(system: System, experiment: PreparedRecord) -> RunQuality:
    """The quality of a free run: what its start and a small error of its inputs leave open, and whether a factor of an
    output, or an offset, explains what is wrong with it.
    """
    spread, run = _open(system, experiment)
    deviation = np.std(experiment.outputs, axis=0)
    tenth, half = max(experiment.samples // 10, 1), experiment.samples // 2
    late, middle = (
        np.sqrt(np.mean(part**2, axis=0)) for part in (spread[-tenth:], spread[half - tenth // 2 :][:tenth])
    )
    worst = int(np.argmax(late / deviation))
    if late[worst] > UNTOLD * deviation[worst]:
        grows = fastest_growth(system) > 0.0 and late[worst] > EXPONENTIAL * middle[worst]
        name, times = system.outputs[worst].name, late[worst] / deviation[worst]
        many = f"{times:.2g} times" if times < 1e6 else "more than a million times"
        parting = None if grows else parts_from(system, experiment)
        why = "it is unstable" if grows else "it integrates"
        if parting is not None:
            why = f"it may go either way from {parting:.3g} s on"
        return RunQuality(
            kind="unstable" if grows or parting is not None else "integrates",
            sentence=f"{experiment.name}: the free run of {name} says little, for {why}: what is not known of its "
            f"start, and a thousandth of the inputs' range, become {many} the deviation of {name}; judge the model by "
            "the loop done again and by some steps ahead",
        )
    return _explained(system, experiment, run)


def _open(system: System, experiment: PreparedRecord) -> tuple[Array, Array]:
    """What start and inputs leave open of a run, as standard deviations (samples, outputs), and the run itself."""
    start, sampling = start_of(system, experiment), experiment.sampling
    values, vectors = np.linalg.eigh(start.covariance)
    moves = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    first = np.repeat(start.state[None], 1 + len(moves), axis=0)
    first[1:, list(start.estimated)] += moves
    count = experiment.samples
    starts = np.array([[0, 0, count, k * count] for k in range(len(first))])
    given: dict[str, Any] = {"step": sampling.step, "every": sampling.every}
    _, runs = rollouts(system, starts, first, experiment.inputs, **given)
    found = [*runs.reshape(len(first), count, -1)]
    for column, size in enumerate(np.ptp(experiment.inputs, axis=0)):
        inputs = experiment.inputs.copy()
        inputs[:, column] += OFFSET * size
        found.append(rollouts(system, starts[:1], first[:1], inputs, **given)[1])
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.sum([(run - found[0]) ** 2 for run in found[1:]], axis=0)
        return np.minimum(np.nan_to_num(np.sqrt(squares), nan=1e9), 1e9) * np.ones_like(found[0]), found[0]


def _offset(error: Array, deviation: float) -> float:
    """The mean error (samples,) where it is the same in both halves of what follows the start, and large; else 0."""
    whole = error[len(error) // 4 :]  # the start was bent to fit
    means, spread = [float(part.mean()) for part in np.array_split(whole, 2)], float(np.std(whole))
    least = max(THROUGHOUT * spread, LARGE * deviation)
    return float(whole.mean()) if min(means) > least or max(means) < -least else 0.0


def _explained(system: System, experiment: PreparedRecord, run: Array) -> RunQuality:
    """What a factor of an output explains of a poor run."""
    scored, name = experiment.scored, experiment.name
    for whole, ran, item in zip(experiment.outputs[scored].T, run[scored].T, system.outputs, strict=True):
        measured, simulated = whole, ran
        if not np.isfinite(simulated).all():
            return RunQuality(kind="unexplained", sentence=f"{name}: the free run of {item.name} diverges")
        if offset := _offset(measured - simulated, float(np.std(measured))):
            way = "above" if offset > 0.0 else "below"
            return RunQuality(
                kind="offset",
                sentence=f"{name}: {item.name} is {abs(offset):.3g} {item.unit} {way} the run throughout: was its zero "
                "set anew, or does an unseen load or an input's offset push it (guesses)?",
            )
        left, total = np.sum((measured - simulated) ** 2), np.sum((measured - measured.mean()) ** 2)
        if left < (1.0 - POOR) * total:
            continue
        half = len(measured) // 2  # the start, which was bent to fit, is forgotten there
        measured, simulated = measured[half:], simulated[half:]
        total = np.sum((measured - measured.mean()) ** 2)
        moved = simulated - simulated.mean()
        factor = float(moved @ (measured - measured.mean()) / max(float(moved @ moved), 1e-300))
        alike = factor**2 * float(moved @ moved) / total
        if alike < ALIKE or 1.0 / NEAR < factor < NEAR:
            return RunQuality(
                kind="unexplained",
                sentence=f"{name}: the model does not explain {item.name}, and no factor of it would help: its law "
                "can't say this motion, it is not of this system, or what moves it is not among the inputs (guesses)",
            )
        better = (
            f"{name}: multiplied by {factor:.3g}, the run of {item.name} would have R2 {alike:.2f} (over its second "
            "half, without the means)"
        )
        if factor < 0.0:
            return RunQuality(kind="sign", sentence=f"{better}: the sign of {item.name} or of an input is turned")
        return RunQuality(kind="unit", sentence=f"{better}: {item.name} or an input is in another unit or scale")
    return GOOD
