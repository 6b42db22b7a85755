"""Known errors of a fit: what step, inputs and sensors do to its residuals, known up to their sign."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from hybrid_sysid_ros.core import rollouts
from hybrid_sysid_ros.core.sensing import finest
from hybrid_sysid_ros.identification.problem import FitProblem
from hybrid_sysid_ros.support.arrays import Array


def known_errors(problem: FitProblem, point: Array, horizon: int | None) -> Array:
    """Errors of the residual rows of open rollouts, (errors, rows): first that of the integration step, by half the
    step, since the method is of first order; that of inputs which may have moved within a sample; and that of readings
    that are means over a sensor's window.
    """
    system, starts, initial = problem.started(point, horizon)
    sampling = problem.sampling
    given: dict[str, Any] = {"step": problem.sampling.step, "every": problem.sampling.every}
    _, coarse = rollouts(system, starts, initial, problem.inputs, **given)
    weight, rest = problem.weight(coarse), np.zeros(len(problem.priors(point)))
    found = [np.zeros_like(coarse)]
    if system.sampling_time is None and not system.stepper.is_map:
        halves = np.repeat(problem.inputs, 2, axis=0)
        finer: dict[str, Any] = {"step": 0.5 * sampling.step, "every": 2 * sampling.every}
        _, fine = rollouts(system, starts * np.array([2, 2, 1, 1]), initial, halves, **finer)
        with np.errstate(over="ignore", invalid="ignore"):
            found[0] = 2.0 * (fine - coarse)
    if any(item.bends is not None for item in problem.experiments):
        moved = np.concatenate(
            [item.inputs if item.bends is None else item.inputs + item.bends for item in problem.experiments]
        )
        _, run = rollouts(system, starts, initial, moved, **given)
        with np.errstate(over="ignore", invalid="ignore"):
            found.append(run - coarse)
    unknown = _unknown(problem)
    windows = [item.windows * unknown for item in problem.experiments if item.windows is not None]
    if windows and np.any(windows[0]):
        steps = finest(starts, sampling.every)
        _, run = rollouts(system, steps, initial, problem.inputs, step=sampling.step)
        parts = (run[begin : begin + count] for _, _, count, begin in steps)
        blurred = [_blurred(part, windows[0] / sampling.step)[:: sampling.every] for part in parts]
        found.append(np.concatenate(blurred))
    rows = [np.concatenate([np.nan_to_num(row * weight).ravel(), rest]) for row in found]
    return np.array(rows)


def lag_of_sensors(problem: FitProblem) -> Array:
    """What delays and windows of sensors that the model does not know add to the input delays among the free numbers,
    in their scales (shared,); zeros where no delay is free.
    """
    unknown = _unknown(problem)
    lags = [item.lag * unknown for item in problem.experiments if item.lag is not None]
    delays = [value for value in problem.system.delays.values() if isinstance(value, str)]
    free = np.array([float(name in delays) for name in problem.names])
    return np.asarray(free * (float(np.max(lags[0])) if lags else 0.0) / problem.scales)


def _unknown(problem: FitProblem) -> Array:
    """1 for each output whose sensor's delay and window the model does not know, else 0."""
    sensing = problem.system.sensing
    return np.ones(len(problem.system.outputs)) if sensing is None else np.where(sensing.known, 0.0, 1.0)


def _blurred(outputs: Array, windows: Array) -> Array:
    """Means over windows in steps, (outputs,), less the values in their middles, (samples, outputs)."""
    found = np.zeros_like(outputs)
    for column, window in enumerate(windows.tolist()):
        count = round(window) // 2 * 2 + 1
        if count > 1:
            values = outputs[:, column]
            found[:, column] = scipy.ndimage.uniform_filter1d(values, count, mode="nearest") - values
    return found
