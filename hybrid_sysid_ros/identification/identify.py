"""Identification of a model from records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.identification.context import LOST, Context
from hybrid_sysid_ros.identification.experiment import ResampledRecord, check_range, handling_of, prepare, resample
from hybrid_sysid_ros.identification.fitting import FitProgress
from hybrid_sysid_ros.identification.parameter_groups import groups
from hybrid_sysid_ros.identification.part import Part, check_apart, parts_of, without_gaps
from hybrid_sysid_ros.identification.shooting import check_sampling
from hybrid_sysid_ros.identification.validation.bands import Uncertainty, band_calibration
from hybrid_sysid_ros.identification.validation.left_out import LeftOut, left_out
from hybrid_sysid_ros.identification.validation.scores import Scores, score_free_run
from hybrid_sysid_ros.identification.validation.unstable import (
    check_free_run,
    has_free_run,
    predictions,
    stabilised_run,
)
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.models.fit import Fit, PreparedRecord
from hybrid_sysid_ros.models.structure import Options, complete, structure_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.validity import check_valid
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extensions import blaming, provided

BETTER = 0.98
"""Factor of the training error by which lines between an input's samples must be better than held samples."""
REFINED, FINER = (0.3, 1.0), (5, 4, 6, 3, 2)
"""Shares of a standard error by which a step may move a parameter at first, and once it is finer in a fit over windows,
which are short enough for a still finer one; and the parts into which a longer step is cut, the first that fit the
records' sampling.
"""
WORSE = 1.5
"""Relative error of a fit at a finer step, in that of the fit before, from which it may have lost the way."""


def identify(
    records: Sequence[Record],
    rig: Rig,
    structure: str,
    *,
    sampling: Sampling,
    part: Part | Sequence[Part] = Part(),
    options: Options | None = None,
    seed: int = 0,
    progress: FitProgress | None = None,
    refine: bool = False,
    criterion: str = "simulation",
) -> Model:
    """Fit a structure to parts of records.

    part: one part for all records, or one for each. options: values by name, see
    :func:`~hybrid_sysid_ros.models.structure.options_of`. refine: a gray box is fitted again at a finer step, which the
    model then has, where the step of the sampling moves a parameter by REFINED of its standard error. criterion: of
    physics, "simulation" for free runs, or the name of one that an extension provides, such as "prediction". Raises
    UserError for records that don't fit the sampling or don't excite the rig, and for an unknown structure, option or
    criterion.
    """
    if not records:
        raise UserError("identification: no record to fit")
    if rig.experiments.stabiliser is not None:
        check_sampling(sampling, f"identification of {rig.name}")
    found = structure_of(structure, rig.system, rig.structures)
    without = f"criterion {criterion}: structure {structure} fits no physics alone: take a gray box, or hybrid"
    if criterion != "simulation" and not found.box:
        raise UserError(without)
    given: dict[str, Any]
    if sampling.input == "auto":
        given = {"part": part, "options": options, "seed": seed, "progress": progress, "refine": refine}
        given |= {"criterion": criterion}
        return _by_training(records, rig, structure, sampling, given)
    chosen, holds = complete(options or {}, found.options, structure), found.sampling(sampling)
    used = without_gaps(parts_of(records, part, sampling), sampling)
    parts = [part] * len(records) if isinstance(part, Part) else part
    check_apart(records, parts)
    resampled = [checked(record, rig, holds) for record in used]
    given = {"rig": rig, "sampling": holds, "options": chosen, "seed": seed, "progress": progress}
    context = Context(**given, records=used, resampled=resampled, criterion=criterion)
    with blaming(f"structure {structure} ({found.__module__})", found.__module__):
        fitted = found.fit(context)
        if not isinstance(fitted, Fit):
            raise TypeError(f"its fit gave {fitted!r}, which is no Fit")
    if criterion != "simulation" and criterion not in fitted.notes:
        raise UserError(without)
    if refine and found.is_gray_box:
        context, fitted = _refined(context, fitted)
    return _model(records, parts, structure, context, fitted, leave_out=refine)


