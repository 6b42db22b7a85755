"""An hour of each rig without a fault, and what the guard would have done: python -m benchmarks.false_alarms [RIG...].

Estimator, guard and controller as the nodes use them, on the simulated rig with its noise and disturbances, its own
reference over and over, no clock in it. Asked: no change of state. Shown beside it: the most suspicion that there was,
as a share of what slows the loop. --seeds N: with N seeds of the noise from 1 on, by default 1; thresholds were chosen
with seed 0, which is not reported.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime.guarded_loop import guarded_loop
from hybrid_sysid_ros.runtime.parameters import defaults, shipped
from hybrid_sysid_ros.support import parallel
from hybrid_sysid_ros.support.errors import UserError

NAME = "false_alarms"
RIGS = ("cam_beam", "flexible_joint", "wheel_motor", "drill_string", "winged_cone")
SECONDS = 3600.0
"""Of a rig's loop."""


def quiet(rig: Rig, seed: int, *, seconds: float = SECONDS, policy: str = "supervised") -> dict[str, Any]:
    """Changes of state in a loop without a fault, and the most suspicion and evidence."""
    model = load_model(shipped(rig.name, "model"), rig=rig.source)
    loop = guarded_loop(rig, model, {"policy": policy, "certificate": "ignore"})
    plant, schedule, guard = Plant(rig, seed=seed, bias=rig.bias), rig.schedule(), loop.guard
    tracked = np.array(defaults(rig, "controller")["output_weight"]) > 0.0
    scales, period = tracked * [display.scale for display in rig.display], 1.0 / defaults(rig, "estimator")["rate"]
    steps, inputs = rig.steps(period, "the period"), loop.input.copy()
    states, most, evidence = dict.fromkeys(LoopState, 0), 0.0, 0.0
    level = LoopState.DRIVING
    for k in range(round(seconds / period)):
        time = k * period
        estimate = loop.estimator.update(time, plant.sensed(), inputs)
        times = time + loop.lead + np.concatenate([[0.0], loop.times])
        reference = scales * schedule(times % schedule.duration)
        command = loop.control(estimate, inputs, reference[0], reference[1:], period)
        inputs = np.array([item.bounded(float(u)) for item, u in zip(rig.actuators, command, strict=True)])
        states[loop.level] += loop.level is not level
        level = loop.level
        most, evidence = max(most, guard.failsafe.suspicion), max(evidence, *guard.evidence.values())
        for _ in range(steps):
            plant.advance(inputs)
    return {
        "rig": rig.name,
        "seed": seed,
        "seconds": seconds,
        "alarms": sum(count for state, count in states.items() if state is not LoopState.DRIVING),
        "states": {state.word: count for state, count in states.items() if count},
        "suspicion": most / guard.settings.ladder.slowed,
        "evidence": evidence,
        "left_out": sum(loop.estimator.monitor.counts),
    }


def _quiet(item: tuple[str, int]) -> dict[str, Any]:
    return quiet(load(item[0]), item[1])


def main() -> int:
    """Run those that are named, or all, on all cores; print the table and write the JSON."""
    words, seeds = sys.argv[1:], 1
    if "--seeds" in words:
        at = words.index("--seeds")
        if at + 1 == len(words) or not words[at + 1].isdigit() or not int(words[at + 1]):
            raise UserError("--seeds: give a number of seeds from 1 on")
        seeds = int(words[at + 1])
        del words[at : at + 2]
    if unknown := [word for word in words if word not in RIGS]:
        raise UserError(f"no rig {unknown[0]!r}: rigs are {', '.join(RIGS)}")
    pieces = [(rig, seed + 1) for seed in range(seeds) for rig in words or RIGS]
    found = parallel.run(_quiet, pieces, progress=lambda done, of: status.print(f"{done} of {of}"))
    table = Table("rig", "seed", "alarms", "sensors left out", "most suspicion", title="hours without a fault")
    for row in found:
        table.add_row(row["rig"], *(str(row[key]) for key in ("seed", "alarms", "left_out")), f"{row['suspicion']:.2f}")
    print_table(table)
    if not words:
        print(result.write(NAME, {"loops": found, "short": sum(row["alarms"] > 0 for row in found)}))
    return 0


if __name__ == "__main__":
    result.run(main)
