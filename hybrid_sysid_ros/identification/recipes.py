"""How each structure is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification.experiment import Experiment, prepare
from hybrid_sysid_ros.identification.fitting import STAGES, Fit, Progress, fit
from hybrid_sysid_ros.identification.gradient_training import train
from hybrid_sysid_ros.identification.selection.term_selection import select_terms
from hybrid_sysid_ros.models import Sampling, build
from hybrid_sysid_ros.models.hybrid import Hybrid, averaged
from hybrid_sysid_ros.models.options import Options, complete
from hybrid_sysid_ros.models.recurrent import PERIOD as RECURRENT_PERIOD
from hybrid_sysid_ros.models.recurrent import Recurrent
from hybrid_sysid_ros.models.structures import options_of
from hybrid_sysid_ros.rigs.rig import Rig

FEATURE_SCALE = 1.5
"""Scale of a network's feature, in root mean squares of the training data."""

NARX_RIDGE = 1e-6
"""Its terms are chosen already: nothing pulls their coefficients to zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recipe:
    """A structure and all that its fit depends on but the records."""

    rig: Rig
    structure: str
    sampling: Sampling
    options: Options
    seed: int
    progress: Progress | None = None

    @property
    def chosen(self) -> dict[str, float | int]:
        """All options, defaults included."""
        return complete(self.options, options_of(self.structure, self.rig.system), self.structure)

    def fit(self, records: Sequence[Record]) -> tuple[Fit, Sampling]:
        """The fit, and the sampling that it holds at. Raises UserError as the parts of it do."""
        if self.structure == "narx":
            return self._narx(records)
        if self.structure == "recurrent":
            return self._recurrent(records)
        return self._rollouts(records), self.sampling

    def _rollouts(self, records: Sequence[Record]) -> Fit:
        """Least squares on compiled rollouts."""
        if self.structure == "hybrid":
            return self._hybrid(records)
        if self.structure == "hybrid_frozen":
            first = self._one("linear", records)
            return self._one(self.structure, records, start=first, hold=first.names, stages=STAGES)
        return self._one(self.structure, records, stages=STAGES)

    def _hybrid(self, records: Sequence[Record]) -> Fit:
        """The gray box first; then networks of several seeds about it, averaged into one, so that they learn what the
        physics leaves and no single seed decides.
        """
        gray = self._one("gray", records)
        members = [
            self._one("hybrid", records, start=gray, anchor=gray, stages=STAGES[-2:], member=member)
            for member in range(int(self.chosen["members"]))
        ]
        hybrids = [member.system for member in members if isinstance(member.system, Hybrid)]
        return replace(
            gray,
            system=averaged(hybrids),
            relative_error=float(np.mean([member.relative_error for member in members])),
            seconds=gray.seconds + sum(member.seconds for member in members),
            evaluations=gray.evaluations + sum(member.evaluations for member in members),
        )

    def _one(
        self,
        structure: str,
        records: Sequence[Record],
        *,
        start: Fit | None = None,
        anchor: Fit | None = None,
        hold: Sequence[str] = (),
        stages: Sequence[int | None] = STAGES,
        member: int = 0,
    ) -> Fit:
        known = options_of(structure, self.rig.system)
        options = {name: value for name, value in self.chosen.items() if name in known}
        scales = feature_scales([prepare(record, self.rig.system, self.sampling) for record in records])
        seed = self.seed + 1000 * member
        system, neutral = build(structure, self.rig.system, scales=scales, seed=seed, options=options)
        if start is not None:
            system = system.with_values(start.system.values)
        return fit(
            system,
            [prepare(record, system, self.sampling) for record in records],
            stages=stages,
            anchor=anchor,
            ridge=float(options.get("ridge", 1.0)),
            bias=float(options.get("bias", 0.0)),
            hold=(*neutral, *hold),
            starts=int(options.get("starts", 1)) if start is None else 1,
            seed=seed,
            progress=self.progress,
        )

    def _narx(self, records: Sequence[Record]) -> tuple[Fit, Sampling]:
        """Terms by error reduction, then their coefficients by the error of the simulation."""
        sampling = replace(self.sampling, step=self.sampling.period)
        options = {name: int(value) for name, value in self.chosen.items()}
        chosen = select_terms(
            [prepare(record, self.rig.system, sampling) for record in records],
            output_lags=options["output_lags"],
            input_lags=options["input_lags"],
            degree=options["degree"],
            terms=options["terms"] or None,
        )
        experiments = [prepare(record, chosen, sampling) for record in records]
        return fit(chosen, experiments, ridge=NARX_RIDGE, progress=self.progress), sampling

    def _recurrent(self, records: Sequence[Record]) -> tuple[Fit, Sampling]:
        """Gradients through time."""
        step = RECURRENT_PERIOD if self.sampling.input == "averaged" else self.sampling.period
        sampling = replace(self.sampling, step=step)
        experiments = [prepare(record, Recurrent(), sampling) for record in records]
        return train(experiments, units=int(self.chosen["units"]), seed=self.seed, progress=self.progress), sampling


def feature_scales(experiments: Sequence[Experiment]) -> NDArray[np.float64]:
    """Of the states, then the inputs. Root mean squares: single large values must not set the scale of a network."""
    states = np.concatenate([item.states for item in experiments])
    inputs = np.concatenate([item.inputs for item in experiments])
    return FEATURE_SCALE * np.sqrt(np.concatenate([np.mean(states**2, axis=0), np.mean(inputs**2, axis=0)]))
