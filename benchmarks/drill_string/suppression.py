"""Who ends stick-slip: the exact MPC and its estimator beside three classical loops, on random drill strings.

Along 2, 3 and 5 rad/s a hand pulls the brake of the bit once on each level. After each event, a step of the wanted
speed, a pull or a release, the bit has settled when its true speed stays within 5 % of the wanted one until the next
event; where it does not, all the time up to there counts. All have the same noisy speeds every 10 ms, the same limits,
and a motor that answers late; nobody knows of an event before it comes. The plants that are judged are none of those on
which the classical loops were tuned, by exactly what is judged.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import picture, result, step_response
from benchmarks.drill_string import classical, plants
from hybrid_sysid_ros.control import Controller, ExactMpc
from hybrid_sysid_ros.control.closed_loop import ClosedLoop, simulate_loop
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration

PERIOD = 0.01
TRAINING, TEST = range(1000, 1012), range(100)
"""Seeds of the plants."""
SPEED_LOOP = {"kp": 2.0, "ki": 5.0}
"""The one that sticks, at the plant's own steps."""
PICTURE, SHOWN = Path(__file__).parents[2] / "docs" / "results" / "drill_string_brake.svg", 0
"""Where a plant's run is drawn, and its seed."""
THINNED = 3
"""Every which sample is drawn."""


def mpc_loop(rig: Rig, model: Model, controller: Controller, *, seed: int) -> ClosedLoop:
    """A run of the MPC or its policy on the rig."""
    tuning = configuration.estimator_tuning(configuration.defaults(rig, "estimator"), rig, model.system)
    schedule, scales = rig.schedule(plants.REFERENCE), np.array([display.scale for display in rig.display])
    controller.reset()
    return simulate_loop(
        Plant(rig, seed=seed, bias=rig.bias),
        ExtendedKalmanFilter(model.system, tuning, period=PERIOD, latency=0.0),
        controller,
        step_response.unforeseen(schedule, scales, controller.period, lead=model.system.delay),
        inputs=len(rig.actuators),
        duration=schedule.duration,
        period=PERIOD,
        lead=model.system.delay,
    )


def controlled(rig: Rig, model: Model, name: str, seeds: Iterable[int]) -> list[plants.Settling]:
    """Runs of a controller: exact or policy."""
    problem = configuration.mpc_problem(configuration.defaults(rig, "controller"), rig, model.system)
    if name == "exact MPC":
        controller: Controller = ExactMpc(model.system, problem)
    else:
        controller = policy.load(configuration.shipped(rig.name, "policy"), model=model)
    found = []
    for seed in seeds:
        run = mpc_loop(plants.drawn(rig, seed), model, controller, seed=seed)
        found.append(plants.settling(plants.events(rig, seed), run.time, run.outputs[:, plants.BIT]))
    return found


def turned(
    rig: Rig, law: int, gains: Mapping[str, float], seeds: Iterable[int], *, period: float = PERIOD
) -> list[plants.Settling]:
    """Runs of a classical loop."""
    known, values = classical.nominal(rig.system), np.array([*gains.values()])
    run = partial(classical.loop, known=known, law=law, gains=values, period=period)
    return [plants.settling(plants.events(rig, seed), *run(plants.drawn(rig, seed), seed=seed)) for seed in seeds]


def summary(runs: Sequence[plants.Settling]) -> dict[str, Any]:
    """Over plants, by kind of event and by wanted speed."""
    times = np.concatenate([run.times for run in runs])
    kinds = np.concatenate([run.kinds for run in runs])
    wanted = np.concatenate([run.wanted for run in runs])
    levels = sorted(set(wanted.tolist()))
    return {
        "settling": float(times.mean()),
        **{kind: float(times[kinds == kind].mean()) for kind in ("step", "apply", "release")},
        "settling_at": {f"{level:g}": float(times[wanted == level].mean()) for level in levels},
        "suppressed_at": {f"{level:g}": float(np.mean([run.suppressed(level) for run in runs])) for level in levels},
        "standing_at": {f"{level:g}": float(np.mean([run.standing[level] for run in runs])) for level in levels},
        "by_plant": result.percentiles([run.times.mean() for run in runs]),
    }


def measured(rig: Rig, model: Model) -> dict[str, Any]:
    """Tune the classical loops, and let all run on the same plants."""
    tuned = {name: classical.tuned(rig, name, TRAINING, period=PERIOD) for name in classical.LAWS}
    loops = {"speed loop kp 2, ki 5": summary(turned(rig, classical.PI, SPEED_LOOP, TEST, period=rig.step))}
    for name, best in tuned.items():
        loops[name] = summary(turned(rig, classical.LAWS[name][0], best["gains"], TEST))
    best_name = min(tuned, key=lambda name: float(loops[name]["settling"]))
    names = ["exact MPC"]
    if (configuration.TRAINED / rig.name / "policy").is_dir():
        names.append("policy")
    for name in names:
        loops[name] = summary(controlled(rig, model, name, TEST))
    draw(rig, model, best_name, tuned[best_name]["gains"])
    ratio = loops[best_name]["settling"] / loops["exact MPC"]["settling"]
    return {"tuned": tuned, "loops": loops, "best_classical": best_name, "times_faster": ratio}


def draw(rig: Rig, model: Model, best: str, gains: Mapping[str, float]) -> Path:
    """One plant under the speed loop, the best classical one and the MPC."""
    string = plants.drawn(rig, SHOWN)
    problem = configuration.mpc_problem(configuration.defaults(rig, "controller"), rig, model.system)
    run = mpc_loop(string, model, ExactMpc(model.system, problem), seed=SHOWN)
    known, every = classical.nominal(rig.system), rig.steps(PERIOD, "period")
    values = np.array([*SPEED_LOOP.values()])
    speed_loop = classical.loop(string, known, classical.PI, values, seed=SHOWN, period=rig.step)[1]
    law, values = classical.LAWS[best][0], np.array([*gains.values()])
    other = classical.loop(string, known, law, values, seed=SHOWN, period=PERIOD)[1]
    lines = {
        "reference": run.references[:, plants.BIT],
        "speed loop": speed_loop[::every],
        best: other,
        "exact MPC": run.outputs[:, plants.BIT],
    }
    hand = {"brake": plants.brake(rig, SHOWN, run.time), "estimated": run.estimates[:, plants.BRAKE]}
    bit, torque = ({name: line[::THINNED] for name, line in reported.items()} for reported in (lines, hand))
    panels = [
        picture.Panel(label="bit [rad/s]", height=260, lines=bit),
        picture.Panel(label="brake [N m]", height=110, lines=torque),
    ]
    return picture.draw(PICTURE, run.time[::THINNED], panels, title="A hand on the brake of the bit")


def table(found: Mapping[str, Any]) -> Table:
    """Settling times, and where stick-slip is suppressed."""
    levels = [*next(iter(found["loops"].values()))["suppressed_at"]]
    headings = (f"suppressed at {level} rad/s [%]" for level in levels)
    shown = Table("", "settling [s]", "step", "apply", "release", *headings, "stands [%]", title="100 random plants")
    for name, row in found["loops"].items():
        shown.add_row(
            name,
            *(f"{row[key]:.3f}" for key in ("settling", "step", "apply", "release")),
            *(f"{100 * row['suppressed_at'][level]:.0f}" for level in levels),
            f"{100 * np.mean([*row['standing_at'].values()]):.2f}",
        )
    return shown
