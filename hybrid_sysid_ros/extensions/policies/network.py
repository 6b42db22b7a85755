"""A policy's network in torch: its layers, what it is wrong by, and the descent to less of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from copy import deepcopy
from itertools import pairwise

import numpy as np
import torch
from pytorch_optimizer import SOAP

from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.support.arrays import Array

AT_BOUND = 1 - 1e-4
"""From here on an input, in its limit, is at its bound."""

MATTERS = 0.1
"""Error of an input from which on it matters little how large it is, half the distance of the bounds being 1."""

WARM_UP = 200
"""Steps in which the rate of learning rises to its full value."""


def descend(
    network: torch.nn.Module,
    loss: Callable[[torch.nn.Module, torch.Tensor], torch.Tensor],
    count: int,
    settings: Settings,
    epochs: int,
    seed: int,
    progress: Callable[[int, int], None],
) -> None:
    """SOAP over shuffled batches of ``count`` samples, its rate falling along a cosine from batch to batch.

    Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2025, ICLR): on small dense networks it reaches in a
    few epochs what Adam does not in many.
    """
    optimiser = SOAP(network.parameters(), lr=settings.rate, weight_decay=0.0)
    steps, done = epochs * math.ceil(count / settings.batch), 0
    generator = torch.Generator().manual_seed(seed)
    for epoch in range(epochs):
        for rows in _batches(count, settings.batch, generator):
            rate = settings.rate * min(1.0, (done + 1) / WARM_UP) * math.cos(0.5 * math.pi * done / steps) ** 2
            for group in optimiser.param_groups:
                group["lr"] = rate
            optimiser.zero_grad()
            loss(network, rows).backward()
            optimiser.step()
            done += 1
        progress(epoch + 1, epochs)


def beyond_bounds(answers: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Errors, where an answer beyond the bound counts as the bound: it is cut there anyway."""
    errors = answers - targets
    beyond = ((targets >= AT_BOUND) & (errors > 0)) | ((targets <= -AT_BOUND) & (errors < 0))
    return torch.where(beyond, torch.zeros_like(errors), errors)


def saturating(errors: torch.Tensor) -> torch.Tensor:
    """Squared errors that end at :data:`MATTERS` squared (Geman, McClure 1985): where an answer jumps, a network that
    changes sides at once has less of it than one that goes across slowly.
    """
    return errors**2 / (1.0 + (errors / MATTERS) ** 2)


def new_network(widths: list[int], seed: int) -> torch.nn.Sequential:
    """Tanh layers and a straight output, in single precision: training is twice as fast, and as good."""
    torch.manual_seed(seed)
    layers: list[torch.nn.Module] = []
    for before, after in pairwise(widths):
        layers += [torch.nn.Linear(before, after), torch.nn.Tanh()]
    return torch.nn.Sequential(*layers[:-1])


def layers_of(network: torch.nn.Module) -> tuple[tuple[Array, Array], ...]:
    """Weights and biases as arrays."""
    parts = [values.detach().double().numpy() for values in network.parameters()]
    return tuple(zip(parts[::2], parts[1::2], strict=True))


def in_double(network: torch.nn.Module, inputs: Array) -> Array:
    """What torch itself answers with these weights in double precision."""
    with torch.no_grad():
        answers: Array = deepcopy(network).double()(torch.from_numpy(inputs)).numpy()
    return answers


def single(values: Array) -> torch.Tensor:
    """A tensor in single precision."""
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))


def _batches(count: int, size: int, generator: torch.Generator) -> Iterator[torch.Tensor]:
    order = torch.randperm(count, generator=generator)
    for begin in range(0, count, size):
        yield order[begin : begin + size]
