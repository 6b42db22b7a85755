"""Sections: the content of a report, as data without figures."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Variable, rollouts
from hybrid_sysid_ros.extensions.shared import residual_tests
from hybrid_sysid_ros.extensions.shared.horizons import HorizonErrors, k_step_errors
from hybrid_sysid_ros.extensions.shared.resimulation import Resimulation, resimulate
from hybrid_sysid_ros.identification import Part, Scores, score
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.identification.validation.bands import bands_of
from hybrid_sysid_ros.identification.validation.identifiability import Doubt, correlated, doubts
from hybrid_sysid_ros.identification.validation.unstable import stabilised_run
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.sensor import Display
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

TESTS = {
    "phi_ee": "e · e",
    "phi_ue": "e · u",
    "phi_re": "e · r",
    "phi_e(es)": "e · e s",
    "phi_(s^2)'e": "e · s²",
    "phi_(s^2)'e^2": "e² · s²",
}
"""Titles of the residual tests: residual e, input u, reference r, and s, the reference where there is one, else u."""
FREE, HELD = "free run", "run under the stabiliser"


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeRunSection:
    """One output of a model's free run over a record, or a part of it; SI units."""

    name: str
    """Its name in tables and figures."""
    record: str
    output: Variable
    display: Display
    digest: str
    part: Part
    seen: bool | None
    """Whether this part overlaps with the model's training data; None where hashes are missing."""
    scores: Scores
    """Scores of the scored samples."""
    time: Array
    """Times of the record, (samples,) [s]."""
    measured: Array
    """(samples,)."""
    simulated_time: Array
    """Times of the free run at its integration step, (steps,) [s]."""
    simulated: Array
    """(steps,)."""
    residual_time: Array
    """(scored samples,) [s]."""
    residuals: Array
    """Measured minus simulated, (scored samples,)."""
    tests: Mapping[str, residual_tests.ResidualTest]
    """Residual tests by the keys of the section's tests; empty where there is nothing to test."""
    horizons: HorizonErrors
    """Errors over the horizon."""
    again: Resimulation | None
    """The re-simulated experiment in closed loop, if any."""
    skipped: str
    """Why it was not re-simulated."""
    bands: Mapping[float, Array] = field(default_factory=dict)
    """Half of the width of the run's bands at the scored samples, (scored samples,), by level."""
    kind: str = FREE
    """Kind of the run: free, or under the stabiliser of an unstable rig."""


