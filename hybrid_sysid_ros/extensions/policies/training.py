"""Training of the approximate MPC: rounds of samples (DAgger), and a network that learns from them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.policy.kernels import TrainingRange
from hybrid_sysid_ros.control.policy.policy import Correction, Policy, policy_features
from hybrid_sysid_ros.control.policy.training_settings import MOST_EPISODES, Settings
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.extensions.policies.idle_states import without_idle
from hybrid_sysid_ros.extensions.policies.mirror import mirror_of
from hybrid_sysid_ros.extensions.policies.near_misses import cheaper_plans, chunks_of, misses, near_misses
from hybrid_sysid_ros.extensions.policies.network import (
    beyond_bounds,
    descend,
    in_double,
    layers_of,
    new_network,
    saturating,
    single,
)
from hybrid_sysid_ros.extensions.policies.samples import TrainingSamples, sampled
from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import Spread
from hybrid_sysid_ros.extensions.shared.parallel import Store
from hybrid_sysid_ros.extensions.shared.steady_motion import steady_motion
from hybrid_sysid_ros.extensions.shared.torch_threads import one_torch_thread
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array, NamedArrays
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.progress import StageProgress

VALIDATION_SHARE = 0.1
"""Share of the closed loops, whole ones, that training never sees."""

REFINEMENTS = 3
"""Times that a network learns on beside near misses, after its last round."""

REFINED_PLAN = 1.0 / 3.0
"""Factor of the weight of later inputs then: what is missed is the first."""

CHECKS = 64
"""Self-check vectors."""

LEAST_DEVIATION = 1e-6
"""A feature that varies less [its unit] says nothing and is not blown up."""


def train(
    model: Model,
    problem: ControlProblem,
    spread: Spread,
    settings: Settings,
    *,
    seed: int,
    store: Store[NamedArrays] | None = None,
    progress: StageProgress | None = None,
) -> Policy:
    """Sample the exact MPC on a model and train a policy that imitates it.

    Each round adds closed loops to the data and trains on from the last network. Then the network learns on beside
    answers near those that it misses. Reports the mean squared error of held-out loops in the inputs' units squared, on
    inputs within the bounds. store: where finished loops are kept, so
    that an interrupted training goes on. Raises UserError where the MPC finds no solution.
    """
    began, sampling, progress = time.perf_counter(), 0.0, progress or _silent
    for name in settings.followed:
        if name not in model.system.named:
            raise UserError(f"policy: {type(model.system).__name__} has no parameter {name} to follow")
    problem, spread = problem.sized(model.system), spread.sized(model.system)
    taught = tightened(problem, settings.margin)
    parts: list[NamedArrays] = []
    held: list[NamedArrays] = []
    policy: Policy | None = None
    network: torch.nn.Module | None = None
    work: Callable[[int], NamedArrays]
    run = partial(parallel.run, workers=settings.workers, cluster=settings.cluster, store=store)
    with one_torch_thread(torch):
        for number, episodes in enumerate(settings.episodes):
            started, name = time.perf_counter(), f"round {number + 1}"
            work = partial(sampled, model.system, taught, spread, driver=policy, followed=settings.followed)
            report = partial(progress, f"{name}: closed loops of the exact MPC")
            new = run(work, _seeds(seed, number, episodes), progress=report)
            sampling += time.perf_counter() - started
            validation = max(1, round(VALIDATION_SHARE * episodes))
            held += new[:validation]
            parts += new[validation:]
            last = number == len(settings.episodes) - 1
            epochs = settings.epochs if last else -(-settings.epochs // 3)
            data = _TrainingData.of(model, problem, spread, TrainingSamples.joined(parts), TrainingSamples.joined(held))
            network, policy = _fit(
                model, data, settings, epochs, seed, network, partial(progress, f"{name}: epochs of training")
            )
        assert policy is not None
        for number in range(len(settings.episodes), len(settings.episodes) + REFINEMENTS):
            started, name = time.perf_counter(), f"refinement {number - len(settings.episodes) + 1}"
            missed = misses(policy, data.samples, seed)
            if not len(missed):
                break
            samples, mpc = data.samples, ExactMpc(model.system, taught)
            near = samples.instances[missed]
            plans = samples.plans.copy()
            plans[missed] = cheaper_plans(mpc, policy, near, plans[missed])
            parts = [replace(samples, plans=plans).arrays]
            work = partial(near_misses, model.system, taught, spread, policy, near, followed=settings.followed)
            report = partial(progress, f"{name}: answers near misses")
            parts += run(work, _seeds(seed, number, chunks_of(data.samples)), progress=report)
            sampling += time.perf_counter() - started
            data = _TrainingData.of(model, problem, spread, TrainingSamples.joined(parts), TrainingSamples.joined(held))
            report = partial(progress, f"{name}: epochs of training")
            network, policy = _fit(model, data, settings, -(-settings.epochs // 3), seed, network, report, refined=True)
    if settings.followed:
        policy = _corrected(policy, model, data, settings, seed, progress)
    measured = {
        **policy.training,
        "seed": seed,
        "margin": settings.margin,
        "rounds": list(settings.episodes),
        "samples": len(data.samples.plans),
        "validation_samples": len(data.held.plans),
        "dropped": int(data.samples.dropped.sum() + data.held.dropped.sum()),
        "sampling_seconds": round(sampling, 1),
        "seconds": round(time.perf_counter() - began, 1),
    }
    return replace(policy, training=measured)


def _seeds(seed: int, number: int, count: int) -> list[int]:
    """Seeds of what a round samples."""
    return [seed * 1_000_003 + MOST_EPISODES * number + index for index in range(count)]


def tightened(problem: ControlProblem, margin: float) -> ControlProblem:
    """A sized problem whose states have tighter bounds, by a share of the range of those that have two."""
    low, high = np.array(problem.state_low), np.array(problem.state_high)
    change = np.where(np.isfinite(high - low), margin * np.where(np.isfinite(high - low), high - low, 0.0), 0.0)
    return replace(problem, state_low=tuple((low + change).tolist()), state_high=tuple((high - change).tolist()))


def _silent(stage: str, done: int, of: int) -> None:
    pass


@dataclass(frozen=True, kw_only=True, eq=False)
class _TrainingData:
    """What a network is trained on: features, and answers in units in which an input's bounds are -1 and 1."""

    problem: ControlProblem
    output_map: Array
    """(tracked, n)."""
    tracked: tuple[int, ...]
    samples: TrainingSamples
    held: TrainingSamples
    still: Array
    """(features, features), which takes from raw features what nothing depends on."""
    features: Array
    """(samples, features), without that."""
    centre: Array
    """(features,)."""
    scale: Array
    mirror: Array | None
    """(features,), signs with which an answer changes its own; None where it does not."""
    middle: Array
    """(m,) of the inputs' bounds."""
    half: Array
    """(m,), half the distance of the bounds."""

    @classmethod
    def of(
        cls, model: Model, problem: ControlProblem, spread: Spread, samples: TrainingSamples, held: TrainingSamples
    ) -> _TrainingData:
        """Raises UserError where one part is empty."""
        if not len(samples.plans) or not len(held.plans):
            raise UserError("policy: the exact MPC found no solution in its closed loops; allow it more iterations")
        output_map = steady_motion(model.system, problem, np.array(spread.centre)).output_map
        tracked = tuple(k for k, weight in enumerate(problem.output_weights) if weight > 0)
        low, high = np.array(problem.input_low), np.array(problem.input_high)
        features = policy_features(samples.instances, output_map, tracked, len(low), len(problem.output_weights))
        states, still = len(model.system.states), np.eye(features.shape[1])
        still[:states, :states] = without_idle(model.system, problem)
        features, centre = features @ still.T, features.mean(axis=0) @ still.T
        mirror = _mirror(model, problem, samples.instances[:: max(1, len(samples.instances) // CHECKS)], still)
        if mirror is not None:  # of the samples and their images
            centre = np.where(mirror < 0.0, 0.0, centre)
        deviation = np.sqrt(np.mean((features - centre) ** 2, axis=0))
        return cls(
            problem=problem,
            output_map=output_map,
            tracked=tracked,
            samples=samples,
            held=held,
            still=still,
            features=features,
            centre=centre,
            scale=np.where(deviation > LEAST_DEVIATION, deviation, 1.0),
            mirror=mirror,
            middle=0.5 * (low + high),
            half=0.5 * (high - low),
        )

    def features_of(self, instances: Array) -> Array:
        """Raw features (samples, features) of flat instances."""
        return policy_features(
            instances, self.output_map, self.tracked, len(self.half), len(self.problem.output_weights)
        )

    @property
    def onto_raw(self) -> Array:
        """(features, features): what standardised features are of standardised raw ones. Layers and ranges that are
        multiplied by it take these, so that a policy need not know what is idle.
        """
        folded: Array = self.still * self.scale / self.scale[:, None]
        return folded.copy()

    def folded(self, network: torch.nn.Module) -> tuple[tuple[Array, Array], ...]:
        """The layers of a network on standardised raw features."""
        (weights, bias), *others = layers_of(network)
        return (weights @ self.onto_raw, bias), *others

    @property
    def standardised(self) -> torch.Tensor:
        return single((self.features - self.centre) / self.scale)


def _mirror(model: Model, problem: ControlProblem, instances: Array, still: Array) -> Array | None:
    """The signs (features,) of mirrored features, where the answers at some instances have images."""
    n, m = len(model.system.states), len(problem.input_low)
    signs = mirror_of(model.system, problem, instances[:, :n], instances[:, n + m : n + 2 * m])
    if signs is None:
        return None
    found = np.full(len(still), -1.0)
    found[:n] = signs
    return found if np.array_equal(still * found, found[:, None] * still) else None


def _fit(
    model: Model,
    data: _TrainingData,
    settings: Settings,
    epochs: int,
    seed: int,
    start: torch.nn.Module | None,
    progress: Callable[[int, int], None],
    *,
    refined: bool = False,
) -> tuple[torch.nn.Module, Policy]:
    problem, samples = data.problem, data.samples
    stages, count = problem.horizon if settings.sequence else 1, len(data.half)
    inputs = data.standardised
    plans = (samples.plans[:, :stages] - data.middle) / data.half
    targets = single(plans.reshape(len(plans), -1))
    later = settings.plan_weight * (REFINED_PLAN if refined else 1.0)
    weights = torch.full((stages, count), later / max(stages - 1, 1) / count)
    weights[0] = 1.0 / count
    weights, random = weights.ravel(), torch.Generator().manual_seed(seed)
    signs = None if data.mirror is None else single(data.mirror)

    def loss(network: torch.nn.Module, rows: torch.Tensor) -> torch.Tensor:
        asked, wanted = inputs[rows], targets[rows]
        if signs is not None:
            turned = torch.rand((len(rows), 1), generator=random) < 0.5
            asked, wanted = torch.where(turned, signs * asked, asked), torch.where(turned, -wanted, wanted)
        errors = beyond_bounds(network(asked), wanted)
        return torch.mean((saturating(errors) if refined else errors**2) @ weights)

    network = new_network([inputs.shape[1], *settings.hidden, stages * count], seed)
    if start is not None:
        network.load_state_dict(start.state_dict())
    descend(network, loss, len(targets), settings, epochs, seed, progress)
    held = data.held.instances
    check = data.features_of(held[:: max(1, len(held) // CHECKS)][:CHECKS])
    answers = in_double(network, (check @ data.still.T - data.centre) / data.scale).reshape(len(check), stages, count)
    policy = Policy(
        problem=problem,
        model=model.seal,
        rig=model.rig,
        output_map=data.output_map,
        centre=data.centre,
        scale=data.scale,
        layers=data.folded(network),
        training_range=TrainingRange.of(data.features, data.centre, data.scale).onto(data.onto_raw),
        check=(check, data.middle + data.half * answers),
    )
    return network, replace(policy, training=_errors(policy, data))


def _corrected(
    policy: Policy, model: Model, data: _TrainingData, settings: Settings, seed: int, progress: StageProgress
) -> Policy:
    """The policy with a second network for the derivatives of its answers by the followed parameters."""
    followed, inputs = settings.followed, data.standardised
    shifts = data.samples.shifts[:, :, : policy.stages] / data.half
    targets = single(shifts.reshape(len(shifts), -1))

    def loss(network: torch.nn.Module, rows: torch.Tensor) -> torch.Tensor:
        return torch.mean((network(inputs[rows]) - targets[rows]) ** 2)

    network = new_network([inputs.shape[1], *settings.hidden, targets.shape[1]], seed)
    report = partial(progress, "correction: epochs of training")
    descend(network, loss, len(targets), settings, settings.epochs, seed, report)
    correction = Correction(
        names=tuple(followed),
        nominal=np.array([model.system.named[name] for name in followed]),
        spread=np.array([*followed.values()]),
        layers=data.folded(network),
    )
    return replace(policy, correction=correction)


def _errors(policy: Policy, data: _TrainingData) -> dict[str, float]:
    """Mean squared errors of bounded first inputs [their units squared], and of those after them in the plan."""
    errors = {}
    for name, part in (("train", data.samples), ("validation", data.held)):
        answers = policy.evaluate(policy.features(part.instances))
        bounded = np.clip(answers, policy.problem.input_low, policy.problem.input_high)
        squares = np.mean((bounded - part.plans[:, : policy.stages]) ** 2, axis=(0, 2))
        errors[f"{name}_mse"] = float(squares[0])
        if policy.stages > 1:
            errors[f"{name}_plan_mse"] = float(squares[1:].mean())
    return errors
