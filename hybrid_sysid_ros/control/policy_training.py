"""Training of the approximate MPC: DAgger rounds of samples, then a network in torch. Nothing else imports torch."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from multiprocessing import get_context

import numpy as np
import torch
from numpy.typing import NDArray

from hybrid_sysid_ros.control.policy import Policy
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.control.sample_store import SampleStore
from hybrid_sysid_ros.control.sampling import Samples, Spread, sample
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.threads import ONE_THREAD, one_torch_thread

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
"""progress(stage, done, of)"""

VALIDATION_SHARE = 0.1
"""Share of the closed loops, whole ones, that training never sees."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """episodes: closed loops of each round; the first is driven by the MPC, later ones by the policy so far (DAgger).
    hidden: widths of the tanh layers. epochs, batch, rate: of Adam, the rate falling along a cosine. workers: processes
    that sample, 0 for one per core. Earlier rounds train for a third of the epochs.
    """

    episodes: tuple[int, ...] = (70, 70, 70)
    hidden: tuple[int, ...] = (64, 64)
    epochs: int = 300
    batch: int = 512
    rate: float = 3e-3
    workers: int = 0

    def __post_init__(self) -> None:
        if not self.episodes or min(self.episodes) < 2:
            raise UserError(f"policy: episodes {self.episodes}: needs at least 2 closed loops in every round")
        if min((self.epochs, self.batch, *self.hidden)) < 1:
            raise UserError("policy: epochs, batch and the widths of the layers must be above 0")


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

    Each round adds closed loops to the data and trains afresh from the last network. Reports the mean squared error of
    held-out loops in drive units squared, on inputs within the bounds. store: where finished loops are kept, so that an
    interrupted training goes on.
    """
    began = time.perf_counter()
    parts: list[Samples] = []
    held: list[Samples] = []
    policy: Policy | None = None
    network: torch.nn.Module | None = None
    workers = settings.workers or os.cpu_count() or 1
    # Ctrl-C is for the parent: it stops handing out work and lets the loops under way finish.
    ignore = partial(signal.signal, signal.SIGINT, signal.SIG_IGN)
    pool = ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn"), initializer=ignore)
    with _one_thread_each(), one_torch_thread(torch), pool:
        for number, episodes in enumerate(settings.episodes):
            work = partial(sample, model.equation, problem, spread, driver=policy)
            seeds = [seed * 1_000_003 + 1000 * number + index for index in range(episodes)]
            report = partial(progress or _silent, f"round {number + 1}: closed loops of the exact MPC")
            new = _sampled(pool, work, seeds, store, report)
            validation = max(1, round(VALIDATION_SHARE * episodes))
            held += new[:validation]
            parts += new[validation:]
            last = number == len(settings.episodes) - 1
            epochs = settings.epochs if last else max(1, settings.epochs // 3)
            report = partial(progress or _silent, f"round {number + 1}: training the network")
            data = Samples.joined(parts), Samples.joined(held)
            network, policy = _fit(model, problem, *data, settings, epochs, seed, network, report)
    assert policy is not None
    measured = {
        **policy.training,
        "seed": seed,
        "rounds": list(settings.episodes),
        "samples": len(Samples.joined(parts).inputs),
        "validation_samples": len(Samples.joined(held).inputs),
        "dropped": Samples.joined(parts + held).dropped,
        "seconds": round(time.perf_counter() - began, 1),
    }
    return replace(policy, training=measured)


def _sampled(
    pool: ProcessPoolExecutor,
    work: Callable[[int], Samples],
    seeds: list[int],
    store: SampleStore | None,
    progress: Callable[[int, int], None],
) -> list[Samples]:
    """The loops of the seeds, in their order; those that the store has are not run again."""
    found = {seed: store.find(seed) if store is not None else None for seed in seeds}
    running = {seed: pool.submit(work, seed) for seed, samples in found.items() if samples is None}
    loops: list[Samples] = []
    try:
        for done, seed in enumerate(seeds):
            samples = found[seed] or running[seed].result()
            if store is not None and seed in running:
                store.keep(seed, samples)
            loops.append(samples)
            progress(done + 1, len(seeds))
    except KeyboardInterrupt:
        pool.shutdown(wait=True, cancel_futures=True)
        raise
    return loops


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started here use one thread of linear algebra: more only get into each other's way."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _silent(stage: str, done: int, of: int) -> None:
    pass


def features_of(samples: Samples, output: int) -> Array:
    """Raw features (samples, features) of the policy: [x, d, u_previous, q - y]."""
    errors = samples.previews - samples.states[:, output : output + 1]
    return np.column_stack([samples.states, samples.disturbances, samples.previous, errors])


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
    torch.manual_seed(seed)
    output = model.equation.outputs[0]
    raw = features_of(samples, output)
    centre, scale = raw.mean(axis=0), raw.std(axis=0) + 1e-9
    widths = [raw.shape[1], *settings.hidden, 1]
    network = torch.nn.Sequential(*_layers(widths)).double()
    if start is not None:
        network.load_state_dict(start.state_dict())
    inputs = torch.from_numpy((raw - centre) / scale)
    targets = torch.from_numpy(samples.inputs / problem.input_limit)
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
    generator = torch.Generator().manual_seed(seed)
    for epoch in range(epochs):
        for rows in _batches(len(targets), settings.batch, generator):
            optimiser.zero_grad()
            loss = torch.mean(_beyond_bounds(network(inputs[rows])[:, 0], targets[rows]) ** 2)
            loss.backward()
            optimiser.step()
        schedule.step()
        progress(epoch + 1, epochs)
    linear = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    layers = tuple((layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in linear)
    policy = Policy(
        problem=problem,
        model=model.seal,
        rig=model.rig,
        states=len(model.equation.states),
        output=output,
        centre=centre,
        scale=scale,
        layers=layers,
    )
    validation = features_of(held, output)
    with torch.no_grad():
        check = validation[:64]
        expected = network(torch.from_numpy((check - centre) / scale))[:, 0].numpy() * problem.input_limit
    errors = {}
    for name, features, answers in (("train", raw, samples.inputs), ("validation", validation, held.inputs)):
        bounded = np.clip(policy.evaluate(features), -problem.input_limit, problem.input_limit)
        errors[f"{name}_mse"] = float(np.mean((bounded - answers) ** 2))
    return network, replace(policy, training=errors, check=(check, expected))


def _beyond_bounds(answers: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Errors, where an answer beyond the bound counts as the bound: it is cut there anyway."""
    errors = answers - targets
    beyond = ((targets >= 1 - 1e-4) & (errors > 0)) | ((targets <= -1 + 1e-4) & (errors < 0))
    return torch.where(beyond, torch.zeros_like(errors), errors)


def _layers(widths: list[int]) -> Iterator[torch.nn.Module]:
    for before, after in pairwise(widths[:-1]):
        yield torch.nn.Linear(before, after)
        yield torch.nn.Tanh()
    yield torch.nn.Linear(widths[-2], widths[-1])


def _batches(count: int, size: int, generator: torch.Generator) -> Iterator[torch.Tensor]:
    order = torch.randperm(count, generator=generator)
    for begin in range(0, count, size):
        yield order[begin : begin + size]
