"""PyTorch: physics and a small network, trained by K-step rollouts and Adam, as the lecture trains its hybrid-joint.

    v' = gain (u - centre) - stiffness q - damping v - coulomb tanh(v / creep) + n(q, v, u)

A rollout begins at a measured position and its Savitzky-Golay rate; the loss is on positions. Steps of 10 ms
(semi-implicit Euler) with the input's mean over each. One thread: the operations are too small for two.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from benchmarks.identification.peer import Fitted, Peer, Simulation
from hybrid_sysid_ros.identification import PreparedRecord
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.arrays import Array

POSITION, RATE, DRIVE = 0.04, 0.16, 4.0
"""Units of the network's features [rad, rad/s, V]."""

HORIZON, UNITS, ITERATIONS, BATCH, STEP_SIZE = 40, 16, 800, 256, 0.01
"""Samples (50 ms) of a rollout, hidden units, gradient steps, rollouts in each, and Adam's first step size (cosine).

Horizon and units: the best of (40, 16), (60, 16), (60, 8) in two-fold cross-validation on the records' first halves."""

SNAPSHOTS = (25, 50, 100, 200, 300, 400, 500, 600, 700, ITERATIONS)


class Beam(nn.Module):
    """physics (6,): gain, centre, stiffness, damping, coulomb as multiples of where the fit starts, log of creep's."""

    def __init__(self) -> None:
        super().__init__()
        self.physics = nn.Parameter(torch.tensor([1.0, 1.0, 1.0, 1.0, 1.0, 0.0]))
        self.network = nn.Sequential(nn.Linear(3, UNITS), nn.Tanh(), nn.Linear(UNITS, 1))
        nn.init.zeros_(self.network[2].weight)
        nn.init.zeros_(self.network[2].bias)

    def forward(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor, step: float, every: int) -> torch.Tensor:
        """Positions (rollouts, samples) after q, v (rollouts,) under u (rollouts, samples * every), SI units."""
        gain, centre, stiffness, damping, coulomb, creep = self.physics
        creep = 0.02 * torch.exp(creep)
        positions = []
        for index, drive in enumerate(u.unbind(1)):
            features = torch.stack([q / POSITION, v / RATE, drive / DRIVE], dim=-1)
            rate = 4.0 * gain * (drive - centre) - 10.0 * stiffness * q - 20.0 * damping * v
            rate = rate - 1.5 * coulomb * torch.tanh(v / creep) + 3.2 * self.network(features)[..., 0]
            v = v + step * rate
            q = q + step * v
            if (index + 1) % every == 0:
                positions.append(q)
        return torch.stack(positions, dim=1)


def fit(experiments: Sequence[PreparedRecord]) -> Fitted:
    """One training run, all rollouts of all experiments in shuffled minibatches."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    sampling = experiments[0].sampling
    began = time.perf_counter()
    q, v, u, measured = _rollouts(experiments)
    model = Beam()
    optimiser = torch.optim.Adam(model.parameters(), lr=STEP_SIZE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, ITERATIONS)
    snapshots: list[tuple[float, Simulation]] = []
    order = torch.empty(0, dtype=torch.long)
    for iteration in range(1, ITERATIONS + 1):
        if len(order) < BATCH:
            order = torch.cat([order, torch.randperm(len(q))])
        batch, order = order[:BATCH], order[BATCH:]
        optimiser.zero_grad()
        errors = (model(q[batch], v[batch], u[batch], sampling.step, sampling.every) - measured[batch]) / POSITION
        (errors**2).mean().backward()
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        if iteration in SNAPSHOTS:
            snapshots.append((time.perf_counter() - began, _simulation(copy.deepcopy(model))))
    return Fitted(seconds=snapshots[-1][0], snapshots=snapshots)


def _rollouts(experiments: Sequence[PreparedRecord]) -> tuple[torch.Tensor, ...]:
    """Initial positions and rates (rollouts,), inputs (rollouts, HORIZON * every) and positions (rollouts, HORIZON)."""
    q, v, u, measured = [], [], [], []
    for item in experiments:
        every = item.sampling.every
        for begin in range(item.samples - HORIZON):
            end = begin + HORIZON
            q.append(item.outputs[begin, 0])
            v.append(item.states[begin, 1])
            u.append(item.inputs[begin * every : end * every, 0])
            measured.append(item.outputs[begin + 1 : end + 1, 0])
    return tuple(torch.tensor(np.array(values), dtype=torch.float32) for values in (q, v, u, measured))


def _simulation(model: Beam) -> Simulation:
    def simulation(experiment: PreparedRecord) -> Array:
        q, v, u = (
            torch.tensor(np.array(values), dtype=torch.float32)
            for values in (experiment.outputs[:1, 0], experiment.states[:1, 1], experiment.inputs[:, 0][None])
        )
        with torch.no_grad():
            positions = model(q, v, u, experiment.sampling.step, experiment.sampling.every)[0].numpy()
        return np.concatenate([experiment.outputs[:1, 0], positions])

    return simulation


PEERS = (Peer(name="PyTorch: physics + network", packages=("torch",), sampling=Sampling(step=0.01), fit=fit),)
