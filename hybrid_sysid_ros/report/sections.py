"""Sections: what a report tells, worked out; nothing here draws."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import rollouts
from hybrid_sysid_ros.identification import Part, Scores, score
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.validation.horizons import HorizonErrors, k_step_errors
from hybrid_sysid_ros.identification.validation.identifiability import Doubt, correlated, doubts
from hybrid_sysid_ros.identification.validation.residual_tests import (
    LAGS,
    ResidualTest,
    correlation_tests,
    independence,
)
from hybrid_sysid_ros.identification.validation.resimulation import Resimulation, resimulations
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import Display
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

Array = NDArray[np.float64]

TESTS = {
    "phi_ee": "e · e",
    "phi_ue": "e · u",
    "phi_re": "e · r",
    "phi_e(es)": "e · e s",
    "phi_(s^2)'e": "e · s²",
    "phi_(s^2)'e^2": "e² · s²",
}
"""Titles of the residual tests: residual e, input u, reference r, and s, the reference where there is one, else u."""
SAME_REFERENCE = 1e-3  # V, median distance of a loop's reference from the hardware run's
Window = tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeRun:
    """A model's free run over a record, or a part of it.

    seen: this part overlaps with the model's training data; None where hashes are missing to tell. scores: of the
    scored samples [rad]. time [s], measured [rad] (samples,): the record. simulated_time, simulated (steps,): the free
    run at its integration step. residual_time, residuals (scored samples,) [rad]: measured minus simulated. tests:
    residual tests by the keys of TESTS, none where there is nothing to test. horizons: errors over the horizon [rad].
    again: the experiment done again in closed loop, or else skipped: why not.
    """

    name: str
    digest: str
    part: Part
    seen: bool | None
    scores: Scores
    time: Array
    measured: Array
    simulated_time: Array
    simulated: Array
    residual_time: Array
    residuals: Array
    tests: Mapping[str, ResidualTest]
    horizons: HorizonErrors
    again: Resimulation | None
    skipped: str


@dataclass(frozen=True, kw_only=True)
class IdentificationSection:
    """A model and its free runs."""

    model: Model
    display: Display
    runs: Sequence[FreeRun]

    @property
    def correlated(self) -> list[tuple[str, str, float]]:
        """Pairs of physical parameters whose estimates are highly correlated, most first: names and coefficient."""
        physical = self.model.standard_errors
        pairs = correlated(self.model.names, self.model.covariance)
        return [pair for pair in pairs if pair[0] in physical and pair[1] in physical]

    @property
    def doubts(self) -> list[Doubt]:
        """What the data don't determine."""
        return doubts(self.model)

    @property
    def tests(self) -> dict[str, str]:
        """Titles of the residual tests that some run has, by their keys."""
        return {key: title for key, title in TESTS.items() if any(key in run.tests for run in self.runs)}


