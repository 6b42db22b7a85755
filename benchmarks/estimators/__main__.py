"""EKF, UKF and MHE on the simulated beam, with filterpy's on the same model in the same run.

- beam: a plant unlike the model (the shipped one), with the hum, noise and counts of the rig's sensor and an unknown
  offset of the drive. drawn: a plant that is the model, with the noise that the tuning says. Both: independent runs.
- NEES is the normalised squared error of the state, 2 in the mean. Its mean over the runs at one moment has a 95 %
  band; shown are the mean over all moments, and the share of the moments within the band, below and above it.
- delayed: frames of a second, better sensor come late. followed: friction and the drive's centre jump.

Times are those around the Python call, answer included: percentiles of each run, of which the smallest over the runs
are taken, so that what else the machine does in some of them does not count.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import result
from benchmarks.estimators.runs import PERIOD, Run, beam, drawn
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.estimation import Estimator, SensorChannel, Tuning
from hybrid_sysid_ros.estimation.consistency import band, normalised_errors
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array

NAME = "estimators"

RUNS, SECONDS = 40, 10.0
BIAS = 0.3
"""Largest offset of the drive that is drawn for a run [V]."""
SETTLED = round(1.0 / PERIOD)
"""Samples at the start of a run that don't count."""

REST, BREAK_AWAY = 0.005, 30
"""Speed below which the beam counts as resting [rad/s], and samples after that (150 ms)."""

FRAME_PERIOD, FRAME_DELAY = 4, 4
"""Samples between two frames of the second sensor, and until one arrives: 20 ms each."""
FRAME_NOISE = 0.005
"""V of the sensor."""
DELAYED_RUNS = 10

FOLLOWED = "coulomb=0.2 centre=0.05"
FRICTION_RISE, CENTRE_FALL = 1.4, 0.3
"""Factor of the Coulomb friction from 10 s on; V by which the centre is lower from 20 s on."""
FOLLOWED_RUNS = 6


def main() -> int:
    """Run, print tables, write the results."""
    machine = result.machine()
    rig = load("cam_beam")
    system = load_model(configuration.shipped(rig.name, "model")).system
    tuning = tuning_of(rig)
    volt = rig.display[0].scale
    ours: dict[str, Any] = extensions.provided("estimators")
    kinds: dict[str, Callable[..., Any]] = {**ours, **peers()}
    made = {name: partial(kind, system, tuning, period=PERIOD) for name, kind in kinds.items()}
    biases = np.random.default_rng(0).uniform(-BIAS, BIAS, RUNS)
    groups = {
        "beam": [beam(rig, seed, seconds=SECONDS, bias=float(biases[seed])) for seed in range(RUNS)],
        "drawn": [drawn(system, tuning, seed, samples=round(SECONDS / PERIOD / 2)) for seed in range(RUNS)],
    }
    results: dict[str, Any] = {"runs": RUNS}
    for group, runs in groups.items():
        results[group] = {name: watched(make, runs, volt) for name, make in made.items()}
    results["delayed"] = {name: delayed(method, rig, system, tuning) for name, method in ours.items()}
    results["followed"] = {name: followed(method, rig) for name, method in ours.items()}
    show(results)
    print(result.write(NAME, results, on=machine))
    return 0


def peers() -> Mapping[str, Callable[..., Any]]:
    """The peers that are installed, by name; a line if they aren't."""
    try:
        return importlib.import_module("benchmarks.estimators.filterpy_filters").PEERS
    except ImportError as error:
        print(f"skipped: filterpy is not usable here ({error}); pip install -e '.[peers]'", file=sys.stderr)
        return {}


def tuning_of(rig: Rig, **changes: Any) -> Tuning:
    """The shipped tuning, but for changed parameters of the node."""
    return configuration.estimator_tuning(configuration.defaults(rig.name, "estimator") | changes, rig)