def _model(
    records: Sequence[Record], parts: Sequence[Part], structure: str, context: Context, fitted: Fit, *, leave_out: bool
) -> Model:
    """The model of a fit, with what is known of its training."""
    rig, spread = context.rig, len(fitted.block_spread) == len(fitted.names) > 0
    known_together = groups(fitted)
    experiments, shown = context.experiments(fitted.system), context.experiments(rig.system)
    ranges = _ranges(rig, shown)
    return Model(
        rig=rig.name,
        place="" if rig.source == rig.name else rig.source,
        structure=structure,
        system=fitted.system,
        sampling=context.sampling,
        names=fitted.names,
        covariance=fitted.covariance,
        training_range=ranges,
        records=tuple(
            {"name": r.name, "source": Path(r.source).name, "sha256": r.digest, "part": [p.start, p.stop]}
            for r, p in zip(records, parts, strict=True)
        ),
        scores={item.name: scores_of(fitted.system, item, rig).content for item in experiments},
        fit={
            "options": dict(context.options),
            "relative_error": fitted.relative_error,
            "seconds": round(fitted.seconds, 3),
            "evaluations": fitted.evaluations,
            "seed": context.seed,
            **({"block_spread": dict(zip(fitted.names, fitted.block_spread.tolist(), strict=True))} if spread else {}),
            **training_notes(rig, fitted, context.options, experiments, ranges, leave_out=leave_out),
            **fitted.notes,
            **({} if fitted.chi_squared is None else {"chi_squared": fitted.chi_squared}),
            **({"groups": [group.content for group in known_together]} if known_together else {}),
        },
    )


def _by_training(
    records: Sequence[Record], rig: Rig, structure: str, sampling: Sampling, given: Mapping[str, Any]
) -> Model:
    """The model whose inputs are taken as the records show them: held, unless they are band-limited, and lines between
    their samples explain the outputs better. The samples alone can't tell a held input from an interpolated one.
    """
    held = identify(records, rig, structure, sampling=replace(sampling, input="averaged"), **given)
    if handling_of(records, sampling) == "averaged":
        return held
    joined = identify(records, rig, structure, sampling=replace(sampling, input="interpolated"), **given)
    tried = {model.sampling.input: float(model.fit["relative_error"]) for model in (held, joined)}
    found = joined if joined.fit["relative_error"] < BETTER * held.fit["relative_error"] else held
    return replace(found, fit={**found.fit, "inputs_tried": tried})


def _refined(context: Context, fitted: Fit) -> tuple[Context, Fit]:
    """The fit at a finer step where its step moves a parameter too far, and the context with that step; one of a system
    that sticks is searched again from both sides. A stabiliser acts at each step, which then is the loop's.
    """
    if context.unstable is not None:
        return context, fitted
    windows = None if fitted.chi_squared is None else context.windows(fitted.system)
    for least in REFINED[: 1 if windows is None else None]:
        refined = _finer(context) if _moved(fitted) > least else context
        if refined is context and not (fitted.system.contacts and least == REFINED[0]):
            break
        held = [item.name for item in fitted.system.parameters if not item.fixed and item.name not in fitted.names]
        given: dict[str, Any] = {"stages": (None,), "hold": held, "starts": 1, "again": True, "unstable": windows}
        found = refined.fit_physics([fitted.system], **given)
        if found.relative_error > max(WORSE * fitted.relative_error, LOST):
            break  # runs past an unstable point: at another step they end elsewhere
        seconds, evaluations = fitted.seconds + found.seconds, fitted.evaluations + found.evaluations
        context, fitted = refined, replace(found, seconds=seconds, evaluations=evaluations)
    return context, fitted


def _moved(fitted: Fit) -> float:
    """How far the step moves a parameter at most, in the rest of its standard error."""
    variances = np.diag(fitted.covariance)[: len(fitted.step_error)]
    rest = np.sqrt(np.maximum(variances - fitted.step_error**2, 1e-300))
    return float(np.max(np.abs(fitted.step_error) / rest, initial=0.0))


def _finer(context: Context) -> Context:
    """The context at the first finer step that fits the records' sampling, or at its own."""
    for parts in FINER:
        try:
            sampling = replace(context.sampling, step=context.sampling.step / parts)
            resampled = [checked(record, context.rig, sampling) for record in context.records]
        except UserError:
            continue
        return replace(context, sampling=sampling, resampled=resampled)
    return context


