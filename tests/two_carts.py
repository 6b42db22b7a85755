"""A rig outside of the package: two carts, each pushed, a spring between them, only one cart's place measured."""

from __future__ import annotations

from pathlib import Path

SYSTEM = '''
from dataclasses import dataclass

from hybrid_sysid_ros.core import Dry, System, bounded


@dataclass(frozen=True, kw_only=True)
class Carts(System):
    """M a'' = u - F sgn a' + k (b - a), M b'' = w - c b' - k (b - a)."""

    states = ("left [m]", "right [m]", "left_speed [m/s]", "right_speed [m/s]")
    inputs = ("left_push [N]", "right_push [N]")
    outputs = ("left [m]", "gap [m]")
    contacts = (Dry(on="left_speed", level="friction"),)

    mass: float = bounded(1.0, 0.1, 10.0, unit="kg")
    """M."""
    spring: float = bounded(20.0, 1.0, 100.0, unit="N/m")
    """k."""
    drag: float = bounded(1.0, 0.0, 10.0, unit="N s/m")
    """c."""
    coulomb: float = bounded(0.3, 0.0, 5.0, unit="N")
    """F."""

    def law(self, x, u):
        left, right, left_speed, right_speed = x
        force = self.spring * (right - left)
        return (
            left_speed,
            right_speed,
            (u[0] + force) / self.mass,
            (u[1] - self.drag * right_speed - force) / self.mass,
        )

    def output(self, x, u):
        return [x[0], x[1] - x[0]]

    def friction(self, x, u):
        return self.coulomb / self.mass
'''

VALUES = """
step: 0.001
sensors:
  left: {unit: mm, scale: 0.001, white_noise: 0.2}
  gap: {unit: mm, scale: 0.001, white_noise: 0.2}
actuators:
  left_push: {low: -3.0, high: 5.0}
  right_push: {low: -4.0, high: 4.0}
joints:
  cart: {position: left, velocity: left_speed, effort: left_push}
references:
  visit:
    duration: 4.0
    segments:
      out: {output: left, start: 0.5, stop: 4.0, kind: constant, level: 200.0}
      apart: {output: gap, start: 1.5, stop: 4.0, kind: constant, level: 50.0}
nodes:
  plant: {bias: [0.1, -0.2]}
  estimator:
    measurement_noise: 0.2
    process_noise: [0.0001, 0.0001, 0.05, 0.05]
    disturbance_noise: 0.2
  controller:
    output_weight: [1.0, 1.0]
    rate_weight: 1.0
"""


def write(folder: Path) -> Path:
    """The rig's folder, made."""
    folder.mkdir(parents=True)
    (folder / "system.py").write_text(SYSTEM, encoding="utf-8")
    (folder / "rig.yaml").write_text(VALUES, encoding="utf-8")
    return folder
