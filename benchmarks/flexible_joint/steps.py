"""Steps of the link's speed on the noisy simulated rig: how long they take to settle under PI, exact MPC and policy.

A step has settled when the true speed of the link, which the simulation knows, stays within 2 % of the step's size
until the next one. Nobody knows of a step before it comes. All have the same sensors, torque limits and period, and
no delay.

The best PI law, u = gain (e + integral of e), e of the measured speed at 200 Hz, its integral standing still while the
torque is at a bound, is found by differential evolution over both numbers on the rig itself: least mean settling time
over the same steps, with what exceeds 5 % of overshoot priced so high that nothing pays for it.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from scipy.optimize import differential_evolution

from benchmarks import picture, result, step_response
from hybrid_sysid_ros.control import Controller, ExactMpc, MpcSolution
from hybrid_sysid_ros.control.closed_loop import simulate_loop
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter, StateEstimate
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import check_tolerances
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.arrays import Array

OUTPUT, REFERENCE, PERIOD = 1, "steps", 0.005
BAND, OVERSHOOT = 0.02, 0.05
SEEDS = (0, 1, 2)
TUNED_ON = 100
"""Seed of the noise while the PI law is tuned."""
GAIN, INTEGRAL = (0.005, 2.0), (0.05, 50.0)
"""Where its numbers are sought [N m s/rad, 1/s]; both by their logarithms."""
PRICE = 20.0
"""Of overshoot beyond OVERSHOOT [s]: a percent costs .2 s of mean settling time."""
PICTURE, SHOWN = Path(__file__).parents[2] / "docs" / "results" / "flexible_joint_steps.svg", (3.4, 6.9)
"""Where the steps are drawn, and which seconds of them."""
UNFORESEEN = {"reference": {"preview_seconds": 0.01, "publish_period": 0.005, "point_spacing": 0.005}}
"""Of the nodes: no reference is known more than 10 ms ahead."""


class WatchedLoop:
    """A controller and an estimator whose numbers are kept."""

    def __init__(self, controller: Controller, estimator: ExtendedKalmanFilter) -> None:
        self.controller, self.estimator = controller, estimator
        self.horizon, self.period = controller.horizon, controller.period
        self.iterations: list[int] = []
        self.innovations: list[float] = []

    def reset(self) -> None:
        """Forget the past."""
        self.controller.reset()

    def prepare(self, elapsed: float) -> None:
        """When the input is out."""
        self.controller.prepare(elapsed)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """One answer."""
        plan = self.controller.control(state, disturbance, previous_input, preview)
        if isinstance(self.controller, ExactMpc):
            self.iterations.append(self.controller.iterations)
        return plan

    def update(self, time: float, outputs: Array, applied: Array) -> StateEstimate:
        """One estimate."""
        estimate = self.estimator.update(time, outputs, applied)
        self.innovations.append(estimate.normalised_innovation)
        return estimate


def settled(rig: Rig, time: Array, speed: Array) -> Array:
    """Settling time [s] and overshoot [of the step] of each step, (steps, 2); speed as it is shown, (samples,)."""
    return step_response.settled(rig.schedule(REFERENCE), OUTPUT, time, speed, band=BAND)[:, :2]


def pi_loop(rig: Rig, gain: float, integral: float, *, seed: int) -> tuple[Array, Array, Array]:
    """Times, true speeds and torques under the PI law, every period."""
    plant, schedule = Plant(rig, seed=seed, bias=rig.bias), rig.schedule(REFERENCE)
    times: Array = PERIOD * np.arange(round(schedule.duration / PERIOD), dtype=np.float64)
    wanted = rig.display[OUTPUT].scale * schedule(times)[:, OUTPUT]
    low, high, total = rig.actuators[0].low, rig.actuators[0].high, 0.0
    speeds, torques = [], []
    for reference in wanted.tolist():
        speeds.append(plant.outputs()[OUTPUT])
        error = reference - float(plant.sensed()[OUTPUT])
        u = gain * error + total
        if low <= u <= high:  # else it would wind up
            total += gain * integral * PERIOD * error
        torques.append(min(max(u, low), high))
        for _ in range(round(PERIOD / rig.step)):
            plant.advance(u)
    return times, np.array(speeds) / rig.display[OUTPUT].scale, np.array(torques)


def best_pi(rig: Rig, *, price: float = PRICE) -> dict[str, float]:
    """The PI law that settles soonest with at most OVERSHOOT, which is free at a price of 0."""

    def cost(logarithms: Array) -> float:
        found = settled(rig, *pi_loop(rig, *np.exp(logarithms), seed=TUNED_ON)[:2])
        return float(found[:, 0].mean() + price * max(0.0, found[:, 1].max() - OVERSHOOT))

    found = differential_evolution(
        cost, [np.log(GAIN), np.log(INTEGRAL)], popsize=12, maxiter=14, seed=0, polish=False, tol=1e-3
    )
    gain, integral = np.exp(found.x)
    return {"gain": float(gain), "integral": float(integral), "cost": float(found.fun), "loops": int(found.nfev)}


def mpc_loop(rig: Rig, model: Model, controller: Controller, *, seed: int) -> tuple[WatchedLoop, Any]:
    """The loop of a controller in lockstep at 200 Hz, and what was counted in it."""
    tuning = configuration.estimator_tuning(configuration.defaults(rig, "estimator"), rig, model.system)
    watched = WatchedLoop(controller, ExtendedKalmanFilter(model.system, tuning, period=PERIOD, latency=0.0))
    schedule, scales = rig.schedule(REFERENCE), np.array([display.scale for display in rig.display])

    watched.reset()
    loop = simulate_loop(
        Plant(rig, seed=seed, bias=rig.bias),
        watched,
        watched,
        step_response.unforeseen(schedule, scales, controller.period, lead=model.system.delay),
        inputs=len(rig.actuators),
        duration=schedule.duration,
        period=PERIOD,
        lead=model.system.delay,
    )
    return watched, loop


def lockstep(rig: Rig, model: Model, make: Callable[[], Controller]) -> dict[str, Any]:
    """Steps under a controller, over SEEDS."""
    rows, iterations, innovations, statuses = [], [], [], Counter[str]()
    for seed in SEEDS:
        watched, loop = mpc_loop(rig, model, make(), seed=seed)
        rows.append(settled(rig, loop.time, loop.outputs[:, OUTPUT] / rig.display[OUTPUT].scale))
        iterations += watched.iterations
        innovations.append(float(np.nanmean(watched.innovations)))
        statuses.update({status.value: count for status, count in loop.statuses.items()})
    counted = (
        {"iterations": {**result.percentiles(iterations), "mean": float(np.mean(iterations))}} if iterations else {}
    )
    return {**summary(rows), **counted, "normalised_innovation": result.spread(innovations), "statuses": dict(statuses)}


def summary(rows: list[Array]) -> dict[str, Any]:
    """Of settling times and overshoots, (steps, 2) of each seed."""
    return {
        "settling_mean": result.spread([row[:, 0].mean() for row in rows]),
        "settling_longest": result.spread([row[:, 0].max() for row in rows]),
        "overshoot_largest": result.spread([row[:, 1].max() for row in rows]),
        "steps": [[round(float(value), 4) for value in column] for column in np.mean(rows, axis=0).T],
    }


def processes(rig: Rig, **options: Any) -> dict[str, Any]:
    """The steps once with plant, estimator and controller as processes; options: of session.run.

    The true speed is the rig's under the torques that the bag holds; ``replayed`` is how far its sensor was from that.
    """
    with tempfile.TemporaryDirectory() as folder:
        outcome = Run(
            rig=rig.source,
            reference=REFERENCE,
            bag=Path(folder) / "bag",
            parameters=UNFORESEEN,
            tell=lambda line: None,
            **options,
        ).go()
        if outcome.interrupted or outcome.bag is None:
            raise KeyboardInterrupt
        loop = LoopRecord.from_bag(outcome.bag, rig)
    fine = round(PERIOD / rig.step)
    inputs = np.repeat(loop.inputs[:-1], fine, axis=0)
    states = simulate(rig.system, np.zeros(len(rig.system.states)), inputs, step=rig.step, every=fine)
    scale = rig.display[OUTPUT].scale
    speed = states[:, list(rig.system.measured)][:, OUTPUT] / scale
    plant = outcome.diagnostics["plant"]
    controller = outcome.diagnostics["controller"]
    return {
        **summary([settled(rig, loop.time, speed)]),
        "replayed": float(np.std(speed - loop.outputs[:, OUTPUT] / scale)),
        "delay_ms": {key: plant[f"delay_ms_{key}"] for key in ("p50", "p99", "max")},
        "missed_commands": plant["missed_commands"],
        "layers": {key: value for key, value in controller.items() if key.startswith(("layer_", "status_"))},
    }


def measured(rig: Rig, model: Model) -> dict[str, Any]:
    """All controllers in lockstep, and the supervised policy and the exact MPC in processes."""
    laws = {"PI": best_pi(rig), "PI that may overshoot": best_pi(rig, price=0.0)}
    gains = {name: (best["gain"], best["integral"]) for name, best in laws.items()}
    problem = configuration.mpc_problem(configuration.defaults(rig, "controller"), rig, model.system)
    drawn: dict[str, Callable[[], Controller]] = {"exact MPC": lambda: ExactMpc(model.system, problem)}
    loops = {
        **{
            name: summary([settled(rig, *pi_loop(rig, *law, seed=seed)[:2]) for seed in SEEDS])
            for name, law in gains.items()
        },
        "exact MPC": lockstep(rig, model, drawn["exact MPC"]),
    }
    folder = configuration.TRAINED / rig.name / "policy"
    if folder.is_dir():
        imitation = policy.load(folder, model=model)
        tolerances = check_tolerances(configuration.defaults(rig, "controller"), rig, problem)
        mpc = ExactMpc(model.system, problem)
        drawn["policy"] = lambda: imitation
        loops["policy"] = lockstep(rig, model, drawn["policy"])
        loops["supervised policy"] = lockstep(rig, model, lambda: Supervisor(imitation, mpc, tolerances))
    draw(rig, model, gains["PI"], {name: make for name, make in drawn.items() if name in loops})
    ratio = loops["exact MPC"]["settling_mean"]["mean"] / loops["PI"]["settling_mean"]["mean"]
    levels = step_response.levels(rig.schedule(REFERENCE), OUTPUT)
    return {
        "pi": laws,
        "levels": levels,
        "loops": loops,
        "settling_ratio": ratio,
    }


def draw(rig: Rig, model: Model, law: tuple[float, float], made: Mapping[str, Callable[[], Controller]]) -> Path:
    """Some steps of the same noise under each."""
    times, speeds, torques = pi_loop(rig, *law, seed=SEEDS[0])
    inside = (times >= SHOWN[0]) & (times <= SHOWN[1])
    lines = {"reference": rig.schedule(REFERENCE)(times)[:, OUTPUT], "PI": speeds}
    inputs = {"PI": torques}
    for name, make in made.items():
        loop = mpc_loop(rig, model, make(), seed=SEEDS[0])[1]
        lines[name], inputs[name] = loop.outputs[:, OUTPUT] / rig.display[OUTPUT].scale, loop.inputs[:, 0]
    panels = [
        picture.Panel(label="link [rpm]", height=260, lines={name: line[inside] for name, line in lines.items()}),
        picture.Panel(label="torque [N m]", height=160, held=True, lines={key: u[inside] for key, u in inputs.items()}),
    ]
    return picture.draw(PICTURE, times[inside], panels, title="Steps of the link's speed, the same noise")


def table(loops: Mapping[str, Mapping[str, Any]]) -> Table:
    """Settling times and overshoots."""
    headings = "settling, mean [s]", "longest", "overshoot, largest [%]", "NIS", "solved"
    found = Table("controller", *headings, title="steps of the link's speed: mean (range over seeds)")
    for name, row in loops.items():
        statuses = row.get("statuses", {})
        found.add_row(
            name,
            _shown(row["settling_mean"]),
            _shown(row["settling_longest"]),
            _shown({key: 100 * value for key, value in row["overshoot_largest"].items()}),
            f"{row['normalised_innovation']['mean']:.2f}" if "normalised_innovation" in row else "",
            " ".join(f"{key} {count}" for key, count in statuses.items()),
        )
    return found


def _shown(values: Mapping[str, float]) -> str:
    return f"{values['mean']:.3g} ({values['min']:.3g}-{values['max']:.3g})"
