"""Mock-up: what is known beforehand, experiments, a model, shots, a controller over many plants, and a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.accuracy.monte_carlo_runs import MonteCarloRuns, Range, recorded_runs
from hybrid_sysid_ros.extensions.accuracy.setup import Setup
from hybrid_sysid_ros.extensions.accuracy.statistics import (
    Discrepancy,
    ShotComparison,
    assess,
    compare,
    fewest,
)
from hybrid_sysid_ros.extensions.accuracy.verdict import Found, judged
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.shooting import unstable_settings
from hybrid_sysid_ros.identification.validation.scores import score_free_run
from hybrid_sysid_ros.identification.validation.unstable import UnstableError, check_free_run, predictions
from hybrid_sysid_ros.models import Model, build
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.structure import structure_of
from hybrid_sysid_ros.rigs.experiments import simulate_experiment
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import defaults
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.progress import Report

AGAINST = ("prior", "simulated")
"""Shots that live ones are compared with."""

Fire = Callable[[Range, int, str], MonteCarloRuns]
"""fire(where, count, name)"""


@dataclass(frozen=True, kw_only=True)
class ShotPlan:
    """What is fired, and how it is judged."""

    live: int
    simulated: int
    plants: int
    discrepancy: Discrepancy
    matters: float = 0.1
    """Share of an RMSE, a peak, a settling time or a path that a difference needs to matter."""
    fleet: bool = False
    """Whether each shot is of another plant."""
    recorded: Sequence[LoopRecord] = ()
    """Loops of the real rig, in place of live shots."""
    model: Model | None = None
    """Of the real rig, in place of experiments and identification."""


def mockup(setup: Setup, out: Path, fire: Fire, shooting: ShotPlan, tell: Report = print) -> Found:
    """The workflow; models that an earlier run left in the folder ``out`` are not made again.

    fire: fires shots. tell: gets a line at each step.

    Raises UserError as its parts do.
    """
    rig, plan = setup.rig, setup.plan
    schedule, box = rig.schedule(plan.reference), _box(setup)
    least, live = fewest(len(schedule.windows)), len(shooting.recorded) or shooting.live
    for name, count in (
        ("live-bags" if shooting.recorded else "live", live),
        ("simulated", shooting.simulated),
    ):
        if count < least:
            raise UserError(f"--{name}: {count} shots, but the parts of {schedule.name} need {least} at least")
    prior = prior_of(setup, box)
    given: dict[str, Any] = {"rig": rig, "schedule": schedule}
    shots: dict[str, Any] = {**given, "fleet": shooting.fleet, "latency": latency_of(rig, shooting.recorded)}
    runs: dict[str, MonteCarloRuns] = {}
    models: dict[str, Model] = {"prior": prior}
    errors: dict[str, dict[str, dict[str, float]]] = {}
    ahead = ""
    if shooting.model is not None:
        tell(f"1 taking the model of {shooting.model.structure}, without experiments")
        model = models[shooting.model.structure] = shooting.model
    else:
        tell(f"1 driving experiments: {', '.join((*setup.learn, *setup.test))}, {setup.seconds:g} s each")
        learnt, kept = (records_of(setup, names, out / "bags") for names in (setup.learn, setup.test))
        tell(f"2 identifying {' and '.join(dict.fromkeys((box, plan.structure)))} from {len(learnt)} bags")
        for structure in dict.fromkeys((box, plan.structure)):
            models[structure] = identified(setup, structure, learnt, out / structure)
        model = models[plan.structure]
        errors, ahead = tested(setup, models, kept)
    whose = "the prior and of the model" if shooting.recorded else "the prior, of the model and of the rig"
    tell(f"3 firing shots of {whose}, under the controller of the model")
    as_prior = Range(model=model, seed=setup.seed, predicted=True, stand_in=prior.system, **shots)
    runs["prior"] = fire(as_prior, shooting.simulated, "shots of the prior")
    simulated = Range(model=model, seed=setup.seed + 1, predicted=True, **shots)
    runs["simulated"] = fire(simulated, shooting.simulated, "shots of the model")
    real = Range(model=model, seed=setup.seed + 2, reality=setup.reality, **shots)
    if shooting.recorded:
        runs["live"] = recorded_runs(real, shooting.recorded)
    else:
        runs["live"] = fire(real, shooting.live, "shots of the rig")
    accuracy = assess(
        runs["simulated"].shots("simulated"), runs["live"].shots("live"), shooting.discrepancy, seed=setup.seed
    )
    tell(f"4 closing the loop on {shooting.plants} plants that the identification does not tell apart")
    doubted = Range(model=model, seed=setup.seed + 3, doubted=True, **shots)
    runs["uncertain"] = fire(doubted, shooting.plants, "uncertain plants")
    found = Found(
        setup=setup,
        models=models,
        errors=errors,
        ahead=ahead,
        runs=runs,
        loop=shooting.recorded[0] if shooting.recorded else real.fire(0, real.loop())[0],
        accuracy=accuracy,
        compared={name: compared(runs[name], runs["live"], setup.seed, shooting.matters) for name in AGAINST},
        verdict=(),
    )
    return replace(found, verdict=tuple(judged(found)))


def compared(
    simulated: MonteCarloRuns, live: MonteCarloRuns, seed: int, matters: float
) -> dict[str, Sequence[ShotComparison]]:
    """Live shots against simulated ones, by what their quantities are of."""
    ours, theirs = simulated.quantities(), live.quantities()
    found = iter(
        compare(
            [item for items in ours.values() for item in items],
            [item for items in theirs.values() for item in items],
            np.random.default_rng(seed),
            matters=matters,
        )
    )
    return {of: [next(found) for _ in items] for of, items in theirs.items()}


def latency_of(rig: Rig, loops: Sequence[LoopRecord]) -> float | None:
    """Time from a reading to its command in recorded loops [s]: the nodes' parameter, 0 in lockstep; None for none."""
    if not loops:
        return None
    return float(defaults(rig, "controller")["latency"]) if any(loop.is_real_time for loop in loops) else 0.0


