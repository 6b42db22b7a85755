"""Systems of every structure with numbers that matter, for tests of what holds for all of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module

import numpy as np

from hybrid_sysid_ros.core import Dry, RungeKutta, System, bounded
from hybrid_sysid_ros.core.blocks import Block
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.models import build
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.trunk import TRUNK

FURTHER: dict[str, Callable[[], System]] = {}
"""Systems of the structures of extensions, of those that are there."""
BLOCKS: dict[str, tuple[Block, Block]] = {}
"""Blocks of extensions, each in two shapes."""
for path in sorted(extensions.HOME.glob("*/tests/systems.py")):
    found = import_module(f"hybrid_sysid_ros.extensions.{path.parts[-3]}.tests.systems")
    FURTHER |= found.SYSTEMS
    BLOCKS |= getattr(found, "BLOCKS", {})

RANGE = np.array([0.15, 0.5, 10.0])  # position [rad], velocity [rad/s], drive [V] of the beam's records
DEFLECTION = 0.005  # of bristles, as far as they bend [rad]
MOTIONS = [*TRUNK.provides["structures"]]


def structure(name: str, seed: int = 0) -> System:
    """A structure with every parameter away from its start, and a network that matters."""
    random = np.random.default_rng(seed)
    system, _ = build(name, CamBeam(), scales=RANGE, seed=seed)
    moved = [item.start + 0.1 * item.scale * random.uniform(-1, 1) for item in system.parameters]
    values = [
        value if item.fixed else float(np.clip(begin, item.low, item.high))
        for begin, value, item in zip(moved, system.values, system.parameters, strict=True)
    ]
    system = system.with_values(values)
    return system.with_weights(random.normal(size=len(system.weights))) if len(system.weights) else system


@dataclass(frozen=True, kw_only=True)
class ThrusterCart(System):
    """v' = left + right - F sgn v, of two thrusters that act after different times."""

    states = ("position [m]", "velocity [m/s]")
    inputs = ("left [m/s^2]", "right [m/s^2]")
    outputs = ("position", "effort [m/s^2]")
    contacts = (Dry(on="velocity", level=2.0),)
    delays = {"left": 0.1, "right": "right_delay"}

    right_delay: float = bounded(0.25, 0.0, 1.0, unit="s")
    """Of the right thruster."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0] + u[1]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[0], u[0] + u[1] - 3.0 * x[1]


@dataclass(frozen=True, kw_only=True)
class TwoTanks(System):
    """Levels a, b [m] under two pumps that act late; measured are the flow between the tanks and the first level."""

    states = ("first [m]", "second [m]")
    inputs = ("left [m^3/s]", "right [m^3/s]")
    outputs = ("flow [m^3/s]", "first [m]")
    delays = {"left": "left_delay", "right": "right_delay"}
    stepper = RungeKutta()

    area: float = bounded(0.5, 0.1, 2.0, unit="m^2")
    """Of each tank."""
    pipe: float = bounded(0.3, 0.01, 1.0, unit="m^2/s")
    """Flow per difference of levels."""
    left_delay: float = bounded(0.0312, 0.0, 1.0, unit="s")
    """Of the left pump."""
    right_delay: float = bounded(0.117, 0.0, 1.0, unit="s")
    """Of the right pump."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        flow = self.pipe * (x[0] - x[1])
        return (u[0] - flow) / self.area, (u[1] + flow) / self.area

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self.pipe * (x[0] - x[1]) + 0.1 * u[1], x[0]


SYSTEMS: dict[str, Callable[[], System]] = {
    **{name: partial(structure, name) for name in MOTIONS},
    **FURTHER,
}
