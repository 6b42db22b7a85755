"""Evaluation: what a model is worth on a record, judged, with the doubts that belong to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.shooting import unstable_settings
from hybrid_sysid_ros.identification.validation.bands import bands_of
from hybrid_sysid_ros.identification.validation.judgement import judgement
from hybrid_sysid_ros.identification.validation.run_quality import GOOD, RunQuality, run_quality
from hybrid_sysid_ros.identification.validation.scores import free_run, scores_of_run
from hybrid_sysid_ros.identification.validation.unstable import (
    PredictionErrors,
    UnstableError,
    check_free_run,
    predictions,
)
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extensions import provided


@dataclass(frozen=True, kw_only=True)
class ModelEvaluation:
    """What a model is worth on a record. ``print(evaluation)`` says it in sentences."""

    name: str
    """Of the record."""
    seen: bool
    """Whether the model was trained on samples of this part."""
    scores: Mapping[str, Any]
    """Of the strict free run: r2, rmse [SI] and fit_percent, of several outputs by their names under ``outputs``; empty
    where a free run has no meaning.
    """
    judgement: Mapping[str, str]
    """Of the free run by output: good, fair or useless, and why."""
    quality: RunQuality
    """Whether the free run can be judged, and what is wrong with it."""
    unstable: str
    """Why there is no free run, "" where there is one."""
    ahead: Sequence[PredictionErrors]
    """Errors of predictions, where the free run has no meaning or says little."""
    bands: Mapping[str, Mapping[str, Mapping[str, float]]]
    """What the bands of the free run hold, by level and output."""
    loop: Mapping[str, Any] | None
    """Scores of the closed loop that is done again from its commands, as ``scores``."""
    no_loop: str
    """Why it was not."""
    uses: Mapping[str, Mapping[str, Any]]
    """What extensions say of the use before the measurement is seen, each with its sentence."""

    @property
    def doubts(self) -> list[str]:
        """What speaks against the use of the model, or against its free run, before its scores are looked at."""
        said = [use["sentence"] for use in self.uses.values()]
        if self.seen:
            said.insert(0, f"doubt: {self.name} trained this model, so its scores say little of unseen records")
        return [*said, *(f"doubt: {sentence}" for sentence in (self.quality.sentence, self.unstable) if sentence)]

    @property
    def judgements(self) -> list[str]:
        """The judgement, a sentence for each output."""
        several = len(self.judgement) > 1
        return [f"{self.name}{f', {output}' if several else ''}: {words}" for output, words in self.judgement.items()]

    @property
    def content(self) -> dict[str, Any]:
        """Plain data."""
        return {
            **self.scores,
            **self.uses,
            **({"trained_on": True} if self.seen else {}),
            **({"ahead": [item.content for item in self.ahead]} if self.ahead else {}),
            **({"bands": self.bands} if self.bands else {}),
            **({"doubt": vars(self.quality)} if self.quality.kind else {}),
            **({"no_free_run": self.unstable} if self.unstable else {}),
            **({"judgement": self.judgement} if self.judgement else {}),
            "closed_loop": self.loop,
        }

    def __str__(self) -> str:
        ahead = [
            f"{', '.join(filter(None, (self.name, name)))}, {item.seconds:.3g} s ahead: {own}"
            for item in self.ahead
            for name, own in (item.scores.outputs or {"": item.scores}).items()
        ]
        loop = [] if self.loop is None else [f"{self.name}: the closed loop done again has R2 {self.loop['r2']:.4f}"]
        return "\n".join([*self.doubts, *self.judgements, *ahead, *loop])


def evaluation(model: Model, record: Record, rig: Rig, *, part: Part = Part()) -> ModelEvaluation:
    """Evaluate a model on a part of a record of its rig.

    Raises UserError for a record that does not fit the model's sampling or whose output is constant.
    """
    experiment = experiment_of(model, record, part=part)
    try:
        check_free_run(model.system, experiment)
    except UnstableError as error:
        found: dict[str, Any] = _without_free_run(model, experiment, rig, error)
    else:
        found = _of_free_run(model, experiment, rig, free_run(model.system, experiment))
    loop, no_loop = _loop(model, record, part, rig)
    seen = bool(model.was_trained_on(record.digest, part.start, part.stop))
    return ModelEvaluation(name=record.name, seen=seen, loop=loop, no_loop=no_loop, **found)


def _without_free_run(model: Model, experiment: PreparedRecord, rig: Rig, why: UnstableError) -> dict[str, Any]:
    """What predictions say where the free run is meaningless."""
    windows = unstable_settings(rig)
    advice = f": for that declare the rig's stabiliser, experiments.stabiliser in {rig.file}" if windows is None else ""
    ahead = predictions(model.system, experiment, windows)
    nothing: dict[str, Any] = {"scores": {}, "judgement": {}, "bands": {}, "uses": {}}
    return {**nothing, "quality": GOOD, "unstable": f"{why}{advice}", "ahead": ahead}


def _of_free_run(model: Model, experiment: PreparedRecord, rig: Rig, run: Array) -> dict[str, Any]:
    """What a free run (samples, outputs) says."""
    scores = scores_of_run(model.system, experiment, run).content
    quality = run_quality(model.system, experiment)
    bands = {f"{band.level:g}": band.content(model.system, experiment) for band in bands_of(model, experiment)}
    checks = {name: check(model, experiment, run) for name, check in provided("use_checks").items()}
    uses = {name: use for name, use in checks.items() if use}
    limits = [use["limits"] for use in uses.values() if "limits" in use]
    return {
        "scores": scores,
        "judgement": judgement(scores, rig, model.sampling.period, bands, limits) if quality.judged else {},
        "quality": quality,
        "unstable": "",
        "ahead": [] if quality.judged else predictions(model.system, experiment, None),
        "bands": bands,
        "uses": uses,
    }


def _loop(model: Model, record: Record, part: Part, rig: Rig) -> tuple[dict[str, Any] | None, str]:
    """The scores of the loop that is done again, or None and why it is not."""
    try:
        return next((again(model, record, rig, part) for again in provided("loops").values()), None), ""
    except UserError as error:
        return None, str(error)
