"""A rig for tests in a folder of its own: two tanks, of which the lower one is heated."""

TANK = """
from dataclasses import dataclass
from hybrid_sysid_ros.core import System, RungeKutta, bounded
from hybrid_sysid_ros.core.mathematics import maximum, sqrt

@dataclass(frozen=True, kw_only=True)
class Tanks(System):
    states = ("upper [m]", "lower [m]", "heat [K]")
    inputs = ("pump [m^3/s]", "heater [W]")
    outputs = ("lower", "heat", "inflow [m^3/s]")
    stepper = RungeKutta()
    delays = {"heater": "heater_delay"}
    area: float = bounded(0.1, 0.01, 1.0, unit="m^2")
    outlet: float = bounded(0.002, 0.0, 0.1, unit="m^2.5/s")
    capacity: float = bounded(500.0, 1.0, 1e5, unit="J/K")
    loss: float = bounded(5.0, 0.0, 100.0, unit="W/K")
    heater_delay: float = bounded(0.25, 0.0, 5.0, unit="s")

    def law(self, x, u):
        upper, lower, heat = x
        through, out = self.flow(upper), self.flow(lower)
        return (u[0] - through) / self.area, (through - out) / self.area, (u[1] - self.loss * heat) / self.capacity

    def flow(self, level):
        return self.outlet * level / sqrt(maximum(level, 1e-3))

    def output(self, x, u):
        return x[1], x[2], self.flow(x[0])
"""
TANK_VALUES = """
step: 0.1
sensors:
  lower: {unit: mm, scale: 0.001, white_noise: 1.0}
  heat: {delay: 1.0}
actuators:
  pump: {low: 0.0, high: 0.002}
  heater: {low: 0.0, high: 100.0}
joints:
  boiler: {position: heat, effort: heater}
experiments:
  excitations:
    both: {pump: {kind: constant, level: 0.001}, heater: {kind: random_steps, amplitude: 50, hold: 2}}
"""