@dataclass(frozen=True, kw_only=True)
class ClosedLoopSection:
    """A recorded loop; windows: where tracking is judged, zooms: what is shown larger, by name, from and to [s]."""

    loop: LoopRecord
    windows: Mapping[str, Window] = field(default_factory=dict)
    zooms: Mapping[str, Window] = field(default_factory=dict)

    @property
    def rig(self) -> Rig:
        """The rig in the loop."""
        return self.loop.rig


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Where a report comes from; hashes and versions by name."""

    command: str
    hashes: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)


def identification_section(model: Model, records: Iterable[tuple[Record, Part]]) -> IdentificationSection:
    """Free runs of a model over (parts of) records.

    Raises:
        UserError: a record does not fit the model's sampling.
    """
    runs = tuple(free_run_of(model, record, part) for record, part in records)
    return IdentificationSection(model=model, display=rigs.load(model.rig).display[0], runs=runs)


def free_run_of(model: Model, record: Record, part: Part) -> FreeRun:
    """Free run of a model over a part of a record, scored and tested.

    Raises:
        UserError: the record does not fit the model's sampling.
    """
    experiment = experiment_of(model, record, part=part)
    sampling, used = model.sampling, part.of(record, model.sampling)
    starts = np.array([[0, 0, 1 + len(experiment.inputs), 0]])
    _, outputs = rollouts(model.system, starts, experiment.states[:1].copy(), experiment.inputs, step=sampling.step)
    simulated = outputs[:, 0]
    residuals = experiment.outputs[:, 0] - simulated[:: sampling.every]
    inputs = experiment.inputs[:, 0].reshape(-1, sampling.every).mean(axis=1)
    reference = used.channels.get("reference")
    stride = round(sampling.period / used.sampling_time)
    again, skipped = resimulations(model.system, [(record, part)], rigs.load(model.rig), sampling=sampling)
    return FreeRun(
        name=record.name,
        digest=record.digest,
        part=part,
        seen=_seen(model, record, part),
        scores=score(experiment.outputs[:, 0], simulated[:: sampling.every]),
        time=used.time,
        measured=used.output[:, 0],
        simulated_time=np.asarray(sampling.step * np.arange(len(simulated))),
        simulated=simulated,
        residual_time=np.asarray(sampling.period * np.arange(experiment.samples)),
        residuals=residuals,
        tests=_tests(residuals[:-1], inputs, None if reference is None else reference[::stride]),
        horizons=k_step_errors(model.system, experiment),
        again=again.get(record.name),
        skipped=skipped.get(record.name, ""),
    )


def closed_loop_section(loop: LoopRecord, rig: Rig | None = None) -> ClosedLoopSection:
    """A recorded loop, judged on the windows of the rig's reference that it followed, if any, else as a whole.

    rig: by default the one that the loop was read with.
    """
    display = (rig or loop.rig).display[0]
    volts, time = display.shown(loop.reference), loop.time
    begun = np.isfinite(volts) & (time >= 0.0)
    windows: dict[str, Window] = {"whole": (0.0, float(time[-1]))}
    for schedule in (rig or loop.rig).references.values():
        if begun.any() and np.median(np.abs(volts - schedule.of(0)(time))[begun]) < SAME_REFERENCE:
            windows = schedule.windows
    windows = {name: window for name, window in windows.items() if (begun & loop.within(*window)).any()}
    zooms: dict[str, Window] = {}
    for name, (start, stop) in windows.items():
        if name == "sine":
            zooms[name] = (start + 2.0, min(start + 6.0, stop))
            continue
        inside = begun & loop.within(start + 0.5, stop)
        jump = np.abs(np.diff(volts)) * (inside[1:] & inside[:-1])
        middle = float(time[int(np.nanargmax(jump))]) if inside.sum() > 1 else start
        zooms["largest step"] = (max(middle - 0.4, 0.0), middle + 0.9)
    return ClosedLoopSection(loop=loop, windows=windows, zooms=zooms)


def provenance(model: Model, command: str, *, hashes: Mapping[str, str] | None = None) -> Provenance:
    """Where a report on a model comes from: the command that makes it, the hashes of model and training records.

    hashes: further ones, by name.
    """
    found = {"model": model.seal}
    for entry in model.records:
        start, stop = entry.get("part", (0.0, 1.0))
        found[f"training, {entry.get('name', '?')} {start:g} to {stop:g}"] = str(entry.get("sha256", ""))
    known = {**versions(), "Python": platform.python_version(), "system": f"{platform.system()} {platform.machine()}"}
    return Provenance(command=command, hashes={**found, **(hashes or {})}, versions=known)


def _seen(model: Model, record: Record, part: Part) -> bool | None:
    """Whether a part of a record overlaps with what the model was trained on; None where nobody can tell."""

    def overlaps(entry: Mapping[str, Any]) -> bool:
        start, stop = entry.get("part", (0.0, 1.0))
        return bool(entry["sha256"] == record.digest and start < part.stop and part.start < stop)

    if not record.digest or not model.records or not all(entry.get("sha256") for entry in model.records):
        return None
    return any(overlaps(entry) for entry in model.records)


def _tests(residuals: Array, inputs: Array, reference: Array | None) -> dict[str, ResidualTest]:
    """Residual tests, each array (samples,) or longer, without those of signals that are constant or not known."""
    length = len(residuals)
    signals = {"phi_ue": inputs[:length], "phi_re": np.zeros(0) if reference is None else reference[:length]}
    signals = {key: signal for key, signal in signals.items() if len(signal) == length and _varies(signal)}
    if not signals or not _varies(residuals):
        return {}
    lags = max(1, min(LAGS, length // 4))
    *_, (last, exogenous) = signals.items()
    tests = {key.replace("u", "s"): test for key, test in correlation_tests(residuals, exogenous, lags=lags).items()}
    tests[last] = tests.pop("phi_se")
    if last != "phi_ue" and "phi_ue" in signals:
        tests["phi_ue"] = independence(residuals, signals["phi_ue"], lags=lags)
    return tests


def _varies(values: Array) -> bool:
    return bool(np.isfinite(values).all() and np.ptp(values) > 1e-9 * max(1.0, float(np.max(np.abs(values)))))