def watched(make: Callable[[], Any], runs: Sequence[Run], volt: float) -> dict[str, Any]:
    """What an estimator makes of independent runs of one length."""
    estimator = make()
    for given in list(runs[0])[:3]:  # compiles
        estimator.update(*given)
    errors, covariances, squares, seconds = [], [], [], []
    for run in runs:
        estimator = make()
        for time, output, applied in run:
            began = perf_counter()
            estimate = estimator.update(time, output, applied)
            seconds.append(perf_counter() - began)
            errors.append(estimate.state)
            covariances.append(estimate.covariance[:2, :2])
            squares.append(estimate.normalised_innovation)
    shape, settled = (len(runs), -1), np.s_[:, SETTLED:]
    states = np.array([run.states for run in runs])
    error = (np.reshape(errors, (*shape, 2)) - states)[settled]
    raw = (np.array([run.measured for run in runs]) - states[..., 0])[settled]
    nees = normalised_errors(error, np.reshape(covariances, (*shape, 2, 2))[settled])
    nis = np.reshape(squares, shape)[settled]
    position, noise = _rms(error[..., 0]), _rms(raw)
    return {
        "position_rmse_volts": position / volt,
        "raw_noise_volts": noise / volt,
        "position_share_of_raw": position / noise,
        "velocity_rmse": _rms(error[..., 1]),
        "nees": _in_band(nees, 2),
        "nees_by_phase": _by_phase(nees, states[settled][..., 1]),
        "nis": _in_band(nis, 1),
        "microseconds": _quietest(np.reshape(seconds, shape)[settled]),
    }


def delayed(method: type[Estimator], rig: Rig, system: System, tuning: Tuning) -> dict[str, Any]:
    """Position RMSE with frames of a second sensor that come late, and the time of one frame's call."""
    volt = rig.display[0].scale
    tuning = replace(tuning, channels={"camera": SensorChannel(of="position", noise=FRAME_NOISE * volt)})
    errors: dict[str, list[float]] = {"no_frames": [], "punctual": [], "late_in_place": [], "late_taken_for_new": []}
    seconds: list[float] = []
    for seed in range(DELAYED_RUNS):
        run = beam(rig, seed, seconds=SECONDS)
        noise = FRAME_NOISE * volt * np.random.default_rng(seed).normal(size=len(run.measured))
        for kind, found in errors.items():
            estimator = method(system, tuning, period=PERIOD)
            wait = 0 if kind == "punctual" else FRAME_DELAY
            for k, (time, output, applied) in enumerate(run):
                estimate = estimator.update(time, output, applied)
                frame = k - wait
                if kind != "no_frames" and frame > 0 and frame % FRAME_PERIOD == 0:
                    stamp = time if kind == "late_taken_for_new" else frame * PERIOD
                    began = perf_counter()
                    estimate = estimator.correct(stamp, run.states[frame, 0] + noise[frame], "camera")
                    if kind == "late_in_place":
                        seconds.append(perf_counter() - began)
                if k >= SETTLED:
                    found.append(estimate.state[0] - run.states[k, 0])
    rmse = {f"{kind}_rmse_volts": _rms(np.array(found)) / volt for kind, found in errors.items()}
    return {**rmse, "late_frame_microseconds": _quietest(np.reshape(seconds, (DELAYED_RUNS, -1)))}


def followed(method: type[Estimator], rig: Rig) -> dict[str, Any]:
    """Friction and centre jump under a model that was right: how soon and how near they are found."""
    truth = rig.system.named
    coulomb, centre = FRICTION_RISE * truth["coulomb"], truth["centre"] - CENTRE_FALL
    changes = {10.0: {"coulomb": coulomb}, 20.0: {"centre": centre}}
    tunings = {
        "following": tuning_of(rig, followed=FOLLOWED, disturbance_noise=0.0),
        "disturbance_only": tuning_of(rig),
    }
    rows: dict[str, list[Any]] = {name: [] for name in tunings}
    for seed in range(FOLLOWED_RUNS):
        run = beam(rig, seed, seconds=30.0, changes=changes)
        for name, tuning in tunings.items():
            estimator = method(rig.system, tuning, period=PERIOD)
            rows[name].append([estimator.update(*given) for given in run])
        rows.setdefault("states", []).append(run.states)
    parameters = np.array([[estimate.parameters for estimate in row] for row in rows["following"]])
    second = round(1.0 / PERIOD)
    late = np.s_[:, 26 * second :]
    found: dict[str, Any] = {}
    for column, (name, before, after, start) in enumerate(
        (("coulomb", truth["coulomb"], coulomb, 10), ("centre", truth["centre"], centre, 20))
    ):
        share = (parameters[:, start * second : (start + 10) * second, column] - before) / (after - before)
        reached = np.argmax(share > 0.9, axis=1) * PERIOD
        found[name] = {
            "true": after,
            "found": result.spread(parameters[..., column][late].mean(axis=1)),
            "seconds_to_90_percent": result.spread(np.where(np.any(share > 0.9, axis=1), reached, np.nan)),
        }
    states = np.array(rows["states"])
    for name in tunings:
        velocity = np.array([[estimate.state[1] for estimate in row] for row in rows[name]]) - states[..., 1]
        squares = np.array([[estimate.normalised_innovation for estimate in row] for row in rows[name]])
        found[name] = {"velocity_rmse": _rms(velocity[late]), "nis": float(squares[late].mean())}
    return found


