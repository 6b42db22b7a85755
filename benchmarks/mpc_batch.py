"""Many MPC problems at once: converged answers a second on all cores, and closed loops of the beam's certificate.

The questions are those of the noisy loops of mpc_speed, each from the plan of the period before, as there. IPOPT has a
process on each core and a cold start, as it has no other way. acados' batch solver, where it is installed, has as many
threads and the same first plans; its times are those of its own call. Certificates of 100 000 loops are computed from
fewer.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import acados_peer, result
from benchmarks.mpc_speed import SEEDS, cases, loop
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.control import ExactMpc, MpcSolution, Status
from hybrid_sysid_ros.extensions.shared import parallel, scenarios
from hybrid_sysid_ros.extensions.tightening.tightening import Tightening, covariance_of, tightened
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.arrays import Array

NAME = "mpc_batch"
CORES = os.cpu_count() or 1
LEAST = 20_000
"""Answers in a measurement, at least."""
REPEATS = 3
IPOPT_ROWS = 40
"""Questions for each process of IPOPT."""
ACADOS_ROWS = 450
"""Questions of a batch of acados, which has a solver for each."""
LOOPS, MORE, CERTIFIED = 600, 4, 100_000
ASKED = {"network_per_second": 15_000.0, "over_ipopt": 4.0, "over_acados": 1.0}
ASKED |= {"certificate_minutes": 5.0, "kept": 0.999, "plain": 0.95}
"""On two cores; kept: the least share of loops within a tightened bound, plain: the most within one that is not."""
BOUND, LOWER, REFERENCE, TIGHTENED, PERIODS = 0.05, -0.04, 0.08, 10_000, 40
"""Of the beam's angle, and of the steps that it is asked for [rad]; number and length of the loops."""


class Recorded:
    """An exact MPC that keeps its questions, and the plans from which it began."""

    def __init__(self, mpc: ExactMpc) -> None:
        self.mpc = mpc
        self.rows: list[Array] = []
        self.starts: list[Array] = []
        self.reset, self.prepare = mpc.reset, mpc.prepare

    def control(self, *asked: Array) -> MpcSolution:
        plan = self.mpc.shooting.horizon.inputs
        self.starts.append(np.tile(asked[2], (len(plan), 1)) if self.mpc.cold else plan.copy())
        self.rows.append(np.concatenate([np.ravel(part) for part in asked]))
        return self.mpc.control(*asked)


def questions(name: str) -> tuple[ExactMpc, Array, Array]:
    """The MPC of a case, its questions as rows, and the plans to begin from."""
    case = cases()[name]
    recorded = Recorded(ExactMpc(case.system, case.problem))
    for seed in SEEDS:
        loop(case, seed, recorded)
    return recorded.mpc, np.array(recorded.rows), np.array(recorded.starts)


def rate(work: Callable[[], int]) -> float:
    """How many a second, the median of some runs; work returns how many it did."""
    found = []
    for _ in range(REPEATS):
        began = perf_counter()
        done = work()
        found.append(done / (perf_counter() - began))
    return float(np.median(found))


def ipopt_rate(name: str, rows: Array) -> float:
    """Solved answers of IPOPT to questions (rows, n + 2 m + N p) a second, in one process."""
    from hybrid_sysid_ros.extensions.ipopt.interior_point import InteriorPointMpc

    case = cases()[name]
    solver, n, m = InteriorPointMpc(case.system, case.problem), len(case.system.states), len(case.system.inputs)
    solved, began = 0, 0.0
    for number, row in enumerate(rows):
        if number == 1:  # the first one is built
            solved, began = 0, perf_counter()
        solver.reset()
        state, disturbance, previous, preview = np.split(row, [n, n + m, n + 2 * m])
        plan = solver.control(state, disturbance, previous, preview.reshape(case.problem.horizon, -1))
        solved += plan.status is Status.SOLVED
    return solved / (perf_counter() - began)


