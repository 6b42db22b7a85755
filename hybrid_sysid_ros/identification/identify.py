"""From records to a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.equations import Equation
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.identification.experiment import Experiment, prepare
from hybrid_sysid_ros.identification.fitting import STAGES, Progress, fit
from hybrid_sysid_ros.identification.scores import Scores, free_run, score
from hybrid_sysid_ros.models import Model, Sampling, build
from hybrid_sysid_ros.record import Record
from hybrid_sysid_ros.rigs.rig import Rig

FEATURE_SCALE = 1.5
"""Scale of a network's feature, in root mean squares of the training data."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """The part of each record that is used, as fractions of its duration."""

    start: float = 0.0
    stop: float = 1.0

    @classmethod
    def parse(cls, text: str) -> Part:
        """From "0:0.5". Raises UserError for anything else."""
        try:
            start, stop = (float(value) for value in text.split(":"))
        except ValueError:
            raise UserError(f"part {text!r}: write START:STOP as fractions, such as 0:0.5") from None
        if not 0.0 <= start < stop <= 1.0:
            raise UserError(f"part {text!r}: needs 0 <= START < STOP <= 1")
        return cls(start=start, stop=stop)


def identify(
    records: Sequence[Record],
    rig: Rig,
    structure: str,
    *,
    sampling: Sampling,
    part: Part = Part(),
    seed: int = 0,
    progress: Progress | None = None,
) -> Model:
    """Fit a structure to parts of records.

    A hybrid begins from the gray box fitted to the same data, so that its network learns what the physics leaves.
    Raises UserError for records that don't fit the sampling or don't excite the rig, and for an unknown structure.
    """
    if not records:
        raise UserError("identification: no record to fit")
    used = [record.part(part.start, part.stop) for record in records]
    experiments = [prepare(record, rig.equation, sampling) for record in used]
    for item in experiments:
        if np.ptp(item.outputs[:, 0]) == 0.0:
            name = rig.equation.states[rig.equation.outputs[0]].name
            raise UserError(f"{item.name}: output {name} is constant, so it can't be scored; leave the record out")
    states = np.concatenate([item.states for item in experiments])
    inputs = np.concatenate([item.inputs for item in experiments])
    # Root mean squares: single large values must not set the scale of a network.
    scales = FEATURE_SCALE * np.sqrt(np.concatenate([np.mean(states**2, axis=0), np.mean(inputs**2, axis=0)]))
    seconds = evaluations = 0.0
    stages, anchor = STAGES, None
    if structure == "hybrid":
        anchor = fit(build("gray", rig.equation, scales=scales, seed=seed), experiments, progress=progress)
        seconds, evaluations = anchor.seconds, anchor.evaluations
        stages = STAGES[-2:]
    start = build(structure, rig.equation, scales=scales, seed=seed)
    if anchor is not None:
        start = start.with_values(anchor.equation.values)
    fitted = fit(start, experiments, stages=stages, anchor=anchor, progress=progress)
    ranges = {
        variable.name: (float(column.min()), float(column.max()))
        for variable, column in zip(
            (*fitted.equation.states, *fitted.equation.inputs), (*states.T, *inputs.T), strict=True
        )
    }
    return Model(
        rig=rig.name,
        structure=structure,
        equation=fitted.equation,
        sampling=sampling,
        names=fitted.names,
        covariance=fitted.covariance,
        training_range=ranges,
        records=tuple(
            {"name": r.name, "source": Path(r.source).name, "sha256": r.digest, "part": [part.start, part.stop]}
            for r in records
        ),
        scores={item.name: asdict(_scores(fitted.equation, item)) for item in experiments},
        fit={
            "relative_error": fitted.relative_error,
            "seconds": round(seconds + fitted.seconds, 3),
            "evaluations": int(evaluations + fitted.evaluations),
            "seed": seed,
        },
    )


def evaluate(model: Model, record: Record, *, part: Part = Part()) -> Scores:
    """Strict free run of a model on (a part of) a record, scored on the raw output.

    Raises UserError where the record does not fit the model's sampling.
    """
    return _scores(model.equation, experiment_of(model, record, part=part))


def experiment_of(model: Model, record: Record, *, part: Part = Part()) -> Experiment:
    """A record made ready for a model, at the sampling that the model was identified at."""
    return prepare(record.part(part.start, part.stop), model.equation, model.sampling)


def _scores(equation: Equation, experiment: Experiment) -> Scores:
    try:
        return score(experiment.outputs[:, 0], free_run(equation, experiment)[:, 0])
    except UserError as error:
        raise UserError(f"{experiment.name}: {error}; leave the record out") from None
