"""The approximate MPC beside the exact one: what its loops cost more, and what a call takes.

Two problems. The lecture's: its polynomial NARX and cost, for which it trained a network (MLP 15-64-64-1) on 6000
samples of one closed loop; here a policy is trained for it by each of the seeds, and scored on closed loops of the
exact MPC along the lecture's own reference, with noise, which no training saw; beside that on held-out loops of the
training's kind, which begin anew at outputs and inputs that don't belong together. The beam's: the shipped policy and
the exact MPC drive the same plants, the simulated rig with its parameters spread, along random references; neither
those plants nor those references were trained on. Times are those around the Python call, of the policy and of IPOPT
alike, each in a loop of its own; beside them the network alone, whose question stands in memory, which is what the
lecture measured.

--train also trains the beam's policy by three seeds, as `hybrid-sysid policy train` does, and scores each like the
shipped one (a quarter of an hour and more).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numba
import numpy as np
from rich.markup import escape
from rich.table import Table

from benchmarks import result
from benchmarks.mpc_speed import Case, cases, loop
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.control import Controller, ControlProblem, ExactMpc
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.policy.kernels import network_answer
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import OPTIONS
from hybrid_sysid_ros.extensions.ipopt.interior_point import InteriorPointMpc
from hybrid_sysid_ros.extensions.policies.configured import train_configured_policy
from hybrid_sysid_ros.extensions.shared import drawn_scenarios, scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import Spread
from hybrid_sysid_ros.extensions.shared.reference_kinds import references
from hybrid_sysid_ros.extensions.shared.scenarios import Scenario
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.extras import extra

NAME = "policy"
SEEDS = (0, 1, 2)
RIG = "cam_beam"
LECTURE = {"validation_mse": 0.0664, "milliseconds": 0.11, "ipopt_milliseconds": 2.32, "samples": 6000}
"""What the lecture states of its network."""

LECTURE_AMPLITUDE = 5.0
"""Of the references [V]."""
LECTURE_PUSH = (0.1, 0.1, 0.1, 0.3, 0.3)
LECTURE_SETTINGS = Settings(episodes=(200, 200, 200), hidden=(64, 64), epochs=60, sequence=False)
LOOPS, SECONDS = 100, 4.0
"""Closed loops of the beam for each seed, and their length [s]."""

FIRST_SEED = 900_000_000
"""Of the beam's loops: no training comes so far."""

CALLS = 20_000
"""Of the policy on one question after another, to measure their time."""


def main(arguments: list[str]) -> int:
    """Run, print tables, write the results."""
    parser = argparse.ArgumentParser(prog="benchmarks.policy")
    parser.add_argument("--train", action="store_true", help="train the beam's policy as well, by three seeds")
    train = parser.parse_args(arguments).train
    machine = result.machine()
    results = {"lecture": lecture(), "beam": beam(train)}
    shown = Table("quantity", "mean", "min", "max", title="policy")
    for problem, values in results.items():
        for key, value in values.items():
            name = escape(f"{problem}: {key}")
            if isinstance(value, dict) and {"mean", "min", "max"} <= value.keys():
                shown.add_row(name, *(f"{value[part]:.4g}" for part in ("mean", "min", "max")))
            elif isinstance(value, dict):
                shown.add_row(name, ", ".join(f"{part} {item:.4g}" for part, item in value.items()))
            else:
                shown.add_row(name, f"{value:.4g}")
    print_table(shown)
    print(result.write(NAME, results, on=machine))
    return 0


