"""Near misses: instances about those where a network is off, so that it learns where an answer jumps or bends."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.horizon import instance_of
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.policies.samples import TrainingSamples, kept_samples
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import Spread
from hybrid_sysid_ros.support.arrays import Array

OFF = 0.03
"""Error of a first input from which on it is a miss, half the distance of the input's bounds being 1."""

MOST = 4000
"""Misses that are looked at: others are like them, and each process gets them."""

CHUNK = 2000
"""Instances that a process answers between two looks."""

NEAR = 0.3
"""Deviation of the instances from a miss, in pushes, disturbances and jitters of the training, at most."""

LEAST = 1e-3
"""Least difference of two plans that are not the same solution, in the inputs' units."""

SHARE = 0.1
"""Number of answers near misses to that of the samples so far."""


def chunks_of(samples: TrainingSamples) -> int:
    """Chunks of answers near misses for some samples."""
    return math.ceil(SHARE * len(samples.plans) / CHUNK)


def misses(policy: Policy, samples: TrainingSamples, seed: int) -> NDArray[np.int64]:
    """The samples (misses,) at which a policy's first input is off, up to :data:`MOST`."""
    low, high = np.array(policy.problem.input_low), np.array(policy.problem.input_high)
    answers = np.clip(policy.evaluate(policy.features(samples.instances))[:, 0], low, high)
    errors = np.max(np.abs(answers - samples.plans[:, 0]) / (0.5 * (high - low)), axis=1)
    found = np.flatnonzero(errors > OFF)
    chosen = np.random.default_rng(seed).permutation(found)[:MOST]
    return np.sort(chosen)


def cheaper_plans(mpc: ExactMpc, policy: Policy, instances: Array, plans: Array) -> Array:
    """The plans (rows, N, m), or those to which a policy's own lead where they cost less: a problem may have several
    local solutions, and a certificate compares with the cheapest that it finds.
    """
    starts = np.repeat(plans[:, :1], plans.shape[1], axis=1)
    answers = policy.evaluate(policy.features(instances))
    starts[:, : answers.shape[1]], starts[:, answers.shape[1] :] = answers, answers[:, -1:]
    found, cheapest = mpc.solve_many(instances, starts, threads=1), plans.copy()
    n, m, p = len(mpc.system.states), len(mpc.system.inputs), len(mpc.system.outputs)
    for row in np.flatnonzero(found.solved & (np.abs(found.inputs - plans) > LEAST).any(axis=(1, 2))):
        mpc.instance.assign(*instance_of(instances[row], n, m, p))
        if mpc.follow(found.inputs[row])[0] < mpc.follow(plans[row])[0]:
            cheapest[row] = found.inputs[row]
    return cheapest


def near_misses(
    system: System,
    problem: ControlProblem,
    spread: Spread,
    policy: Policy,
    missed: Array,
    seed: int,
    *,
    followed: Mapping[str, float],
) -> dict[str, NDArray[np.float64]]:
    """:class:`~.samples.TrainingSamples` as arrays: :data:`CHUNK` instances near ``missed`` ones, each answered from a
    cold start, since a plan before would decide on which side of a jump an answer is, and from the policy's plan.

    System, problem and spread are sized for each other.
    """
    random, (n, m) = np.random.default_rng(seed), (len(system.states), len(system.inputs))
    asked = missed[random.integers(len(missed), size=CHUNK)]
    size = NEAR * np.concatenate([spread.push, spread.disturbance, spread.input_jitter])
    asked[:, : n + 2 * m] += size * random.uniform(size=(CHUNK, 1)) * random.normal(size=(CHUNK, n + 2 * m))
    previous = asked[:, n + m : n + 2 * m]
    np.clip(previous, problem.input_low, problem.input_high, out=previous)
    begins = np.ones(CHUNK, np.bool_)
    mpc = ExactMpc(system, problem)
    answers = mpc.solve_sequence(asked, begins, attempts=2)
    answers.inputs[:] = cheaper_plans(mpc, policy, asked, answers.inputs)
    return kept_samples(system, problem, asked, begins, answers, answers.solved, followed).arrays
