"""The loop of a rig behind its guard, as the nodes run it, in one process and without a clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.safety.guard import Guard
from hybrid_sysid_ros.extensions.shared.guarded_controller import GuardedController
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import defaults, estimator_model, guard_settings
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.runtime.estimators import estimator_of, prediction_step


def guarded_loop(rig: Rig, model: Model, settings: Mapping[str, Any] | None = None) -> GuardedController:
    """Estimator, guard and controller of a model from the parameters of the nodes; it answers at the estimator's rate.

    settings: those of the node `controller` that are not the rig's. Raises UserError where parameters, model and policy
    don't fit each other.
    """
    model, values = estimator_model(rig, model), defaults(rig, "estimator")
    given = {**defaults(rig, "controller"), **(settings or {}), "lockstep": True}
    return GuardedController(
        controller_of(rig, model, given).controller,
        Guard(guard_settings(given, rig, model.system)),
        estimator_of(rig, model.system, values, latency=given["latency"], step=prediction_step(model)),
        rest=np.array([actuator.rest for actuator in rig.actuators]),
        lead=model.system.delay + given["latency"],
    )
