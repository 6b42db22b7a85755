"""The exact MPC against IPOPT and acados on the same problems in the same run: time of a call, inputs, cost.

Three problems, each a noisy closed loop: a plant with a 2x32 network (N = 20, Runge-Kutta steps, a square wave with
preview), the lecture's polynomial NARX with its cost (N = 10, its hardware reference), and the shipped model of the
beam. Times are those around the Python call. IPOPT is asked at every STRIDE-th sample of the converged loop, so that
both answer the same questions. acados, where it is installed, drives a loop of its own with the same noise; its times
are those of its solver's own calls, without what is set before and read after them, and our rows "solver" are so, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import acados_peer, result
from benchmarks.network_plant import NetworkPlant
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.control import ControlProblem, ExactMpc, MpcSolution, Status
from hybrid_sysid_ros.control.mpc.calls import solve_call
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.mpc.mpc import STATUSES
from hybrid_sysid_ros.control.stage_cost import stage_costs
from hybrid_sysid_ros.core import System, Variable, simulate
from hybrid_sysid_ros.extensions.shared import scenarios
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.arrays import Array

NAME = "mpc_speed"
SEEDS = (0, 1, 2)
STRIDE = 5
ITERATED: dict[str, dict[str, Any]] = {
    "checked": {"real_time": True},
    "unchecked": {"real_time": True, "checked": False},
}
LOOPS = 48
"""Of a rig's certificate, each stratum the same number."""
RIGS = "cam_beam", "flexible_joint", "wheel_motor", "winged_cone", "drill_string", "balancing_robot"


@dataclass(frozen=True, kw_only=True)
class Case:
    """A closed loop: its model is the plant, noise (states,) is added to the state at each of the samples."""

    system: System
    problem: ControlProblem
    reference: Callable[[Array], Array]
    samples: int
    noise: tuple[float, ...]