@dataclass(frozen=True, kw_only=True)
class IdentificationSection:
    """A model and its free runs, a run for each output of each record."""

    model: Model
    runs: Sequence[FreeRunSection]

    @property
    def correlated(self) -> list[tuple[str, str, float]]:
        """Pairs of physical parameters with highly correlated estimates, largest first: names and coefficient."""
        physical = self.model.standard_errors
        pairs = correlated(self.model.names, self.model.covariance)
        return [pair for pair in pairs if pair[0] in physical and pair[1] in physical]

    @property
    def doubts(self) -> list[Doubt]:
        """Parameters that the data don't determine."""
        return doubts(self.model)

    @property
    def tests(self) -> dict[str, str]:
        """Titles of the residual tests that some run has, by their keys."""
        known = {**TESTS, **{_further(item.name): f"e · {item.name}" for item in self.model.system.inputs[1:]}}
        return {key: title for key, title in known.items() if any(key in run.tests for run in self.runs)}


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Provenance of a report: command, hashes and versions by name."""

    command: str
    hashes: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)


def identification_section(model: Model, records: Iterable[tuple[Record, Part]]) -> IdentificationSection:
    """Free runs of a model over (parts of) records.

    Raises UserError where a record does not fit the model's sampling.
    """
    runs = tuple(run for record, part in records for run in free_runs_of(model, record, part))
    return IdentificationSection(model=model, runs=runs)


def free_runs_of(model: Model, record: Record, part: Part) -> list[FreeRunSection]:
    """The outputs of a model's free run over a part of a record, scored and tested; for an unstable rig the run is in
    closed loop with its stabiliser.

    Raises UserError where the record does not fit the model's sampling.
    """
    system, sampling, rig = model.system, model.sampling, rigs.load(model.rig)
    experiment, used = experiment_of(model, record, part=part), part.of(record, model.sampling)
    stabiliser = rig.experiments.stabiliser
    if stabiliser is None:
        starts = np.array([[0, 0, 1 + len(experiment.inputs), 0]])
        first = initial_state(system, experiment)[None]
        states, simulated = rollouts(system, starts, first, experiment.inputs, step=sampling.step)
    else:
        states, simulated = stabilised_run(system, experiment, stabiliser)
    run = states[:: sampling.every], simulated[:: sampling.every]
    whole = run[1]
    residuals, scored = experiment.outputs - whole, experiment.scored
    inputs = experiment.inputs.reshape(-1, sampling.every, len(system.inputs)).mean(axis=1)
    stride = round(sampling.period / used.sampling_time)
    again: Resimulation | None = None
    skipped = ""
    try:
        again = resimulate(system, record, rig, sampling=sampling, part=part)
    except UserError as error:
        skipped = str(error)
    names = [item.name for item in system.inputs]
    bands = bands_of(model, experiment) if stabiliser is None else []
    found = []
    for k, output in enumerate(system.outputs):
        name = record.name if len(system.outputs) == 1 else f"{record.name}, {output.name}"
        reference = used.channels.get(rig.channel("reference", output.name))
        found.append(
            FreeRunSection(
                name=name,
                record=record.name,
                output=output,
                display=rig.display[k],
                digest=record.digest,
                part=part,
                seen=model.was_trained_on(record.digest, part.start, part.stop),
                scores=score(experiment.outputs[scored, k], whole[scored, k]),
                time=used.time,
                measured=used.output[:, k],
                simulated_time=np.asarray(sampling.step * np.arange(len(simulated))),
                simulated=simulated[:, k],
                residual_time=np.asarray(sampling.period * np.arange(experiment.samples)),
                residuals=residuals[:, k],
                tests=_tests(residuals[:-1, k], inputs, names, None if reference is None else reference[::stride]),
                horizons=replace(k_step_errors(system, experiment, output=k, run=run), name=name),
                again=again if k == 0 else None,
                skipped=skipped,
                bands={band.level: band.half[:, k] for band in bands},
                kind=FREE if stabiliser is None else HELD,
            )
        )
    return found


def provenance(model: Model, command: str, *, hashes: Mapping[str, str] | None = None) -> Provenance:
    """Provenance of a report on a model: its command, and the hashes of model and training records.

    hashes: further hashes by name.
    """
    found = {"model": model.seal}
    for entry in model.records:
        start, stop = entry.get("part", (0.0, 1.0))
        found[f"training, {entry.get('name', '?')} {start:g} to {stop:g}"] = str(entry.get("sha256", ""))
    known = {**versions(), "Python": platform.python_version(), "system": f"{platform.system()} {platform.machine()}"}
    return Provenance(command=command, hashes={**found, **(hashes or {})}, versions=known)


def _further(name: str) -> str:
    """Key of the test against an input that is not the first."""
    return f"phi_ue {name}"


def _tests(
    residuals: Array, inputs: Array, names: Sequence[str], reference: Array | None
) -> dict[str, residual_tests.ResidualTest]:
    """Residual tests of residuals (samples,) against inputs (samples, m) by their names and a reference (samples,).

    Signals are at least as long; constant and unknown ones are left out. The first input is u.
    """
    length = len(residuals)
    signals = {"phi_ue": inputs[:length, 0], "phi_re": np.zeros(0) if reference is None else reference[:length]}
    signals = {key: signal for key, signal in signals.items() if len(signal) == length and _varies(signal)}
    if not signals or not _varies(residuals):
        return {}
    lags = max(1, min(residual_tests.LAGS, length // 4))
    *_, (last, exogenous) = signals.items()
    tests = {
        key.replace("u", "s"): test
        for key, test in residual_tests.correlation_tests(residuals, exogenous, lags=lags).items()
    }
    tests[last] = tests.pop("phi_se")
    if last != "phi_ue" and "phi_ue" in signals:
        tests["phi_ue"] = residual_tests.independence(residuals, signals["phi_ue"], lags=lags)
    for k, name in enumerate(names[1:], start=1):
        if _varies(inputs[:length, k]):
            tests[_further(name)] = residual_tests.independence(residuals, inputs[:length, k], lags=lags)
    return tests


def _varies(values: Array) -> bool:
    return bool(np.isfinite(values).all() and np.ptp(values) > 1e-9 * max(1.0, float(np.max(np.abs(values)))))
