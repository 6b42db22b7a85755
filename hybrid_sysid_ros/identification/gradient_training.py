"""Training of the recurrent network by gradients through time, in torch, which is imported here and when it is used."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.identification.experiment import Experiment
from hybrid_sysid_ros.identification.fitting import Fit, Progress
from hybrid_sysid_ros.models.recurrent import Recurrent
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.threads import one_torch_thread

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """stages: (samples of a rollout, gradient steps) in turn; short ones first keep the cost near convex. batch:
    rollouts in a step. rate: largest step size; it rises over the first tenth and falls along a cosine. decay: of the
    weights, per step and step size. longest: norm beyond which a gradient is cut. check: steps between two looks at the
    free run over the training records, of which the best one's weights are kept.
    """

    stages: tuple[tuple[int, int], ...] = ((20, 200), (40, 300), (80, 300))
    batch: int = 64
    rate: float = 0.02
    decay: float = 1e-4
    longest: float = 1.0
    check: int = 50


def train(
    experiments: Sequence[Experiment],
    *,
    units: int = 24,
    seed: int = 0,
    schedule: Schedule = Schedule(),
    progress: Progress | None = None,
) -> Fit:
    """A :class:`~hybrid_sysid_ros.models.recurrent.Recurrent` of the experiments' step, trained on all of them at once.

    experiments: prepared for a Recurrent, ``prepare(record, Recurrent(), sampling)``, or for another equation whose
    states 0 and 1 are the one output and its rate. Rollouts begin at random samples, where the encoder sees position
    and rate; the loss is on positions only, each in deviations of its record's output, so that small motion counts as
    much as wide motion. Adam with weight decay (Loshchilov and Hutter 2019), in one thread; the same seed gives the
    same weights on one machine.

    Raises UserError for records sampled differently, shorter than the first stage's rollouts, constant, or of several
    inputs or outputs, and where torch is missing.
    """
    torch = _torch()
    data = _Data(experiments, shortest=schedule.stages[0][0])
    system = data.start(units).initial(seed)
    random = np.random.default_rng(seed)
    began = time.perf_counter()
    steps = sum(count for _, count in schedule.stages)
    best, least, done = system, np.inf, 0
    with one_torch_thread(torch):
        weights = torch.tensor(system.weights, requires_grad=True)
        adam = torch.optim.AdamW([weights], lr=schedule.rate, weight_decay=schedule.decay)
        rates = torch.optim.lr_scheduler.OneCycleLR(adam, schedule.rate, total_steps=steps, pct_start=0.1)
        for horizon, count in schedule.stages:
            for _ in range(count):
                starts, inputs, outputs, units_of_error = data.batch(random, schedule.batch, horizon)
                simulated = rollout(system, weights, starts, inputs, data.every)
                loss = (((simulated - torch.from_numpy(outputs)) / torch.from_numpy(units_of_error)) ** 2).mean()
                adam.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_([weights], schedule.longest)
                adam.step()
                rates.step()
                done += 1
                if done % schedule.check == 0 or done == steps:
                    candidate = system.with_weights(weights.detach().numpy().copy())
                    error = data.free_run_error(candidate)
                    if error < least:
                        best, least = candidate, error
                    if progress is not None:
                        progress(f"{horizon}-sample rollouts", done, error)
    if not np.isfinite(least):
        raise UserError("recurrent network: the training diverged; lower its step size")
    return Fit(
        system=best,
        names=(),
        covariance=np.zeros((0, 0)),
        spreads=np.zeros(0),
        nuisances=np.zeros((0, len(experiments))),
        relative_error=least,
        seconds=time.perf_counter() - began,
        evaluations=done,
    )


def rollout(system: Recurrent, weights: Any, starts: Array, inputs: Array, every: int) -> Any:
    """Positions (samples, rollouts) [rad] at every ``every``-th step after the first sample, as a tensor.

    The torch form of an equation. weights (size,): a tensor in place of the equation's own; starts (2, rollouts):
    measured positions and rates; inputs (steps, rollouts).
    """
    torch = _torch()
    parts = system.parts(weights)
    scales = np.array([[system.position_scale], [system.rate_scale]])
    measured = torch.from_numpy((starts / scales).T).to(weights.dtype)
    hidden = torch.tanh(measured @ parts["encoder"].T + parts["encoder_bias"])
    drive = torch.from_numpy(inputs / system.drive_scale).to(weights.dtype)
    gates = torch.cat([torch.zeros(2 * system.units, dtype=weights.dtype), parts["reset_bias"]])
    learned = [parts["drive"], parts["recurrent"], parts["bias"], gates]
    states, _ = torch.gru(drive[..., None], hidden[None], learned, True, 1, 0.0, False, False, False)
    return system.position_scale * (states[every - 1 :: every] @ parts["readout"] + parts["readout_bias"])


class _Data:
    """The experiments side by side: scored samples and steps of all records in one row each."""

    def __init__(self, experiments: Sequence[Experiment], *, shortest: int) -> None:
        _check(experiments, shortest)
        self.experiments = experiments
        self.sampling = experiments[0].sampling
        self.every = self.sampling.every
        self.samples = np.array([item.samples for item in experiments])
        self.positions = np.concatenate([item.outputs[:, 0] for item in experiments])
        self.rates = np.concatenate([item.states[:, 1] for item in experiments])
        self.inputs = np.concatenate([item.inputs[:, 0] for item in experiments])
        self.deviations = np.array([float(np.std(item.outputs[:, 0])) for item in experiments])
        self.first_samples = np.cumsum([0, *self.samples[:-1]])
        self.first_steps = np.cumsum([0, *(len(item.inputs) for item in experiments[:-1])])

    def start(self, units: int) -> Recurrent:
        """A network of zeros in the units of the data: root mean squares."""
        scales = [float(f"{np.sqrt(np.mean(v**2)):.4g}") for v in (self.positions, self.rates, self.inputs)]
        return Recurrent(
            period=self.sampling.step,
            units=units,
            position_scale=scales[0],
            rate_scale=scales[1],
            drive_scale=scales[2],
        )

    def batch(self, random: np.random.Generator, count: int, horizon: int) -> tuple[Array, Array, Array, Array]:
        """Rollouts of up to ``horizon`` samples that begin anywhere: measured positions and rates (2, count), inputs
        (steps, count), positions (samples, count) after the first, and deviations of their records (count,).
        """
        length = min(horizon, int(self.samples.min()) - 1)
        chosen = random.choice(len(self.samples), size=count, p=self.samples / self.samples.sum())
        begin = random.integers(self.samples[chosen] - length)
        sample = self.first_samples[chosen] + begin
        step = self.first_steps[chosen] + begin * self.every
        return (
            np.stack([self.positions[sample], self.rates[sample]]),
            self.inputs[step + np.arange(length * self.every)[:, None]],
            self.positions[sample + np.arange(1, length + 1)[:, None]],
            self.deviations[chosen],
        )

    def free_run_error(self, system: Recurrent) -> float:
        """Root mean square of the free-run errors over all records, each in deviations of its output."""
        squares = []
        for item, deviation in zip(self.experiments, self.deviations, strict=True):
            start = system.observed(item.outputs[:1], item.states[:1, 1:2], item.inputs[:1])[0]
            states = simulate(system, start, item.inputs, step=self.sampling.step, every=self.every)
            squares.append(((states[:, 0] - item.outputs[:, 0]) / deviation) ** 2)
        return float(np.sqrt(np.mean(np.concatenate(squares))))


def _check(experiments: Sequence[Experiment], shortest: int) -> None:
    if len({item.sampling for item in experiments}) > 1:
        raise UserError("recurrent network: the records are sampled differently")
    for item in experiments:
        if item.outputs.shape[1] != 1 or item.inputs.shape[1] != 1:
            raise UserError(f"{item.name}: a recurrent network has one input and one output")
        if item.samples <= shortest:
            raise UserError(
                f"{item.name}: {item.samples} samples are too short: training needs rollouts of {shortest} at least"
            )
        if min(np.ptp(item.outputs), np.ptp(item.inputs)) == 0.0:
            raise UserError(f"{item.name}: input or output is constant; leave the record out")


def _torch() -> Any:
    with extra("train"):
        import torch
    return torch
