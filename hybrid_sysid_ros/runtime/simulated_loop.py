"""A closed loop of a rig in one process: its simulated plant, the estimator and references of its configuration."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.control import Controller
from hybrid_sysid_ros.control.closed_loop import ClosedLoop, simulate_loop
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.arrays import Array


def simulated_loop(
    rig: Rig,
    model: Model,
    controller: Controller,
    reference: Callable[[ArrayLike], Array],
    *,
    duration: float,
    seed: int = 0,
) -> ClosedLoop:
    """A loop of ``duration`` [s] under a controller at its own period, without delays of computation.

    reference: times (samples,) [s] in, the outputs as they are shown (samples, p) out.
    """
    rig.steps(controller.period, "the period of the controller")
    tuning = configuration.estimator_tuning(configuration.defaults(rig.name, "estimator"), rig, model.system)
    estimator = ExtendedKalmanFilter(model.system, tuning, period=controller.period, latency=0.0)
    scales = np.array([display.scale for display in rig.display])
    controller.reset()
    return simulate_loop(
        Plant(rig, seed=seed, bias=rig.bias),
        estimator,
        controller,
        lambda t: scales * reference(t),
        inputs=len(rig.system.inputs),
        duration=duration,
        period=controller.period,
        lead=model.system.delay,
    )
