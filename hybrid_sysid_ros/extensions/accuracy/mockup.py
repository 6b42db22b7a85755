"""Mock-up: what is known beforehand, experiments, a model, shots, a controller over many plants, and a verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.control.safety.certificate import binomial_bound
from hybrid_sysid_ros.control.scenarios import plant_near
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.accuracy.monte_carlo_runs import MonteCarloRuns, Range
from hybrid_sysid_ros.extensions.accuracy.statistics import Accuracy, Discrepancy, assess, fewest
from hybrid_sysid_ros.identification import Part, identify
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.shooting import unstable_settings
from hybrid_sysid_ros.identification.validation.scores import score_free_run
from hybrid_sysid_ros.identification.validation.unstable import UnstableError, check_free_run, predictions
from hybrid_sysid_ros.models import Model, build
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.structure import structure_of
from hybrid_sysid_ros.rigs.experiments import simulate_experiment
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.demo_recipe import DemoRecipe
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.progress import Report
from hybrid_sysid_ros.support.structured import named_numbers, numbers, refuse_unknown, section

KEYS = ("learn", "part", "test", "seconds", "rate", "structure", "options", "tolerance")
"""Of the section mockup of rig.yaml."""
CONFIDENCE = 0.99
"""Of the bound on the share of plants that are kept."""
CLOSE = 0.95
"""Share of the misses that the tolerance must hold."""
SECONDS = 1.0, 86_400.0
"""Of an experiment."""
SLOWEST = 1.0
"""Samples of an experiment a second."""

Fire = Callable[[Range, int, str], MonteCarloRuns]
"""fire(where, count, name)"""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is to be done."""

    rig: Rig
    reality: System
    """What the rig is, and nobody in the mock-up knows."""
    plan: DemoRecipe
    """How the rig's demo identifies, and which reference it follows."""
    learn: tuple[str, ...]
    """Experiments to learn from."""
    part: Part
    """Of each of these."""
    test: tuple[str, ...]
    """Experiments to test the models on."""
    seconds: float
    """Of each."""
    rate: float
    """Of their samples [Hz]."""
    tolerance: Mapping[str, float]
    """Of misses, by the name of a window of the reference, as its output is shown."""
    seed: int

    @classmethod
    def of(cls, rig: Rig, seed: int = 0) -> Setup:
        """By the sections demo and mockup of a rig's file; without the latter all experiments but the last are learnt
        from. What the rig really is, is drawn by the seed: its system with each free physical parameter moved by the
        deviation of policy_training. Raises UserError for what is not there.
        """
        plan, where = DemoRecipe.of(rig), f"{rig.file}: mockup"
        given = section(rig.content, "mockup", str(rig.file))
        refuse_unknown(given, KEYS, where)
        if "options" in given and "structure" not in given:
            raise UserError(f"{where}.options: belong to a structure: name one beside them")
        if "structure" in given:
            plan = replace(plan, structure=str(given["structure"]), options=named_numbers(given, "options", where))
        known = list(rig.experiments.excitations)
        if len(known) < 2:
            raise UserError(f"{rig.file}: experiments.excitations: needs two at least, one of them to test on")
        windows = rig.schedule(plan.reference).windows
        tolerance = named_numbers(given, "tolerance", where)
        for name in tolerance:
            if name not in windows:
                raise UserError(f"{where}.tolerance: {plan.reference} has no part {name}: it has {', '.join(windows)}")
            if not tolerance[name] > 0.0:
                raise UserError(f"{where}.tolerance.{name} is {tolerance[name]:g}: it needs to be above 0")
        learn, test = (
            _chosen(given, key, usual, known, where) for key, usual in (("learn", known[:-1]), ("test", known[-1:]))
        )
        if {*learn} & {*test}:
            both = ", ".join(sorted({*learn} & {*test}))
            raise UserError(f"{where}: {both} can't be in both learn and test: keep some that no fit sees")
        rate = _number(given, "rate", 1.0 / plan.sampling.step, (SLOWEST, 1.0 / rig.step), where)
        rig.steps(1.0 / rate, f"{where}.rate {rate:g} Hz: its period")
        return cls(
            rig=rig,
            reality=plant_near(rig.system, configuration.spread_of(rig).parameters, np.random.default_rng(seed)),
            plan=plan,
            learn=learn,
            part=Part.parse(str(given.get("part", "0:1"))),
            test=test,
            seconds=_number(given, "seconds", 40.0, SECONDS, where),
            rate=rate,
            tolerance=tolerance,
            seed=seed,
        )


def _chosen(
    given: Mapping[str, Any], key: str, usual: Sequence[str], known: Sequence[str], where: str
) -> tuple[str, ...]:
    """Names of experiments."""
    found = given.get(key, list(usual))
    if not isinstance(found, list) or not found or not all(name in known for name in found):
        raise UserError(f"{where}.{key} is {found!r}: it needs a list of experiments: {', '.join(known)}")
    return tuple(found)


def _number(given: Mapping[str, Any], key: str, usual: float, within: tuple[float, float], where: str) -> float:
    found = numbers(given.get(key, usual), f"{where}.{key}", count=1)[0]
    if not within[0] <= found <= within[1]:
        raise UserError(f"{where}.{key} is {found:g}: it needs {within[0]:g} to {within[1]:g}")
    return found


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """A line of the verdict."""

    name: str
    kept: bool
    words: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """All that a mock-up comes to."""

    setup: Setup
    models: Mapping[str, Model]
    """prior, gray box and structure, by what the page calls them."""
    errors: Mapping[str, Mapping[str, Mapping[str, float]]]
    """By model, record and output: errors over unseen experiments, as the output is shown."""
    ahead: str
    """What these errors are of."""
    runs: Mapping[str, MonteCarloRuns]
    """prior, simulated, live and uncertain shots."""
    loop: ClosedLoop
    """The first of the live ones."""
    accuracy: Accuracy
    verdict: Sequence[Criterion]


