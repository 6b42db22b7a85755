"""An hour of each rig without a fault, and what the guard would have done: python -m benchmarks.false_alarms [RIG...].

Estimator, guard and controller as the nodes use them, on the simulated rig with its noise and disturbances, its own
reference over and over, no clock in it. Asked: no change of state. Shown beside it: the most suspicion that there was,
as a share of what slows the loop. --seeds N: with N seeds of the noise from 1 on, by default 1; thresholds were chosen
with seed 0, which is not reported. --certificate N: N loops of each rig's certificate in place of the hour, with its
references, beginnings and offsets of the input. Its pushes are left out: they move the state itself at once, which no
rig does, and a sensor that jumps looks the same.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.extensions.accuracy.guarded_loop import guarded_loop
from hybrid_sysid_ros.extensions.policies.configured import trial_of
from hybrid_sysid_ros.extensions.policies.mixture import DISTURBED, stratum_of
from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.extensions.shared.guarded_controller import GuardedController
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime.parameters import defaults, shipped
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NAME = "false_alarms"
RIGS = ("cam_beam", "flexible_joint", "wheel_motor", "drill_string", "winged_cone", "balancing_robot")
SECONDS = 3600.0
"""Of a rig's loop."""


class Alarms:
    """Changes of state in a loop without a fault, and the most suspicion and evidence."""

    def __init__(self) -> None:
        self.states, self.level = dict.fromkeys(LoopState, 0), LoopState.DRIVING
        self.suspicion = self.evidence = 0.0

    def see(self, loop: GuardedController) -> None:
        """Count what the guard has said now."""
        guard = loop.guard
        self.states[loop.level] += loop.level is not self.level
        self.level = loop.level
        self.suspicion = max(self.suspicion, guard.suspicion / guard.settings.ladder.slowed)
        self.evidence = max(self.evidence, *guard.evidence.values())

    @property
    def found(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "alarms": sum(count for state, count in self.states.items() if state is not LoopState.DRIVING),
            "states": {state.word: count for state, count in self.states.items() if count},
            "suspicion": self.suspicion,
            "evidence": self.evidence,
        }


def loop_of(rig: Rig, policy: str = "supervised", distrust: str = "act") -> GuardedController:
    """With the model and the policy that come with the package."""
    model = load_model(shipped(rig.name, "model"), rig=rig.source)
    return guarded_loop(rig, model, {"policy": policy, "certificate": "ignore", "distrust": distrust})


def bounded(rig: Rig, command: Array) -> Array:
    """What acts of a command (m,)."""
    return np.array([item.bounded(float(u)) for item, u in zip(rig.actuators, command, strict=True)])


def acted(plant: Plant, command: Array, steps: int) -> Array:
    """Advance a plant by some steps under a command (m,); the mean inputs that its actuators applied (m,), which a
    driver reports: one that follows a command by its rate has not been there all the time.
    """
    total = np.zeros(len(command))
    for _ in range(steps):
        plant.advance(command)
        total += plant.applied
    return total / steps


def hour(rig: Rig, seed: int, *, seconds: float = SECONDS) -> dict[str, Any]:
    """The rig's own reference, over and over."""
    loop, alarms, plant, schedule = loop_of(rig), Alarms(), Plant(rig, seed=seed, bias=rig.bias), rig.schedule()
    tracked = np.array(defaults(rig, "controller")["output_weight"]) > 0.0
    scales, period = tracked * [display.scale for display in rig.display], 1.0 / defaults(rig, "estimator")["rate"]
    steps, inputs = rig.steps(period, "the period"), loop.input.copy()
    for k in range(round(seconds / period)):
        time = k * period
        estimate = loop.estimator.update(time, plant.sensed(), inputs)
        times = time + loop.lead + np.concatenate([[0.0], loop.times])
        reference = scales * schedule(times % schedule.duration)
        command = loop.control(estimate, inputs, reference[0], reference[1:], period)
        alarms.see(loop)
        inputs = acted(plant, command, steps)
    about = {"rig": rig.name, "seed": seed, "seconds": seconds, "left_out": sum(loop.estimator.monitor.counts)}
    return {**about, **alarms.found}


