"""Estimators from the parameters of the node `estimator`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.estimation import estimator_class
from hybrid_sysid_ros.estimation.initialisation import LONGEST_STEP
from hybrid_sysid_ros.estimation.monitored_estimator import MonitoredEstimator, MonitorSettings
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import defaults, estimator_tuning
from hybrid_sysid_ros.runtime.limits import reading_ranges

FAR = 3.0
"""Multiple of a sensor's noise in the rig's file from which on an assumed one may be far too large. Else innovations
that are small are no reason to doubt: a simulated sensor may have no noise at all, and an encoder has none at rest."""


def _reversible(rig: Rig) -> list[float]:
    """Inputs of a stabiliser: a rig that has none can rest, and a sensor with the wrong sign looks the same there."""
    gains = rig.experiments.stabiliser
    return [0.0 if gains is None or not gains[j].any() else 1.0 for j in range(len(rig.actuators))]


def prediction_step(model: Model) -> float:
    """Longest step of an estimator's prediction [s]: the model's own, unless it was identified at shorter ones."""
    return max(model.sampling.step, LONGEST_STEP)


def estimator_of(
    rig: Rig,
    system: System,
    settings: Mapping[str, Any],
    *,
    period: float | None = None,
    latency: float | None = None,
    step: float = LONGEST_STEP,
) -> MonitoredEstimator:
    """The estimator that the settings choose, for the system of an :func:`~.configuration.estimator_model`.

    period, latency [s]: by default those of the settings. step: :func:`prediction_step`. Raises UserError where
    parameters and model don't fit.
    """
    known = zip(defaults(rig, "estimator")["measurement_noise"], rig.sensors, strict=True)
    large = [FAR * max(noise, sensor.floor) for noise, sensor in known]
    monitoring = MonitorSettings(
        largest=settings["innovation_limit"],
        least=[
            settings["innovation_least"] * (noise > most)
            for noise, most in zip(settings["measurement_noise"], large, strict=True)
        ],
        leave_after=settings["leave_out_after"],
        timeout=settings["sensor_timeout"],
        alone=settings["dead_reckoning"] if any(_reversible(rig)) else 0.0,
        ranges=reading_ranges(rig),
        frozen_after=settings["frozen_after"],
        white_noise=[abs(sensor.scale) * sensor.white_noise * sensor.noisy for sensor in rig.sensors],
        doubt_disturbance=settings["doubt_disturbance"],
        reversible=_reversible(rig),
    )
    return MonitoredEstimator(
        estimator_class(settings["method"]),
        system,
        estimator_tuning(settings, rig, system),
        monitoring,
        period=1.0 / settings["rate"] if period is None else period,
        latency=settings["latency"] if latency is None else latency,
        step=step,
    )