def mockup(
    setup: Setup, out: Path, fire: Fire, counts: Mapping[str, int], discrepancy: Discrepancy, tell: Report = print
) -> Found:
    """The workflow; models that an earlier run left in the folder ``out`` are not made again.

    fire: fires shots. counts: of live and simulated ones and of plants. tell: gets a line at each step.

    Raises UserError as its parts do.
    """
    rig, plan = setup.rig, setup.plan
    schedule, box = rig.schedule(plan.reference), _box(setup)
    least = fewest(len(schedule.windows))
    for name in ("live", "simulated"):
        if counts[name] < least:
            raise UserError(f"--{name} {counts[name]}: the parts of {schedule.name} need {least} shots at least")
    prior = prior_of(setup, box)
    given: dict[str, Any] = {"rig": rig, "schedule": schedule}
    runs: dict[str, MonteCarloRuns] = {}
    tell(f"1 simulating {schedule.name} with what is known of {rig.name} beforehand")
    before = Range(model=prior, seed=setup.seed, predicted=True, **given)
    runs["prior"] = fire(before, counts["simulated"], "shots of the prior")
    tell(f"2 driving experiments: {', '.join((*setup.learn, *setup.test))}, {setup.seconds:g} s each")
    learnt, kept = (records_of(setup, names, out / "bags") for names in (setup.learn, setup.test))
    tell(f"3 identifying {' and '.join(dict.fromkeys((box, plan.structure)))} from {len(learnt)} bags")
    models = {"prior": prior}
    for structure in dict.fromkeys((box, plan.structure)):
        models[structure] = identified(setup, structure, learnt, out / structure)
    model = models[plan.structure]
    errors, ahead = tested(setup, models, kept)
    tell("4 firing shots of the model and of the rig")
    simulated = Range(model=model, seed=setup.seed + 1, predicted=True, **given)
    runs["simulated"] = fire(simulated, counts["simulated"], "shots of the model")
    real = Range(model=model, seed=setup.seed + 2, reality=setup.reality, **given)
    runs["live"] = fire(real, counts["live"], "shots of the rig")
    accuracy = assess(runs["simulated"].shots("simulated"), runs["live"].shots("live"), discrepancy, seed=setup.seed)
    tell(f"5 closing the loop on {counts['plants']} plants that the identification does not tell apart")
    doubted = Range(model=model, seed=setup.seed + 3, doubted=True, **given)
    runs["uncertain"] = fire(doubted, counts["plants"], "uncertain plants")
    loop, _ = real.fire(0, real.controller())
    found = Found(
        setup=setup,
        models=models,
        errors=errors,
        ahead=ahead,
        runs=runs,
        loop=loop,
        accuracy=accuracy,
        verdict=(),
    )
    return replace(found, verdict=tuple(judged(found)))


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
                ahead = f"{last.seconds:g} s ahead{held}"
            each = scores.outputs or {names[0]: scores}
            shown = zip(names, setup.rig.display, strict=True)
            found[called][record.name] = {name: float(display.shown(each[name].rmse)) for name, display in shown}
    return found, ahead


def judged(found: Found) -> Iterator[Criterion]:
    """The verdict's lines."""
    yield _predicts(found)
    contradictions, conflict = found.accuracy.contradictions, found.accuracy.conflict
    yield Criterion(
        name="shots of the rig do not contradict those of the model",
        kept=not contradictions,
        words="; ".join(contradictions) or f"p {conflict.mean:.2g} (mean), {conflict.spread:.2g} (spread)",
    )
    for runs, who in ((found.runs["live"], "the rig"), (found.runs["uncertain"], "every uncertain plant")):
        yield _holds(runs, who)
        for window, most in found.setup.tolerance.items():
            yield _ends(runs, window, most, who)


def _predicts(found: Found) -> Criterion:
    before, after = found.errors["prior"], found.errors[found.setup.plan.structure]
    ratios = [after[record][name] / before[record][name] for record in before for name in before[record]]
    share = math.exp(float(np.mean(np.log(np.maximum(ratios, 1e-12)))))
    return Criterion(
        name="the model predicts better than what was known beforehand",
        kept=share < 1.0,
        words=f"errors {share:.3g} times the prior's ({found.ahead}, unseen experiments, geometric mean)",
    )


def _holds(runs: MonteCarloRuns, who: str) -> Criterion:
    kept, count = int(runs.sound.all(axis=1).sum()), len(runs.sound)
    bound = binomial_bound(kept, count, 1.0 - CONFIDENCE)
    return Criterion(
        name=f"{who} is held, within its travel and validity",
        kept=kept == count,
        words=f"{kept} of {count}: a share of {bound:.3f} at least, with a confidence of {100 * CONFIDENCE:g} %",
    )


def _ends(runs: MonteCarloRuns, window: str, most: float, who: str) -> Criterion:
    names = list(runs.windows)
    unit, tracking_errors = runs.windows[window], np.abs(runs.tracking_error[:, names.index(window)])
    tracking_error = float(np.quantile(tracking_errors, CLOSE))
    return Criterion(
        name=f"{window} ends within {most:g} {unit}: {who}",
        kept=tracking_error <= most,
        words=f"{100 * CLOSE:g} % within {tracking_error:.3g} {unit}",
    )