def lecture() -> dict[str, Any]:
    """Policies of the lecture's problem by each seed: their errors, and their time beside IPOPT's."""
    case = cases()["lecture"]
    model = Model(
        rig="lecture",
        structure="narx",
        system=case.system,
        sampling=Sampling(),
        names=(),
        covariance=np.zeros((0, 0)),
        training_range={},
        seal="lecture",
    )
    with extra("train"):
        from hybrid_sysid_ros.extensions.policies.training import train
    amplitude = LECTURE_AMPLITUDE * case.problem.output_scales[0]
    spread = Spread(amplitude=(amplitude,), disturbance=(0.0,), input_jitter=(1.0,), push=LECTURE_PUSH)
    policies = [train(model, case.problem, spread, LECTURE_SETTINGS, seed=seed) for seed in SEEDS]
    runs = [loop(case, seed, InteriorPointMpc(case.system, case.problem)) for seed in SEEDS]
    ipopt = result.percentiles(1e3 * np.concatenate([run["times"]["call"] for run in runs]))
    questions, answers = hardware_run(case)
    times = result.percentiles(1e3 * np.array(call_times(policies[0], questions)))
    alone = result.percentiles(1e3 * np.array(network_times(policies[0], questions)))
    on_reference = [np.mean((answered(each, questions) - answers) ** 2) for each in policies]
    costs = [cost_ratio(case, each, seed) for seed, each in zip(SEEDS, policies, strict=True)]
    return {
        "lecture's validation MSE [V^2]": LECTURE["validation_mse"],
        "MSE on held-out loops from any beginning [V^2]": result.spread(
            [each.training["validation_mse"] for each in policies]
        ),
        "validation MSE, hardware reference [V^2]": result.spread(on_reference),
        "cost to exact, hardware reference": result.spread(costs),
        "samples": policies[0].training["samples"],
        "training, sampling included [s]": result.spread([each.training["seconds"] for each in policies]),
        "call [ms]": times,
        "network alone [ms]": alone,
        "IPOPT's call [ms]": ipopt,
        "IPOPT's call to the policy's, p50": ipopt["p50"] / times["p50"],
        "IPOPT's call to the network alone, p50": ipopt["p50"] / alone["p50"],
        "lecture's IPOPT to its network": LECTURE["ipopt_milliseconds"] / LECTURE["milliseconds"],
    }


def hardware_run(case: Case) -> tuple[list[tuple[Array, ...]], Array]:
    """What the exact MPC is asked along the hardware reference with noise, and its answers (samples,)."""
    questions: list[tuple[Array, ...]] = []
    answers: list[float] = []

    class Recorded(ExactMpc):
        """The exact MPC, whose questions and answers are kept."""

        def control(self, *question: Array) -> Any:
            plan = super().control(*question)
            questions.append(tuple(part.copy() for part in question))
            answers.append(float(plan.input[0]))
            return plan

    for seed in SEEDS:
        loop(case, seed, Recorded(case.system, case.problem))
    return questions, np.array(answers)


def answered(imitation: Policy, questions: list[tuple[Array, ...]]) -> Array:
    """Answers (samples,) of a policy."""
    return np.array([imitation.control(*question).input[0] for question in questions])


def cost_ratio(case: Case, imitation: Policy, seed: int) -> float:
    """Cost of the loop under a policy to that under the exact MPC, with the same noise."""
    costs = [loop(case, seed, each)["cost"] for each in (imitation, ExactMpc(case.system, case.problem))]
    return float(costs[0] / costs[1])


def call_times(imitation: Policy, questions: list[tuple[Array, ...]]) -> list[float]:
    """Seconds of each of the calls, one question after another."""
    times = []
    imitation.control(*questions[0])  # compiles
    for index in range(CALLS):
        question = questions[index % len(questions)]
        began = perf_counter()
        imitation.control(*question)
        times.append(perf_counter() - began)
    return times


def network_times(imitation: Policy, questions: list[tuple[Array, ...]]) -> list[float]:
    """Seconds of each call of the network alone, bounds included: its question stands in memory."""
    rows = [np.concatenate([np.ravel(part) for part in question]) for question in questions]
    alone = numba.njit("b1(i8[::1], f8[::1], f8[::1], f8[:, ::1])", **OPTIONS)(network_answer)
    plan = np.empty((imitation.stages, imitation.inputs))
    times = []
    for index in range(CALLS):
        row = rows[index % len(rows)]
        began = perf_counter()
        alone(*imitation.packed, row, plan)
        times.append(perf_counter() - began)
    return times


