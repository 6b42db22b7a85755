"""Rigs for tests, without folders."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.rigs.actuator import Actuator
from hybrid_sysid_ros.rigs.drivers import Experiments
from hybrid_sysid_ros.rigs.joints import Joints
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import Sensor


@dataclass(frozen=True, kw_only=True)
class Lags(System):
    """Two first-order lags, x_i' = (u_i(t - delay_i) - x_i) / T; measured: x_0, x_1 and x_0 x_1 + u_1."""

    states = ("first [m]", "second [K]")
    inputs = ("push [m]", "heat [K]")
    outputs = ("first", "second", "product [m K]")
    stepper = RungeKutta()
    delays = {"push": "push_delay", "heat": 0.05}

    lag: float = bounded(0.5, 1e-3, 10.0, unit="s")
    push_delay: float = bounded(0.0125, 0.0, 1.0, unit="s")

    def law(self, x: Any, u: Any) -> Any:
        return [(u[0] - x[0]) / self.lag, (u[1] - x[1]) / self.lag]

    def output(self, x: Any, u: Any) -> Any:
        return x[0], x[1], x[0] * x[1] + u[1]


def rig_of(
    system: System,
    *,
    step: float = 0.001,
    sensors: dict[str, Sensor] | None = None,
    limit: float = 10.0,
    **changes: Any,
) -> Rig:
    """A rig of a system; sensors: by output, the others show it as it is."""
    reported = sensors or {}
    all_sensors = tuple(reported.get(item.name, Sensor(unit=item.unit)) for item in system.outputs)
    joints = Joints.of({}, system, "joints")
    inputs, outputs, channels = joints.signals(system, all_sensors)
    values: dict[str, Any] = {
        "name": "toy",
        "folder": Path("toy"),
        "system": system,
        "structures": {},
        "step": step,
        "sensors": all_sensors,
        "actuators": tuple(Actuator(low=-limit, high=limit) for _ in system.inputs),
        "travel": np.tile([[-np.inf], [np.inf]], len(system.states)),
        "joints": joints,
        "namespace": "toy",
        "signals": Signals(namespace="toy", inputs=inputs, outputs=outputs, channels=channels),
        "experiments": Experiments(),
        "references": {},
        "content": {},
    }
    return Rig(**{**values, **changes})
