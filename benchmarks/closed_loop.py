"""The hardware reference under the approximate and the exact MPC on the same noisy plant, in one process.

At the MPC's own period, three seeds of noise: tracking, cost of the loop, and time of each call of the controller. The
rig itself, under its P controller, reached 1.080 V on the steps and .500 V on the sine.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros import configuration
from hybrid_sysid_ros.control import Controller, ExactMpc, Plan, policy
from hybrid_sysid_ros.demo import RIG, simulated_loop
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.excitation import HARDWARE_SINE, HARDWARE_STEPS
from hybrid_sysid_ros.rigs.rig import load

NAME = "closed_loop"
SEEDS = (0, 1, 2)


class Timed:
    """A controller that measures its calls."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.horizon, self.period = controller.horizon, controller.period
        self.seconds: list[float] = []

    def reset(self) -> None:
        """Forget the past."""
        self.controller.reset()

    def prepare(self, elapsed: float) -> None:
        """Not measured: it is done when the input is out."""
        self.controller.prepare(elapsed)

    def control(self, state: Any, disturbance: Any, previous_input: Any, preview: Any) -> Plan:
        """Measure one call."""
        began = perf_counter()
        plan = self.controller.control(state, disturbance, previous_input, preview)
        self.seconds.append(perf_counter() - began)
        return plan


def main() -> int:
    """Run, print a table, write the results."""
    machine = result.machine()
    rig = load(RIG)
    scale = rig.sensor.radians_per_volt
    model = load_model(configuration.shipped(RIG, "model"))
    imitation = policy.load(configuration.shipped(RIG, "policy"), model=model)
    controllers = {"approximate": Timed(imitation), "exact": Timed(ExactMpc(model.equation, imitation.problem))}
    loops = {
        name: [simulated_loop(rig, model, controller, seed=seed) for seed in SEEDS]
        for name, controller in controllers.items()
    }
    costs = {name: np.array([loop.cost(imitation.problem) for loop in runs]) for name, runs in loops.items()}
    shown = Table("controller", "steps RMSE", "sine RMSE", "cost to exact", "p50", "p99", "max", title="closed loop")
    results: dict[str, Any] = {}
    for name, runs in loops.items():
        steps = np.array([loop.tracking_rmse(*HARDWARE_STEPS) for loop in runs]) / scale
        sine = np.array([loop.tracking_rmse(*HARDWARE_SINE) for loop in runs]) / scale
        ratio = costs[name] / costs["exact"]
        times = result.percentiles(1e3 * np.array(controllers[name].seconds))
        results[name] = {
            "steps_rmse_volts": _spread(steps),
            "sine_rmse_volts": _spread(sine),
            "cost_ratio_to_exact": _spread(ratio),
            "call_ms": times,
            "statuses": {
                status.value: sum(loop.statuses[status] for loop in runs)
                for status in set().union(*(loop.statuses for loop in runs))
            },
        }
        cells = (f"{v.mean():.3f} ({v.min():.3f}-{v.max():.3f})" for v in (steps, sine, ratio))
        shown.add_row(name, *cells, *(f"{times[key]:.3f} ms" for key in ("p50", "p99", "max")))
    Console(width=160).print(shown)
    print(result.write(NAME, results, on=machine))
    return 0


def _spread(values: Any) -> dict[str, float]:
    return {"mean": float(np.mean(values)), "min": float(np.min(values)), "max": float(np.max(values))}


if __name__ == "__main__":
    result.run(main)