def compared(name: str) -> dict[str, Any]:
    """Answers a second of one case."""
    mpc, rows, starts = questions(name)
    times = -(-LEAST // len(rows))
    many, first = np.tile(rows, (times, 1)), np.tile(starts, (times, 1, 1))
    found: dict[str, Any] = {"questions": len(rows)}
    for threads in (1, CORES):
        found[f"{threads}_threads"] = rate(partial(_solved, mpc, many, first, threads))
    found["cold"] = rate(partial(_solved, mpc, many, None, CORES))
    answers = mpc.solve_many(rows, starts)
    found |= {"share_solved": float(answers.solved.mean()), "steps": float(answers.iterations.mean())}
    if acados_peer.installed():
        found["acados"] = of_acados(name, mpc, rows, starts)
    picked = np.random.default_rng(0).choice(len(rows), (CORES, IPOPT_ROWS))
    pieces = [rows[each] for each in picked]
    found["ipopt_processes"] = float(sum(parallel.run(partial(ipopt_rate, name), pieces, workers=CORES)))
    return found


def of_acados(name: str, mpc: ExactMpc, rows: Array, starts: Array) -> dict[str, Any]:
    """Solved answers of acados' batch solver to questions (rows, n + 2 m + N p) a second, by its fastest set-up."""
    picked = np.random.default_rng(0).choice(len(rows), min(ACADOS_ROWS, len(rows)), replace=False)
    own, case, found = mpc.solve_many(rows[picked], starts[picked]), cases()[name], list[dict[str, Any]]()
    for qp_solver in acados_peer.QP_SOLVERS:
        batch = acados_peer.AcadosBatch(case.system, case.problem, len(picked), qp_solver=qp_solver)
        answers = [batch.solve(rows[picked], starts[picked], CORES) for _ in range(REPEATS + 1)]
        inputs, solved, _ = answers[-1]
        found.append(
            {
                "qp_solver": qp_solver,
                "per_second": float(solved.sum() / np.median([seconds for *_, seconds in answers[1:]])),
                "share_solved": float(solved.mean()),
                "first_input_apart": result.percentiles(np.abs(inputs - own.inputs[:, 0, 0])[solved]),
            }
        )
    return max(found, key=lambda item: item["per_second"])


def _solved(mpc: ExactMpc, rows: Array, starts: Array | None, threads: int) -> int:
    return int(mpc.solve_many(rows, starts, threads=threads).solved.sum())


def certificate() -> dict[str, Any]:
    """Loops of the beam's certificate: of the exact MPC alone, and all that a certificate needs."""
    from hybrid_sysid_ros.extensions.policies.configured import trial_of
    from hybrid_sysid_ros.extensions.policies.counting import CHUNK
    from hybrid_sysid_ros.extensions.policies.trial import KKT_TOLERANCE, measured

    trial = trial_of(configuration.shipped("cam_beam", "policy"), configuration.shipped("cam_beam", "model"))
    mpc = ExactMpc(trial.model, trial.policy.problem, tolerance=KKT_TOLERANCE)
    drawn = [trial.scenario(number) for number in range(LOOPS)]
    next(iter(scenarios.run_many(mpc, drawn[:1])))  # compiles
    few, many = (
        count / rate(partial(_certified, partial(measured, trial), count, CHUNK)) for count in (LOOPS, MORE * LOOPS)
    )
    loop = (many - few) / ((MORE - 1) * LOOPS)
    loops = {
        "drawn": rate(lambda: len([trial.scenario(number) for number in range(LOOPS)])),
        "exact": rate(lambda: len([*scenarios.run_many(mpc, drawn)])),
        "certified": 1.0 / loop,
    }
    minutes = (few + (CERTIFIED - LOOPS) * loop) / 60.0
    return {"periods": trial.periods, "loops_per_second": loops, "minutes": minutes}


def _certified(work: Callable[[tuple[int, int]], Any], loops: int, size: int) -> int:
    """Measure so many loops in processes, in pieces of a size; return their number."""
    parallel.run(work, [(begin, min(begin + size, loops)) for begin in range(0, loops, size)])
    return loops


def tightening() -> dict[str, Any]:
    """Loops of the beam whose model is wrong as its covariance says, within a bound on the angle: how many keep it, and
    what they cost, without and with tightening.
    """
    rig, model = load_rig("cam_beam"), load_model(configuration.shipped("cam_beam", "model"))
    system, given = model.system, rig.section("policy_certificate")
    values = configuration.defaults(rig, "controller") | {"state_high": [BOUND, 1e9], "soft_linear": [1e6, 0.0]}
    plain = configuration.mpc_problem(values, rig, system)
    states, offset = tuple(given["state_error"]), tuple(given["disturbance_error"])
    errors: dict[str, Any] = {"states": states, "disturbance": offset, "periods": PERIODS}
    asked = Tightening(share=ASKED["kept"], between=[[LOWER], [REFERENCE]], **errors)
    covariance = covariance_of(model, system)
    began = perf_counter()
    moved = tightened(system, plain, asked, covariance)
    found: dict[str, Any] = {"seconds_to_tighten": perf_counter() - began, "margins_rad": moved.state_margins[0]}
    free = [k for k, item in enumerate(system.parameters) if not item.fixed]
    low, high = np.array([[item.low, item.high] for item in system.parameters]).T

    def drawn(number: int) -> scenarios.Scenario:
        random, parameters = np.random.default_rng([6, number]), system.values.copy()
        parameters[free] = random.multivariate_normal(parameters[free], covariance)
        phase, hold = random.integers(0, 20), random.integers(8, 21)
        wanted = np.where((np.arange(PERIODS + plain.horizon - 1) + phase) // hold % 2, REFERENCE, LOWER)
        nothing = {"states": np.zeros((PERIODS, 2)), "pushes": np.zeros((PERIODS, 2))}
        none = np.zeros((PERIODS, 1))
        return scenarios.Scenario(
            plant=system.with_values(np.clip(parameters, low, high)), begins=np.arange(PERIODS) == 0, **nothing,
            inputs=none, references=wanted[:, None], disturbances=none, input_errors=none,
            state_errors=random.normal(size=(PERIODS, 2)) * np.array(states),
            disturbance_errors=np.full((PERIODS, 1), random.normal() * offset[0]),
        )  # fmt: skip

    for name, problem in (("plain", plain), ("tightened", moved)):
        runs = [run for run, _ in scenarios.run_many(ExactMpc(system, problem), map(drawn, range(TIGHTENED)))]
        found[name] = {
            "kept": float(np.mean([run.excess <= 0.0 for run in runs])),
            "largest_excess_rad": float(max(run.excess for run in runs)),
            "cost": float(np.mean([run.costs.sum() for run in runs])),
        }
    return found


def main() -> int:
    """Run, print tables, write the results."""
    machine, found = result.machine(), {name: compared(name) for name in cases()}
    headings = "problem", "steps", "one thread", f"{CORES} threads", "cold", "acados' batch", "IPOPT's processes"
    shown = Table(*headings, title="solved a second")
    for name, case in found.items():
        figures = [case[key] for key in ("1_threads", f"{CORES}_threads", "cold")]
        figures += [case.get("acados", {}).get("per_second", np.nan), case["ipopt_processes"]]
        shown.add_row(name, f"{case['steps']:.2f}", *(f"{figure:,.0f}" for figure in figures))
    print_table(shown)
    loops = certificate()
    rates = ", ".join(f"{name} {value:.0f}" for name, value in loops["loops_per_second"].items())
    print(f"loops of the beam's certificate a second: {rates}; {loops['minutes']:.1f} min for {CERTIFIED:,}")
    narrow = tightening()
    for name in ("plain", "tightened"):
        print(
            f"{name}: {narrow[name]['kept']:.2%} of {TIGHTENED:,} loops keep the bound, cost {narrow[name]['cost']:.6g}"
        )
    best = f"{CORES}_threads"
    over = min(case[best] / case["ipopt_processes"] for case in found.values())
    acados = found["network"].get("acados")
    over_acados = found["network"][best] / acados["per_second"] if acados else None
    short = [
        name
        for name, falls in {
            "network_per_second": found["network"][best] < ASKED["network_per_second"],
            "over_ipopt": over < ASKED["over_ipopt"],
            "over_acados": over_acados is not None and over_acados <= ASKED["over_acados"],
            "certificate_minutes": loops["minutes"] > ASKED["certificate_minutes"],
            "tightened": narrow["tightened"]["kept"] < ASKED["kept"] or narrow["plain"]["kept"] >= ASKED["plain"],
        }.items()
        if falls
    ]
    print(f"short: {', '.join(short) or 'none'}")
    written = {
        "cases": found,
        "certificate": loops,
        "tightening": narrow,
        "least_over_ipopt": over,
        "network_over_acados": over_acados,
        "asked": ASKED,
        "short": len(short),
    }
    print(result.write(NAME, written, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