def beam(train: bool) -> dict[str, Any]:
    """The shipped policy against the exact MPC on plants and references that it never saw."""
    rig, model = load_rig(RIG), load_model(configuration.shipped(RIG, "model"))
    shipped = policy.load(configuration.shipped(RIG, "policy"), model=model)
    spread = drawn_scenarios.spread_of(rig, model.system)
    exact = costs(ExactMpc(model.system, shipped.problem), shipped.problem, rig.system, spread)
    questions: list[tuple[Array, ...]] = []
    own = costs(shipped, shipped.problem, rig.system, spread, questions)
    ratios, totals = own / exact, own.sum(axis=1) / exact.sum(axis=1)
    found: dict[str, Any] = {
        "loops": ratios.size,
        "cost to exact": result.spread(totals),
        "cost to exact, single loops": {
            "p50": float(np.median(ratios)),
            "p95": float(np.percentile(ratios, 95)),
            "max": float(ratios.max()),
        },
        "call [ms]": result.percentiles(1e3 * np.array(call_times(shipped, questions))),
        "network alone [ms]": result.percentiles(1e3 * np.array(network_times(shipped, questions))),
        "validation MSE [V^2]": shipped.training["validation_mse"],
        "samples": shipped.training["samples"],
        "training, sampling included [s]": shipped.training["seconds"],
    }
    if train:
        trained = [train_configured_policy(model, seed=seed, progress=_reported()) for seed in SEEDS]
        totals = np.array([costs(each, each.problem, rig.system, spread).sum() for each in trained]) / exact.sum()
        found |= {
            "cost to exact, by seeds of training": result.spread(totals),
            "validation MSE, by seeds of training [V^2]": result.spread(
                [each.training["validation_mse"] for each in trained]
            ),
            "seconds, by seeds of training": result.spread([each.training["seconds"] for each in trained]),
        }
    return found


def costs(
    controller: Controller,
    problem: ControlProblem,
    system: System,
    spread: Spread,
    questions: list[tuple[Array, ...]] | None = None,
) -> Array:
    """Cost (seeds, loops) of loops from a random state along a random reference; ``questions`` receives what was asked.

    system: of the plants, whose parameters and input offset are spread. The state is known without noise.
    """
    found = np.empty((len(SEEDS), LOOPS))
    for row, seed in enumerate(SEEDS):
        for column in range(LOOPS):
            random = np.random.default_rng(FIRST_SEED + 1000 * seed + column)
            found[row, column] = cost(controller, problem, system, spread, random, questions)
    return found


def cost(
    controller: Controller,
    problem: ControlProblem,
    system: System,
    spread: Spread,
    random: np.random.Generator,
    questions: list[tuple[Array, ...]] | None,
) -> float:
    """Cost of one loop, by the weights of the problem."""
    periods = round(SECONDS / problem.period)
    wanted = references(random, spread, problem)(problem.period * np.arange(1, periods + problem.horizon))
    begins = np.arange(periods) == 0
    none = np.zeros((periods, len(system.states)))
    scenario = Scenario(
        plant=drawn_scenarios.plant_near(system, spread.parameters, random),
        begins=begins,
        states=drawn_scenarios.beginnings(random, system, problem, spread, wanted[:periods], begins),
        inputs=np.zeros((periods, len(system.inputs))),
        references=wanted,
        disturbances=np.tile(random.normal(size=len(system.inputs)) * np.array(spread.disturbance), (periods, 1)),
        pushes=none,
        state_errors=none,
        disturbance_errors=np.zeros((periods, len(system.inputs))),
        input_errors=np.zeros((periods, len(system.inputs))),
    )
    controller.reset()

    def control(k: int, asked: Instance) -> Array:
        if questions is not None:
            questions.append(tuple(part.copy() for part in asked))
        given = controller.control(*asked).input
        controller.prepare(problem.period)
        return given

    return float(scenarios.run(scenario, problem, control).costs.sum())


def _reported() -> Callable[[str, int, int], None]:
    def tell(stage: str, done: int, of: int) -> None:
        if done == of:
            print(f"  {stage}: {of}", flush=True)

    return tell


if __name__ == "__main__":
    result.run(lambda: main(sys.argv[1:]))
