"""Horizon bands: how far a measurement may be from a prediction k samples ahead.

A prediction is a simulation from the measured state, which is corrected no more. A band of level p is as wide as hold a
share p of the errors at k samples of training blocks that were left out of the fit, wider by Student's factor for how
the blocks differ, and in proportion to the excursion of the predictions, where these go farther than training, as
bands of free runs are (:mod:`~hybrid_sysid_ros.identification.validation.bands`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.extensions.shared.horizons import LONGEST, default_horizons
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.standard_errors import student_factor
from hybrid_sysid_ros.identification.validation.bands import LEVELS, excursion_of, freedom_of
from hybrid_sysid_ros.identification.validation.left_out import LeftOut
from hybrid_sysid_ros.identification.validation.scores import free_run_states
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NOTE = "horizon_bands"
MOST = 200
"""Predictions of a record."""
SHORTEST = 8
"""Samples of the longest horizon below which nothing is noted."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonBands:
    """Errors of a record's predictions, and what bands say of them; h horizons, p outputs."""

    name: str
    seconds: Array
    """(h,)."""
    errors: Array
    """(predictions, h, p)."""
    halves: dict[float, Array]
    """Half of the width by level, (h, p)."""

    @property
    def held(self) -> dict[float, Array]:
        """Share of the predictions that lie within, by level, (h, p)."""
        return {level: np.mean(np.abs(self.errors) <= half, axis=0) for level, half in self.halves.items()}

    def content(self, system: System) -> dict[str, Any]:
        """Plain data by output: half widths and shares over the horizon."""
        found: dict[str, Any] = {"seconds": self.seconds.tolist()}
        for k, item in enumerate(system.outputs):
            found[item.name] = {
                f"{level:g}": {"half": half[:, k].tolist(), "held": self.held[level][:, k].tolist()}
                for level, half in self.halves.items()
            }
        return found


def noted(system: System, experiments: Sequence[PreparedRecord], blocks: Sequence[LeftOut]) -> dict[str, Any] | None:
    """What a model keeps for bands, as plain data; None where no block was left out, all are too short, or no state is
    measured from which a prediction could begin.
    """
    longest = min((item.samples.stop - item.samples.start for item in blocks), default=0) // 2
    if longest < SHORTEST or _shows_nothing(system):
        return None
    ahead = default_horizons(min(LONGEST, longest))
    errors, centre = [], np.mean(np.concatenate([item.outputs for item in experiments]), axis=0)
    for block in blocks:
        experiment, samples = experiments[block.record], block.samples
        simulated, measured = _predictions(block.system, experiment, ahead, samples.start, samples.stop)
        errors.append(np.nan_to_num(measured - simulated, nan=np.inf))
    together = np.abs(np.concatenate(errors))
    widths = {}
    for level in LEVELS:
        wide = np.quantile(together, level, axis=0, method="higher")
        for h, k in np.ndindex(wide.shape):
            if np.isfinite(wide[h, k]):
                wide[h, k] *= student_factor(freedom_of([part[:, h, k] for part in errors], len(experiments)))
        widths[f"{level:g}"] = wide.tolist()
    excursions = [excursion_of(item.outputs, centre) for item in experiments]
    return {
        "ahead": ahead.tolist(),
        "widths": widths,
        "centre": centre.tolist(),
        "excursion": np.max(excursions, axis=0).tolist(),
    }


def horizon_bands(model: Model, experiment: PreparedRecord) -> HorizonBands | None:
    """Bands and errors over the horizon; None for a model without them: an older one, a state space, one of an unstable
    rig or of a structure that no record can be left out of. Raises UserError for a record that is shorter.
    """
    known = model.note(NOTE)
    if not known or _shows_nothing(model.system):
        return None
    ahead = np.array(known["ahead"], dtype=np.int64)
    ahead = ahead[ahead < experiment.samples // 2]
    if not len(ahead):
        raise UserError(f"{experiment.name}: {experiment.samples} samples are too few for predictions")
    simulated, measured = _predictions(model.system, experiment, ahead, 0, experiment.samples)
    moves = excursion_of(simulated.reshape(-1, simulated.shape[2]), np.array(known["centre"]))
    growth = np.maximum(moves / np.array(known["excursion"]), 1.0)
    halves = {float(level): growth * np.array(wide)[: len(ahead)] for level, wide in known["widths"].items()}
    seconds = np.asarray(model.sampling.period * ahead, dtype=float)
    return HorizonBands(name=experiment.name, seconds=seconds, errors=measured - simulated, halves=halves)


def _shows_nothing(system: System) -> bool:
    """Whether no record shows a state, as in a state space: its predictions would be free runs."""
    return len(system.record_map().unobserved) == len(system.states)


def _predictions(
    system: System, experiment: PreparedRecord, ahead: NDArray[np.int64], first: int, last: int
) -> tuple[Array, Array]:
    """Predictions and measurements (predictions, horizons, outputs) within some samples, at most MOST, from measured
    states; states that no record shows come from the free run.
    """
    longest, sampling = int(ahead[-1]), experiment.sampling
    begins = np.unique(np.linspace(first, last - 1 - longest, MOST).astype(np.int64))
    starts = np.zeros((len(begins), 4), dtype=np.int64)
    starts[:, 1], starts[:, 2] = begins * sampling.every, longest + 1
    starts[:, 3] = np.arange(len(begins)) * (longest + 1)
    initial, hidden = experiment.states.copy(), system.record_map().unobserved
    if hidden:
        initial[:, hidden] = free_run_states(system, experiment)[0][:, hidden]
    given = np.ascontiguousarray(initial[begins])
    _, outputs = rollouts(system, starts, given, experiment.inputs, step=sampling.step, every=sampling.every)
    simulated = outputs.reshape(len(begins), longest + 1, -1)[:, ahead]
    return np.asarray(simulated), np.asarray(experiment.outputs[begins[:, None] + ahead])
