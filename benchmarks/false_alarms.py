"""An hour of each rig without a fault, and what the guard would have done: python -m benchmarks.false_alarms [RIG...].

Estimator and controller as the nodes use them, on the simulated rig with its noise and disturbances, its own reference
over and over, no clock in it. Asked: no change of state. Shown beside it: the most suspicion that there was, as a share
of what slows the loop.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.nodes.adapters import ControllerAdapter, EstimatorAdapter, model_of
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime.configuration import defaults

NAME = "false_alarms"
RIGS = ("cam_beam", "flexible_joint", "wheel_motor", "drill_string", "winged_cone")
SECONDS = 3600.0
"""Of a rig's loop."""
SEED = 0


def quiet(rig: Rig, *, policy: str = "supervised") -> dict[str, Any]:
    """Changes of state in a loop without a fault, and the most suspicion and evidence."""
    settings = {node: {**defaults(rig, node), "lockstep": True} for node in ("estimator", "controller")}
    settings["controller"] |= {"policy": policy, "certificate": "ignore"}
    model, _ = model_of(rig, settings["estimator"])
    estimator = EstimatorAdapter(rig, model, settings["estimator"], "")
    controller = ControllerAdapter(rig, settings["controller"], "", lambda line: None)
    plant, schedule, guard = Plant(rig, seed=SEED, bias=rig.bias), rig.schedule(), controller.guard
    scales = np.array([display.scale for display in rig.display]) * controller.tracked
    period, ahead = 1.0 / settings["estimator"]["rate"], controller.ahead / SECOND
    steps, inputs = rig.steps(period, "the period"), controller.rest.copy()
    states, most, evidence = dict.fromkeys(LoopState, 0), 0.0, 0.0
    level = LoopState.DRIVING
    for k in range(round(SECONDS / period)):
        time = k * period
        estimator.given[:] = [*plant.sensed(), *inputs]
        estimate = estimator.update(time)
        before, level = level, guard.judge(estimator.doubt, estimator.monitor.without, inputs, estimate.ahead, period)
        states[level] += level is not before
        most, evidence = max(most, guard.failsafe.suspicion), max(evidence, *guard.evidence.values())
        preview = scales * schedule((time + ahead + controller.times) % schedule.duration)
        plan = controller.controller.control(estimate.ahead, estimate.disturbance, inputs, preview)
        inputs = np.array([item.bounded(float(u)) for item, u in zip(rig.actuators, plan.input, strict=True)])
        guard.commanded(plan.input)
        controller.controller.prepare(period)
        for _ in range(steps):
            plant.advance(inputs)
    return {
        "seconds": SECONDS,
        "alarms": sum(count for state, count in states.items() if state is not LoopState.DRIVING),
        "states": {state.word: count for state, count in states.items() if count},
        "suspicion": most / guard.settings.ladder.slowed,
        "evidence": evidence,
        "left_out": sum(estimator.monitor.counts),
    }


def main() -> int:
    """Run those that are named, or all; print the table and write the JSON."""
    chosen, found = sys.argv[1:] or list(RIGS), dict[str, dict[str, Any]]()
    for name in chosen:
        status.print(name)
        found[name] = quiet(load(name))
    table = Table(
        "rig", "alarms", "sensors left out", "most suspicion", "most evidence", title="an hour without a fault"
    )
    for name, row in found.items():
        table.add_row(
            name, str(row["alarms"]), str(row["left_out"]), f"{row['suspicion']:.2f}", f"{row['evidence']:.2f}"
        )
    print_table(table)
    if chosen == list(RIGS):
        print(result.write(NAME, {**found, "short": sum(row["alarms"] > 0 for row in found.values())}))
    return 0


if __name__ == "__main__":
    result.run(main)