def _box(setup: Setup) -> str:
    """The gray box that the structure stands on; the rig's own where it stands on none."""
    return structure_of(setup.plan.structure, setup.rig.system, setup.rig.structures).box or "gray"


def prior_of(setup: Setup, box: str) -> Model:
    """The gray box where a fit of it would begin."""
    rig = setup.rig
    sizes = np.ones(len(rig.system.declared_states) + len(rig.system.inputs))
    system, _ = build(box, rig.system, scales=sizes, seed=setup.seed, boxes=rig.structures)
    return Model(
        rig=rig.name,
        place="" if rig.source == rig.name else rig.source,
        structure=box,
        system=system,
        sampling=setup.plan.sampling,
        names=(),
        covariance=np.zeros((0, 0)),
        training_range={},
    )


def records_of(setup: Setup, names: Sequence[str], folder: Path) -> list[Record]:
    """Experiments driven on the rig, as bags in a folder, each with a seed of its own."""
    known, found = list(setup.rig.experiments.excitations), []
    real = replace(setup.rig, system=setup.reality)
    for name in names:
        place, seed = folder / name, setup.seed + known.index(name)
        simulate_experiment(real, name, place, seed=seed, duration=setup.seconds, rate=setup.rate, overwrite=True)
        found.append(bags.read(place, setup.rig.signals))
    return found


def identified(setup: Setup, structure: str, records: Sequence[Record], folder: Path) -> Model:
    """The model of a folder, where that is one of these records, else a new one."""
    options = dict(setup.plan.options) if structure == setup.plan.structure else {}
    given: dict[str, Any] = {"sampling": setup.plan.sampling, "options": options, "seed": setup.seed}
    there = _there(setup, structure, records, folder, options)
    if there is not None:
        return there
    identify(records, setup.rig, structure, part=setup.part, **given).save(folder)
    return load_model(folder, rig=setup.rig.source)


def _there(
    setup: Setup, structure: str, records: Sequence[Record], folder: Path, options: Mapping[str, float]
) -> Model | None:
    try:
        model = load_model(folder, rig=setup.rig.source)
    except UserError:
        return None
    part = [setup.part.start, setup.part.stop]
    learnt = [(entry["sha256"], entry["part"]) for entry in model.records]
    same = learnt == [(record.digest, part) for record in records]
    same = same and model.structure == structure and model.sampling == setup.plan.sampling
    same = same and model.fit["seed"] == setup.seed
    return model if same and all(model.fit["options"].get(name) == value for name, value in options.items()) else None


def tested(
    setup: Setup, models: Mapping[str, Model], records: Sequence[Record]
) -> tuple[dict[str, dict[str, dict[str, float]]], str]:
    """Errors of models over experiments that none has seen: of the free run, and where that says nothing of the
    longest prediction; and which of them it is.
    """
    windows, names = unstable_settings(setup.rig), [item.name for item in setup.rig.system.outputs]
    found: dict[str, dict[str, dict[str, float]]] = {}
    ahead = "free run"
    for called, model in models.items():
        found[called] = {}
        for record in records:
            experiment = experiment_of(model, record)
            try:
                check_free_run(model.system, experiment)
                scores = score_free_run(model.system, experiment)
            except UnstableError:
                if windows is None:
                    raise
                last = predictions(model.system, experiment, windows)[-1]
                scores, held = last.scores, ", held by the stabiliser" if last.closed else ""
                ahead = f"{last.seconds:.3g} s ahead{held}"
            each = scores.outputs or {names[0]: scores}
            shown = zip(names, setup.rig.display, strict=True)
            found[called][record.name] = {name: float(display.shown(each[name].rmse)) for name, display in shown}
    return found, ahead