def show(results: Mapping[str, Any]) -> None:
    """Print the results."""
    console = Console(width=170)
    for group in ("beam", "drawn"):
        table = Table(title=f"{group}, {results['runs']} runs", title_justify="left")
        for heading in ("", "position", "of raw", "velocity", "NEES", "within/below/above", "NIS", "p50", "p99"):
            table.add_column(heading)
        for name, row in results[group].items():
            nees, nis, times = row["nees"], row["nis"], row["microseconds"]
            table.add_row(
                name,
                f"{row['position_rmse_volts']:.4f} V",
                f"{row['position_share_of_raw']:.3f}",
                f"{row['velocity_rmse']:.4f} rad/s",
                f"{nees['mean']:.2f} ({nees['band'][0]:.2f}-{nees['band'][1]:.2f})",
                f"{nees['within']:.0%}/{nees['below']:.0%}/{nees['above']:.0%}",
                f"{nis['mean']:.3f}",
                f"{times['p50']:.1f} us",
                f"{times['p99']:.1f} us",
            )
        console.print(table)
    table = Table(
        "", "no frames", "punctual", "late, in place", "late, taken for new", "p50", "p99", title="position RMSE"
    )
    for name, row in results["delayed"].items():
        errors = (f"{value:.4f} V" for key, value in row.items() if key.endswith("volts"))
        times = row["late_frame_microseconds"]
        table.add_row(name, *errors, f"{times['p50']:.1f} us", f"{times['p99']:.1f} us")
    console.print(table)
    table = Table("", "parameter", "true", "found", "90 % after", "NIS followed", "not followed", title="after jumps")
    for name, row in results["followed"].items():
        for parameter in ("coulomb", "centre"):
            item = row[parameter]
            table.add_row(
                name,
                parameter,
                f"{item['true']:.3f}",
                "{mean:.3f} ({min:.3f}-{max:.3f})".format(**item["found"]),
                "{mean:.1f} s ({min:.1f}-{max:.1f})".format(**item["seconds_to_90_percent"]),
                f"{row['following']['nis']:.3f}",
                f"{row['disturbance_only']['nis']:.3f}",
            )
    console.print(table)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _by_phase(squares: Array, velocities: Array) -> dict[str, float]:
    """Mean of normalised squares (runs, samples) at rest, in the :data:`BREAK_AWAY` samples after it, and beyond."""
    resting = np.abs(velocities) < REST
    since = np.zeros_like(resting)
    for lag in range(1, BREAK_AWAY + 1):
        since[:, lag:] |= resting[:, :-lag]
    phases = {"at_rest": resting, "after_rest": since & ~resting, "moving": ~since & ~resting}
    return {name: float(squares[phase].mean()) for name, phase in phases.items()}


def _quietest(seconds: Array) -> dict[str, float]:
    """Percentiles [us] of times (runs, calls), the smallest over the runs."""
    found = [result.percentiles(1e6 * row) for row in seconds]
    return {key: min(row[key] for row in found) for key in found[0]}


def _in_band(squares: Array, degrees: int) -> dict[str, Any]:
    """Normalised squares (runs, samples): the mean, and where the means over the runs lie."""
    low, high = band(len(squares), degrees)
    means = squares.mean(axis=0)
    below, above = float(np.mean(means < low)), float(np.mean(means > high))
    return {
        "mean": float(means.mean()),
        "band": [low, high],
        "within": 1.0 - below - above,
        "below": below,
        "above": above,
    }


if __name__ == "__main__":
    result.run(main)
