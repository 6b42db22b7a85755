"""A closed loop of a rig in one process: its simulated plant, and the estimator of its configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.control import Controller
from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.control.closed_loop import ClosedLoop, OutputReference, simulate_loop
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.estimation import estimator_class
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import estimator_model
from hybrid_sysid_ros.runtime.estimators import prediction_step


def simulated_loop(
    rig: Rig,
    model: Model,
    controller: Controller,
    reference: OutputReference,
    *,
    duration: float,
    seed: int = 0,
    plant: Plant | None = None,
    settings: Mapping[str, Any] | None = None,
) -> ClosedLoop:
    """Simulate a loop of ``duration`` [s] under a controller at its own period, or above a stabiliser at the
    estimator's rate, without delays of computation.

    reference: a function of times (samples,) [s] with outputs (samples, p) in display units. plant: the simulated rig
    by default. settings: parameters of the node `estimator`, the rig's by default.
    """
    model, values = estimator_model(rig, model), settings or configuration.defaults(rig, "estimator")
    period = 1.0 / values["rate"] if isinstance(controller, Cascade) else controller.period
    rig.steps(period, "the period of the controller")
    tuning = configuration.estimator_tuning(values, rig, model.system)
    kind = estimator_class(values["method"])
    estimator = kind(model.system, tuning, period=period, latency=0.0, step=prediction_step(model))
    scales = np.array([display.scale for display in rig.display])
    controller.reset()
    return simulate_loop(
        plant or Plant(rig, seed=seed, bias=rig.bias),
        estimator,
        controller,
        lambda t: scales * reference(t),
        inputs=len(rig.system.inputs),
        duration=duration,
        period=period,
        lead=model.system.delay,
    )


def predicted_plant(
    rig: Rig, system: System, *, disturbance: ArrayLike = 0.0, seed: int = 0, noisy: bool = False
) -> Plant:
    """A simulated rig that moves as a model predicts, with the rig's actuators and stops; noisy: with sensor noise.

    disturbance: constant offset of each input (m,).
    """
    travel = dict(zip((item.name for item in rig.system.states), rig.travel.T, strict=True))
    columns = [travel.get(item.name, np.array([-np.inf, np.inf])) for item in system.states]
    step = rig.step if system.sampling_time is None else system.sampling_time
    predicted = replace(rig, system=system, step=step, travel=np.stack(columns, axis=1))
    return Plant(predicted, seed=seed, bias=disturbance, noisy=noisy, disturbed=False)