def certificate(rig: Rig, seed: int, *, loops: int) -> dict[str, Any]:
    """Loops of the rig's certificate, on the simulated rig and with its estimator, which begins in each of them."""
    loop, trial = loop_of(rig), trial_of(shipped(rig.name, "policy"), None, seed=seed)
    period, problem, alarms, out = 1.0 / defaults(rig, "estimator")["rate"], trial.policy.problem, Alarms(), 0
    steps, each = rig.steps(period, "the period"), round(problem.period / period)
    system, alarmed = load_model(shipped(rig.name, "model"), rig=rig.source).system, []
    alike = {item.name for item in rig.system.states} <= {item.name for item in trial.plant.states}
    for number in range(loops):
        scenario, alarms.level, before = trial.scenario(number), LoopState.DRIVING, alarms.found["alarms"]
        if alike:
            plant = Plant(rig, seed=number, bias=rig.bias, disturbed=stratum_of(number) == DISTURBED)
        else:  # the model knows other states than the rig, and the certificate is of the model
            plant = predicted_plant(rig, system, disturbance=rig.bias, seed=number, noisy=True)
        first = {item.name: value for item, value in zip(trial.plant.states, scenario.states[0], strict=True)}
        plant.reset([first.get(item.name, 0.0) for item in plant.rig.system.states], inputs=scenario.inputs[0])
        loop.estimator.begin()
        loop.begin()
        loop.input[:] = inputs = bounded(rig, scenario.inputs[0])
        loop.guard.commanded(inputs)
        for k in range(len(scenario.begins) * each):
            interval = k // each
            plant.bias[:] = rig.bias + scenario.disturbances[interval]
            estimate = loop.estimator.update(k * period, plant.sensed(), inputs)
            preview = scenario.references[interval : interval + problem.horizon]
            command = loop.control(estimate, inputs, preview[0], preview, period)
            alarms.see(loop)
            inputs = acted(plant, command, steps)
        out += sum(loop.estimator.monitor.counts)
        alarmed += [number] if alarms.found["alarms"] > before else []
    return {"rig": rig.name, "seed": seed, "loops": loops, "alarmed": alarmed, "left_out": out, **alarms.found}


def _tried(item: tuple[str, int, int]) -> dict[str, Any]:
    rig, seed, loops = item
    return certificate(load(rig), seed, loops=loops) if loops else hour(load(rig), seed)


def main() -> int:
    """Run those that are named, or all, on all cores; print the table and write the JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.false_alarms", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("rigs", nargs="*", metavar="RIG", help=", ".join(RIGS))
    parser.add_argument("--seeds", type=int, default=1, metavar="N")
    parser.add_argument("--certificate", type=int, default=0, metavar="N")
    asked = parser.parse_args()
    words, seeds, loops = asked.rigs, asked.seeds, asked.certificate
    if seeds < 1 or loops < 0:
        raise UserError("--seeds and --certificate: give a number from 1 on")
    if unknown := [word for word in words if word not in RIGS]:
        raise UserError(f"no rig {unknown[0]!r}: rigs are {', '.join(RIGS)}")
    pieces = [(rig, seed + 1, loops) for seed in range(seeds) for rig in words or RIGS]
    found = parallel.run(_tried, pieces, progress=lambda done, of: status.print(f"{done} of {of}"))
    table = Table(
        "rig",
        "seed",
        "alarms",
        "sensors left out",
        "most suspicion",
        title="loops of certificates" if loops else "hours without a fault",
    )
    for row in found:
        table.add_row(row["rig"], *(str(row[key]) for key in ("seed", "alarms", "left_out")), f"{row['suspicion']:.2f}")
    print_table(table)
    if not words:
        print(
            result.write(
                f"{NAME}_certificate" if loops else NAME,
                {"loops": found, "short": sum(row["alarms"] > 0 for row in found)},
            )
        )
    return 0


if __name__ == "__main__":
    result.run(main)
