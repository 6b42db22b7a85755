"""Training of the approximate MPC: rounds of samples (DAgger), and a network that learns from them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from hybrid_sysid_ros.control.policy.adaptation import Correction
from hybrid_sysid_ros.control.policy.network import (
    AT_BOUND,
    beyond_bounds,
    descend,
    in_double,
    layers_of,
    new_network,
    passed,
    single,
    slope_errors,
)
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.policy.sample_store import SampleStore
from hybrid_sysid_ros.control.policy.sampling import Samples, Spread, sample
from hybrid_sysid_ros.control.policy.sampling_pool import SamplingPool
from hybrid_sysid_ros.control.policy.training_range import TrainingRange
from hybrid_sysid_ros.control.policy.training_settings import MOST_EPISODES, Settings
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.threads import one_torch_thread

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
"""progress(stage, done, of)"""

VALIDATION_SHARE = 0.1
"""Share of the closed loops, whole ones, that training never sees."""

CHECKS = 64
"""Self-check vectors."""

LEAST_COST = 0.01
"""Of a loop, in the mean of all: below it no loop's samples count for more."""

LEAST_DEVIATION = 1e-6
"""A feature that varies less [its unit] says nothing and is not blown up."""


def train(
    model: Model,
    problem: Problem,
    spread: Spread,
    settings: Settings,
    *,
    seed: int,
    store: SampleStore | None = None,
    progress: Progress | None = None,
) -> Policy:
    """Sample the exact MPC on a model and train a policy that imitates it.

    Each round adds closed loops to the data and trains on from the last network. Reports the mean squared error of
    held-out loops in drive units squared, on inputs within the bounds. store: where finished loops are kept, so that an
    interrupted training goes on. Raises UserError where the MPC finds no solution.
    """
    began = time.perf_counter()
    settings.adaptation.nominal(model.system)
    parts: list[Samples] = []
    held: list[Samples] = []
    policy: Policy | None = None
    network: torch.nn.Module | None = None
    sampling = 0.0
    with one_torch_thread(torch), SamplingPool(settings.workers, store) as pool:
        for number, episodes in enumerate(settings.episodes):
            started = time.perf_counter()
            work = partial(
                sample,
                model.system,
                problem,
                spread,
                driver=policy,
                slope_share=settings.slope_share if settings.slope_weight else 0.0,
                adaptation=settings.adaptation,
            )
            seeds = [seed * 1_000_003 + MOST_EPISODES * number + index for index in range(episodes)]
            report = partial(progress or _silent, f"round {number + 1}: closed loops of the exact MPC")
            new = pool.run(work, seeds, report)
            sampling += time.perf_counter() - started
            validation = max(1, round(VALIDATION_SHARE * episodes))
            held += new[:validation]
            parts += new[validation:]
            last = number == len(settings.episodes) - 1
            epochs = settings.epochs if last else -(-settings.epochs // 3)
            report = partial(progress or _silent, f"round {number + 1}: epochs of training")
            samples, unseen = Samples.joined(parts), Samples.joined(held)
            network, policy = _fit(model, problem, samples, unseen, settings, epochs, seed, network, report)
    assert policy is not None
    if settings.adaptation.names:
        policy = _corrected(policy, model, samples, settings, seed, progress or _silent)
    measured = {
        **policy.training,
        "seed": seed,
        "rounds": list(settings.episodes),
        "samples": len(samples.inputs),
        "validation_samples": len(unseen.inputs),
        "dropped": samples.dropped + unseen.dropped,
        "sampling_seconds": round(sampling, 1),
        "seconds": round(time.perf_counter() - began, 1),
    }
    return replace(policy, training=measured)


def _silent(stage: str, done: int, of: int) -> None:
    pass


def _fit(
    model: Model,
    problem: Problem,
    samples: Samples,
    held: Samples,
    settings: Settings,
    epochs: int,
    seed: int,
    start: torch.nn.Module | None,
    progress: Callable[[int, int], None],
) -> tuple[torch.nn.Module, Policy]:
    if not len(samples.inputs) or not len(held.inputs):
        raise UserError("policy: the exact MPC found no solution in its closed loops; allow it more iterations")
    output, limit = model.system.measured[0], problem.input_high[0]
    raw = samples.features(output)
    centre, deviation = raw.mean(axis=0), raw.std(axis=0)
    scale = np.where(deviation > LEAST_DEVIATION, deviation, 1.0)
    outputs = problem.horizon if settings.sequence else 1
    inputs = single((raw - centre) / scale)
    targets = single(samples.inputs[:, :outputs] / limit)
    weights = torch.full((outputs,), settings.plan_weight / max(outputs - 1, 1))
    weights[0] = 1.0
    counts = (samples.costs + LEAST_COST * samples.costs.mean()) ** -settings.levelling
    shares = single(counts / counts.mean())
    slopes = single(samples.feature_slopes(output) * scale / limit) if settings.slope_weight else None

    def loss(network: torch.nn.Module, rows: torch.Tensor) -> torch.Tensor:
        answers, hidden = passed(network, inputs[rows])
        errors = (beyond_bounds(answers, targets[rows]) ** 2) @ weights
        if slopes is not None:
            # At a bound the answer is cut, and flat: a network made flat up to there would be wrong on the near side.
            known = torch.isfinite(slopes[rows, 0]) & (targets[rows, 0].abs() < AT_BOUND)
            off = slope_errors(network, [values[known] for values in hidden], slopes[rows[known]])
            errors = errors.index_add(0, torch.nonzero(known)[:, 0], settings.slope_weight * off)
        return torch.mean(shares[rows] * errors)

    network = new_network([raw.shape[1], *settings.hidden, outputs], seed)
    if start is not None:
        network.load_state_dict(start.state_dict())
    descend(network, loss, len(targets), settings, epochs, seed, progress)
    check = held.features(output)[:: max(1, len(held.inputs) // CHECKS)][:CHECKS]
    policy = Policy(
        problem=problem,
        model=model.seal,
        rig=model.rig,
        states=len(model.system.states),
        output=output,
        centre=centre,
        scale=scale,
        layers=layers_of(network),
        training_range=TrainingRange.of(raw, centre, scale),
        check=(check, in_double(network, (check - centre) / scale) * limit),
    )
    return network, replace(policy, training=_errors(policy, samples, held))


def _corrected(
    policy: Policy, model: Model, samples: Samples, settings: Settings, seed: int, progress: Progress
) -> Policy:
    """The policy with a second network for the derivatives of its answers by the followed parameters."""
    adaptation, count = settings.adaptation, len(samples.inputs)
    inputs = single((samples.features(policy.output) - policy.centre) / policy.scale)
    targets = single(samples.shifts[:, :, : policy.outputs].reshape(count, -1) / policy.problem.input_high[0])

    def loss(network: torch.nn.Module, rows: torch.Tensor) -> torch.Tensor:
        return torch.mean((network(inputs[rows]) - targets[rows]) ** 2)

    network = new_network([inputs.shape[1], *settings.hidden, targets.shape[1]], seed)
    descend(network, loss, count, settings, settings.epochs, seed, partial(progress, "correction: epochs of training"))
    correction = Correction(
        names=adaptation.names,
        nominal=adaptation.nominal(model.system),
        spread=np.array(adaptation.spread),
        layers=layers_of(network),
    )
    return replace(policy, correction=correction)


def _errors(policy: Policy, samples: Samples, held: Samples) -> dict[str, float]:
    """Mean squared errors of bounded first inputs [drive unit squared], and of those after them in the plan."""
    limit, errors = policy.problem.input_high[0], {}
    for name, part in (("train", samples), ("validation", held)):
        answers = np.clip(policy.evaluate(part.features(policy.output)), -limit, limit)
        squares = np.mean((answers - part.inputs[:, : policy.outputs]) ** 2, axis=0)
        errors[f"{name}_mse"] = float(squares[0])
        if policy.outputs > 1:
            errors[f"{name}_plan_mse"] = float(squares[1:].mean())
    return errors