def scores_of(system: System, experiment: PreparedRecord, rig: Rig) -> Scores:
    """Scores of the strict free run, or for an unstable rig of one run in closed loop with its stabiliser, or where
    none is known, of predictions over the shortest horizon.

    Raises UserError for a stabiliser that does not fit the sampling.
    """
    stabiliser = rig.experiments.stabiliser
    if stabiliser is None:
        ahead = [] if has_free_run(system, experiment) else predictions(system, experiment, None)
        return ahead[0].scores if ahead else score_free_run(system, experiment)
    names = [item.name for item in system.outputs]
    return Scores.of(names, experiment.outputs, stabilised_run(system, experiment, stabiliser)[1])


def _ranges(rig: Rig, experiments: Sequence[PreparedRecord]) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each state and input of a rig, by name."""
    columns = [
        *zip(rig.system.states, np.concatenate([item.states for item in experiments]).T, strict=True),
        *zip(rig.system.inputs, np.concatenate([item.inputs for item in experiments]).T, strict=True),
    ]
    return {variable.name: (float(column.min()), float(column.max())) for variable, column in columns}


def training_notes(
    rig: Rig,
    fitted: Fit | Model,
    options: Mapping[str, Any],
    experiments: Sequence[PreparedRecord],
    ranges: Mapping[str, tuple[float, float]],
    *,
    leave_out: bool,
) -> dict[str, Any]:
    """What bands need to know, but of an unstable rig, which has no free runs, and what extensions note of the training
    records, by name. leave_out: with fits without each of these.
    """
    system, blocks, made = fitted.system, list[LeftOut](), dict[str, Any]()
    if rig.experiments.stabiliser is None and all(has_free_run(system, item) for item in experiments):
        deviations = np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0)).tolist()
        if leave_out:
            known = dict(zip(fitted.names, deviations, strict=True))
            blocks = left_out(system, experiments, known, float(options.get("ridge", 1.0)))
        # An older model does not say how many numbers the data determined: at most all.
        effective = fitted.effective if isinstance(fitted, Fit) else float(len(deviations) + len(system.weights))
        spans = np.array([np.ptp(ranges[item.name]) for item in rig.system.inputs])
        given = Uncertainty(names=fitted.names, covariance=fitted.covariance, effective=effective, spans=spans)
        made["bands"] = band_calibration(system, experiments, given, blocks)
    made |= {name: note(system, experiments, blocks) for name, note in provided("training_notes").items()}
    return {name: note for name, note in made.items() if note}


def checked(record: Record, rig: Rig, sampling: Sampling) -> ResampledRecord:
    """A record at a sampling. Raises UserError where an input or output is constant or leaves the rig's range, naming
    the channel, and where :func:`~.experiment.resample` does.
    """
    for column, variable in enumerate(rig.system.inputs):
        if column < record.input.shape[1] and np.ptp(record.input[:, column]) == 0.0:
            raise UserError(f"{record.name}: input {variable.name} is constant: no excitation; leave the record out")
    for column, variable in enumerate(rig.system.outputs):
        if column < record.output.shape[1] and np.ptp(record.output[:, column]) == 0.0:
            raise UserError(
                f"{record.name}: output {variable.name} is constant, so it can't be scored; leave the record out"
            )
    delays, windows = (np.array([getattr(item, key) for item in rig.sensors]) for key in ("delay", "window"))
    resampled = replace(resample(record, sampling), lag=delays + 0.5 * windows, windows=windows)
    experiment = resampled.experiment(rig.system)
    check_range(experiment, rig.system)
    check_valid(rig, experiment.states, record.name)
    return resampled


def evaluate(model: Model, record: Record, *, part: Part = Part()) -> Scores:
    """Strict free run of a model on (a part of) a record, scored on the raw output.

    Raises UserError where the record does not fit the model's sampling, and UnstableError where an open free run is
    meaningless.
    """
    experiment = experiment_of(model, record, part=part)
    check_free_run(model.system, experiment)
    return score_free_run(model.system, experiment)


def experiment_of(model: Model, record: Record, *, part: Part = Part()) -> PreparedRecord:
    """A record that is prepared for a model, at the model's sampling."""
    return prepare(part.of(record, model.sampling), model.system, model.sampling)