class TimedMpc(ExactMpc):
    """The exact MPC, whose times of its compiled call alone are kept [s]."""

    def __init__(self, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        self.times: list[float] = []

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :meth:`ExactMpc.control`."""
        self.instance.assign(state, disturbance, previous_input, preview)
        began = perf_counter()
        status = solve_call(self.compiled, self.instance, self.problem.max_iterations, True)
        self.times.append(perf_counter() - began)
        return self.planned(STATUSES[status])


def cases() -> dict[str, Case]:
    """The problems by name."""
    rig = load("cam_beam")
    scale, hardware = rig.display[0].scale, rig.schedule()
    plain: dict[str, Any] = {"period": 0.05, "input_low": (-10.0,), "input_high": (10.0,), "max_iterations": 100}
    network = ControlProblem(
        horizon=20, substeps=2, output_weights=(1e2,), rate_weights=(1e-1,), input_weights=(1e-2,), **plain
    )
    lecture = ControlProblem(horizon=10, substeps=1, output_weights=(1e3,), input_weights=(1.0,), **plain)
    return {
        "network": Case(
            system=NetworkPlant(),
            problem=network,
            reference=lambda t: np.where((0.2 * t) % 1.0 < 0.5, 2.0, -2.0)[:, None],
            samples=150,
            noise=(0.02, 0.3),
        ),
        "lecture": Case(system=lecture_model(), problem=lecture, reference=hardware, samples=1000, noise=(0.02,)),
        "beam": Case(
            system=load_model(configuration.shipped("cam_beam", "model")).system,
            problem=configuration.mpc_problem(configuration.defaults("cam_beam", "controller"), rig),
            reference=lambda t: scale * hardware(t),
            samples=2500,
            noise=(0.0, 0.02),
        ),
    }


def lecture_model() -> System:
    """The author's polynomial of the beam in volts: y(k+1) from y(k..k-2) and u(k..k-2)."""
    terms = {
        (1, 0, 0, 0, 0, 0): 1.1440,
        (0, 1, 0, 0, 0, 0): -0.0171,
        (0, 0, 1, 0, 0, 0): -0.1534,
        (0, 0, 0, 1, 0, 0): 0.2197,
        (0, 0, 0, 0, 0, 0): -0.1618,
        (0, 0, 0, 2, 1, 0): 0.0015,
        (0, 1, 0, 0, 1, 0): 0.0124,
        (1, 1, 1, 0, 0, 0): 0.0022,
        (0, 0, 0, 0, 0, 1): -0.0452,
        (0, 1, 0, 0, 2, 0): -0.0019,
    }
    from hybrid_sysid_ros.extensions.narx.narx import Narx

    return Narx(
        outputs=(Variable(name="position", unit="V"),),
        inputs=(Variable(name="drive", unit="V"),),
        exponents=(tuple(terms),),
        coefficients=tuple(terms.values()),
        output_lags=3,
        input_lags=3,
        scales=(1.0, 1.0),
        low=(-20.0, -10.0),
        high=(20.0, 10.0),
    )


def loop(case: Case, seed: int, controller: Any, other: Any = None) -> dict[str, Any]:
    """One closed loop; ``other`` answers some of the same questions."""
    random = np.random.default_rng(seed)
    system = case.system
    problem = case.problem.sized(system)
    states, output = len(system.states), list(system.measured)
    noise = np.zeros(states)
    noise[: len(case.noise)] = case.noise
    x, u = np.zeros(states), np.zeros(1)
    times: dict[str, list[float]] = {"call": [], "prepare": [], "other": []}
    statuses, apart, rows = [], [], []
    controller.reset()
    for k in range(case.samples):
        ahead: Array = problem.period * np.arange(k + 1, k + 1 + problem.horizon, dtype=np.float64)
        preview = case.reference(ahead)
        began = perf_counter()
        plan = controller.control(x, np.zeros(1), u, preview)
        times["call"].append(perf_counter() - began)
        statuses.append(plan.status)
        if other is not None and k % STRIDE == 0:
            other.reset()
            began = perf_counter()
            answer = other.control(x, np.zeros(1), u, preview)
            times["other"].append(perf_counter() - began)
            if answer.status is Status.SOLVED and plan.status is Status.SOLVED:
                apart.append(abs(float(answer.input[0] - plan.input[0])))
        u = plan.input
        began = perf_counter()
        controller.prepare(problem.period)
        times["prepare"].append(perf_counter() - began)
        held = np.tile(u, (problem.substeps, 1))
        x = simulate(system, x, held, step=problem.period / problem.substeps)[-1] + noise * random.normal(size=states)
        rows.append((x[output], preview[0], u, x))
    outputs, references, inputs, reached = (np.array(part) for part in zip(*rows, strict=True))
    costs = stage_costs(
        problem.stage_weights,
        outputs=outputs,
        references=references,
        inputs=inputs,
        previous=np.zeros(1),
        states=reached,
    )
    return {"times": times, "statuses": statuses, "apart": apart, "cost": float(np.sum(costs))}


def on_rig(name: str) -> dict[str, dict[str, float]]:
    """What real-time iterations cost in loops of a rig's certificate, in shares of what the converged MPC's cost."""
    from hybrid_sysid_ros.extensions.policies.configured import trial_of

    trial = trial_of(configuration.shipped(name, "policy"), configuration.shipped(name, "model"))
    problem, costs = trial.policy.problem, list[Array]()
    for options in ({}, *ITERATED.values()):
        mpc = ExactMpc(trial.model, problem, **options)

        def control(k: int, asked: Instance, mpc: ExactMpc = mpc) -> Array:
            (mpc.prepare if k else lambda _: mpc.reset())(problem.period)
            return mpc.control(*asked).input

        runs = [scenarios.run(trial.scenario(number), problem, control) for number in range(LOOPS)]
        costs.append(np.array([run.costs.sum() for run in runs]))
    return {
        mode: {"together": float(cost.sum() / costs[0].sum()), "worst": float((cost / costs[0]).max())}
        for mode, cost in zip(ITERATED, costs[1:], strict=True)
    }


def main() -> int:
    """Run, print a table, write the results."""
    from hybrid_sysid_ros.extensions.ipopt.interior_point import InteriorPointMpc

    machine = result.machine()
    results: dict[str, Any] = {}
    shown = Table(
        "problem", "solver", "p50", "p99", "max", "solved", "first input off IPOPT", "cost", title="one call [ms]"
    )
    for name, case in cases().items():
        yardstick = InteriorPointMpc(case.system, case.problem, tolerance=1e-9)
        exact = TimedMpc(case.system, case.problem)
        quick, plain = (TimedMpc(case.system, case.problem, **options) for options in ITERATED.values())
        for controller in (exact, quick, plain):  # the first loop compiles
            loop(case, SEEDS[0], controller)
            controller.times.clear()
        converged = [loop(case, seed, exact, yardstick) for seed in SEEDS]
        iterated, unchecked = ([loop(case, seed, each) for seed in SEEDS] for each in (quick, plain))
        ratio, ratio_plain = (
            np.array([b["cost"] / a["cost"] for a, b in zip(converged, runs, strict=True)])
            for runs in (iterated, unchecked)
        )
        apart = np.concatenate([run["apart"] for run in converged])
        statuses = [status for run in converged for status in run["statuses"]]
        solved = sum(status is Status.SOLVED for status in statuses) / len(statuses)
        measured = {
            "converged": _times(converged, "call"),
            "converged_solver": result.percentiles(1e3 * np.array(exact.times)),
            "ipopt": _times(converged, "other"),
            "real_time_feedback": _times(iterated, "call"),
            "real_time_feedback_solver": result.percentiles(1e3 * np.array(quick.times)),
            "real_time_preparation": _times(iterated, "prepare"),
            "unchecked_feedback": _times(unchecked, "call"),
            "unchecked_feedback_solver": result.percentiles(1e3 * np.array(plain.times)),
            "unchecked_preparation": _times(unchecked, "prepare"),
        }
        results[name] = {
            "milliseconds": measured,
            "share_solved": solved,
            "first_input_apart": result.percentiles(apart),
            "compared": len(apart),
            "cost_ratio_real_time": result.spread(ratio),
            "cost_ratio_unchecked": result.spread(ratio_plain),
        }
        more = {
            "converged": (f"{solved:.2%}", f"p50 {np.median(apart):.1e}, max {apart.max():.1e}", "1"),
            "real_time_feedback": ("", "", _words(ratio)),
            "unchecked_feedback": ("", "", _words(ratio_plain)),
        }
        if acados_peer.installed():
            for mode in ("converged", "real_time"):
                peer = acados_peer.AcadosMpc(case.system, case.problem, real_time=mode == "real_time")
                runs = [loop(case, seed, peer) for seed in SEEDS]
                ratio = np.array([b["cost"] / a["cost"] for a, b in zip(converged, runs, strict=True)])
                share = np.mean([status is Status.SOLVED for run in runs for status in run["statuses"]])
                results[name][f"acados_{mode}_cost_ratio"] = result.spread(ratio)
                results[name][f"acados_{mode}_share_solved"] = share
                for what, taken in peer.times.items():
                    if taken:
                        solver = f"acados_{mode}_{what}"
                        measured[solver] = result.percentiles(1e3 * np.array(taken))
                        more[solver] = (f"{share:.2%}", "", _words(ratio)) if what == "call" else ("", "", "")
        for solver, times in measured.items():
            cells = (f"{times[key]:.3f}" for key in ("p50", "p99", "max"))
            shown.add_row(name, solver.replace("_", " "), *cells, *more.get(solver, ("", "", "")))
    print_table(shown)
    results["rigs"] = {name: on_rig(name) for name in RIGS}
    for name, modes in results["rigs"].items():
        words = (f"{mode} {cost['together']:.4f} (worst {cost['worst']:.2f})" for mode, cost in modes.items())
        print(f"{name}: cost of {LOOPS} loops to converged: {', '.join(words)}")
    print(result.write(NAME, results, on=machine))
    return 0


def _words(ratio: Array) -> str:
    return f"{ratio.mean():.4f} ({ratio.min():.4f}-{ratio.max():.4f})"


def _times(runs: list[dict[str, Any]], what: str) -> dict[str, float]:
    return result.percentiles(1e3 * np.concatenate([run["times"][what] for run in runs]))


if __name__ == "__main__":
    result.run(main)
