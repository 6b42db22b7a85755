"""Controllers that know what no loop is given, beside what ships: what tuning of weights and filter can gain at most at
the same effort.

Both have in place of an estimator the plant's state, led through the delay by the inputs that are on their way, and the
offset of the inputs. One is the exact MPC of the rig, of which each plant is a random neighbour: no filter knows more.
The other one has each plant's own parameters, which only who learned them within the loop could have. A rig falls short
where the first gains what is asked of tuning, and tuning (benchmarks tune) does not.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result, tune
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.closed_loop import simulate_loop
from hybrid_sysid_ros.core import System, simulate
from hybrid_sysid_ros.estimation import StateEstimate
from hybrid_sysid_ros.extensions.tuning.loops import MORE_UNSEEN, Loops
from hybrid_sysid_ros.models import Options
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import mpc_problem, shipped
from hybrid_sysid_ros.support.arrays import Array

NAME = "tune_bound"
LOOPS = 48
"""Of the unseen ones."""
WEIGHT, FACTORS = "controller.rate_weight", (2.0, 1.4, 1.0, 0.7, 0.5)


class Knowing:
    """The plant's state and offset, as an estimator would give them. system: predicts through the delay."""

    def __init__(self, plant: Plant, system: System) -> None:
        self.plant, self.system = plant, system
        on_way = round(system.delay / plant.step)
        self._on_way: Array = np.tile([actuator.rest for actuator in plant.rig.actuators], (on_way, 1))
        self._last = math.nan

    def update(self, time: float, outputs: Array, applied: Array) -> StateEstimate:
        """See :meth:`~hybrid_sysid_ros.estimation.Estimator.update`."""
        plant, nothing, kept = self.plant, np.zeros(0), len(self._on_way)
        if not math.isnan(self._last):
            sent = np.tile(applied, (round((time - self._last) / plant.step), 1))
            self._on_way = np.vstack([self._on_way, sent])[len(sent) :]
        self._last, ahead = time, plant.state.copy()
        if kept:
            ahead = simulate(self.system, ahead, self._on_way + plant.bias, step=plant.step)[-1]
        return StateEstimate(
            time=time,
            state=plant.state.copy(),
            ahead=ahead,
            disturbance=plant.bias,
            parameters=nothing,
            covariance=np.zeros((0, 0)),
            innovation=nothing,
            normalised_innovation=math.nan,
            normalised=nothing,
        )


def known(loops: Loops, factor: float, own: bool) -> Array:
    """Settling and effort of unseen loops, (LOOPS, 2), by a factor of the weight of the inputs' changes. own: with the
    parameters of each plant, not with those of the rig.
    """
    options: Options = {name: option.default for name, option in loops.space.items()} | {WEIGHT: factor}
    values = {**loops.shipped["controller"], **loops.values(options)["controller"]}
    return np.array([_loop(loops, values, number, own) for number in range(LOOPS)])


def _loop(loops: Loops, values: Mapping[str, Any], number: int, own: bool) -> tuple[float, float]:
    drawn = loops.drawn(number, True)
    system = (drawn.plant.rig if own else loops.rig).system
    problem = mpc_problem(values, loops.rig, system)
    loop = simulate_loop(
        drawn.plant,
        Knowing(drawn.plant, system),
        ExactMpc(system, problem),
        drawn.reference,
        inputs=len(system.inputs),
        duration=drawn.seconds,
        period=problem.period,
        lead=system.delay,
    )
    return loops.judged(loop)[:2]


def bound(loops: Loops) -> dict[str, float]:
    """What ships, and what knowing gains at its effort; between two factors of WEIGHT on the straight line."""
    as_shipped = {name: option.default for name, option in loops.space.items()}
    settling, effort = loops.measures(as_shipped, unseen=True)[1].mean(axis=0).tolist()
    found = {"settling": settling, "effort": effort}
    for name, own in (("at_most", False), ("own_parameters", True)):
        rows = np.array([known(loops, factor, own).mean(axis=0) for factor in FACTORS])
        reached = [*rows[rows[:, 1] <= effort, 0]]
        for one, other in itertools.pairwise(rows):
            if one[1] <= effort < other[1]:
                reached.append(one[0] + (other[0] - one[0]) * (effort - one[1]) / (other[1] - one[1]))
        found[name] = 1.0 - float(min(reached, default=math.nan)) / settling
    return found


def main() -> int:
    """Run, print a table, write the results."""
    machine, found = result.machine(), {}
    tuned = json.loads((result.RESULTS / f"{tune.NAME}.json").read_text(encoding="utf-8"))["results"]["rigs"]
    shown = Table("rig", "settling", "gain at most", "with own parameters", "by tuning", title="on unseen loops")
    for name in tune.RIGS:
        rig = load_rig(name)
        loops = Loops(
            rig=rig,
            model=load_model(shipped(name, "model")),
            seed=0,
            count=LOOPS // MORE_UNSEEN,
            horizons=tune.HORIZONS,
        )
        found[name] = item = {**bound(loops), "tuned": tuned[name]["gain"]}
        gains = (f"{item[key]:.1%}" for key in ("at_most", "own_parameters", "tuned"))
        shown.add_row(name, f"{item['settling']:.4f}", *gains)
    print_table(shown)
    short = [name for name, item in found.items() if item["tuned"] < tune.ASKED <= item["at_most"]]
    print(f"short: {', '.join(short) or 'none'}")
    print(result.write(NAME, {"rigs": found, "loops": LOOPS, "asked": tune.ASKED, "short": len(short)}, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
