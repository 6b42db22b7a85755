"""Training of the recurrent network by gradients through time, in torch, which is imported here and when it is used."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import System, Variable, simulate
from hybrid_sysid_ros.core.parameters import scale_of
from hybrid_sysid_ros.extensions.recurrent.recurrent import Recurrent
from hybrid_sysid_ros.extensions.shared.torch_threads import one_torch_thread
from hybrid_sysid_ros.identification.fitting import FitProgress
from hybrid_sysid_ros.models.fit import Fit, PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra


@dataclass(frozen=True, kw_only=True)
class TrainingSchedule:
    """How it is trained."""

    stages: tuple[tuple[int, int], ...] = ((20, 200), (40, 300), (80, 300))
    """Samples of a rollout and gradient steps, in turn; short ones first keep the cost near convex."""
    batch: int = 64
    """Rollouts in a step."""
    rate: float = 0.02
    """Largest step size; it rises over the first tenth and falls along a cosine."""
    decay: float = 1e-4
    """Of the weights, per step and step size."""
    longest: float = 1.0
    """Norm beyond which a gradient is cut."""
    check: int = 50
    """Steps between two looks at the free run over the training records, of which the best one's weights are kept."""


def train_network(
    network: Recurrent,
    experiments: Sequence[PreparedRecord],
    *,
    seed: int = 0,
    schedule: TrainingSchedule = TrainingSchedule(),
    progress: FitProgress | None = None,
) -> Fit:
    """A network trained on all records at once; its own weights and scales do not matter.

    Rollouts begin at random samples, where the encoder sees
    outputs and their rates; the loss is on outputs only, each in deviations of its record's output, so that small
    motion counts as much as wide motion. Adam with weight decay (Loshchilov and Hutter 2019), in one thread; the same
    seed gives the same weights on one machine.

    Raises UserError for records that are shorter than the first stage's rollouts or constant, and where torch is
    missing.
    """
    torch = _torch()
    data = _RecordBatch(network, experiments, shortest=schedule.stages[0][0])
    system, random, began = data.system.initial(seed), np.random.default_rng(seed), time.perf_counter()
    steps = sum(count for _, count in schedule.stages)
    best, least, done = system, np.inf, 0
    with one_torch_thread(torch):
        weights = torch.tensor(system.weights, requires_grad=True)
        adam = torch.optim.AdamW([weights], lr=schedule.rate, weight_decay=schedule.decay)
        rates = torch.optim.lr_scheduler.OneCycleLR(adam, schedule.rate, total_steps=steps, pct_start=0.1)
        for horizon, count in schedule.stages:
            for _ in range(count):
                starts, inputs, *target = data.batch(random, schedule.batch, horizon)
                simulated = rollout(system, weights, starts, inputs, data.every)
                outputs, deviations = map(torch.from_numpy, target)
                adam.zero_grad()
                (((simulated - outputs) / deviations) ** 2).mean().backward()
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
    return Fit(system=best, relative_error=least, seconds=time.perf_counter() - began, evaluations=done)


def untrained(rig: System, period: float, units: int) -> Recurrent:
    """A network of zeros with the signals of a rig; rates of positions have the names of the rig's velocities."""
    names = [item.name for item in rig.states]
    velocities = {names[i]: rig.states[j] for i, j in rig.kinematics.items()}
    rates = tuple(
        velocities.get(item.name, Variable(name=f"{item.name}_rate", unit=f"{item.unit}/s")) for item in rig.outputs
    )
    taken = [item.name for item in rig.outputs]
    rates = tuple(replace(r, name=f"{y}_rate") if r.name in taken else r for r, y in zip(rates, taken, strict=True))
    return Recurrent(period=period, units=units, outputs=rig.outputs, inputs=rig.inputs, rates=rates)


def rollout(system: Recurrent, weights: Any, starts: Array, inputs: Array, every: int) -> Any:
    """Outputs (samples, rollouts, outputs) at every ``every``-th step after the first sample, as a tensor.

    The torch form of the system. weights (size,): a tensor in place of its own; starts (rollouts, 2 outputs): measured
    outputs and rates; inputs (steps, rollouts, inputs).
    """
    torch = _torch()
    parts, p = system.parts(weights), len(system.outputs)
    scales = np.array(system.scales)
    hidden = torch.tanh(
        torch.from_numpy(starts / scales[: 2 * p]).to(weights.dtype) @ parts["encoder"].T + parts["encoder_bias"]
    )
    drive = torch.from_numpy(inputs / scales[2 * p :]).to(weights.dtype)
    gates = torch.cat([torch.zeros(2 * system.units, dtype=weights.dtype), parts["reset_bias"]])
    learned = [parts["drive"], parts["recurrent"], parts["bias"], gates]
    states, _ = torch.gru(drive, hidden[None], learned, True, 1, 0.0, False, False, False)
    return torch.from_numpy(scales[:p]) * (states[every - 1 :: every] @ parts["readout"].T + parts["readout_bias"])


class _RecordBatch:
    """The experiments side by side: scored samples and steps of all records in one row each."""

    def __init__(self, system: Recurrent, experiments: Sequence[PreparedRecord], *, shortest: int) -> None:
        _check(experiments, shortest)
        self.experiments = experiments
        self.sampling = experiments[0].sampling
        self.every = self.sampling.every
        self.samples = np.array([item.samples for item in experiments])
        p = len(system.outputs)
        self.measured = np.concatenate([item.states[:, : 2 * p] for item in experiments])
        self.inputs = np.concatenate([item.inputs for item in experiments])
        self.deviations = np.array([np.std(item.outputs, axis=0) for item in experiments])
        self.first_samples = np.cumsum([0, *self.samples[:-1]])
        self.first_steps = np.cumsum([0, *(len(item.inputs) for item in experiments[:-1])])
        squares = np.concatenate([np.mean(self.measured**2, axis=0), np.mean(self.inputs**2, axis=0)])
        self.system = replace(system, scales=tuple(map(scale_of, np.sqrt(squares))))
        """In the units of the data: root mean squares."""

    def batch(self, random: np.random.Generator, count: int, horizon: int) -> tuple[Array, Array, Array, Array]:
        """Rollouts of up to ``horizon`` samples that begin anywhere: measured outputs and rates (count, 2 outputs),
        inputs (steps, count, inputs), outputs (samples, count, outputs) after the first, and their records' deviations
        (count, outputs).
        """
        length = min(horizon, int(self.samples.min()) - 1)
        chosen = random.choice(len(self.samples), size=count, p=self.samples / self.samples.sum())
        begin = random.integers(self.samples[chosen] - length)
        sample = self.first_samples[chosen] + begin
        step = self.first_steps[chosen] + begin * self.every
        outputs = self.measured[:, : len(self.system.outputs)]
        return (
            self.measured[sample],
            self.inputs[step + np.arange(length * self.every)[:, None]],
            outputs[sample + np.arange(1, length + 1)[:, None]],
            self.deviations[chosen],
        )

    def free_run_error(self, system: Recurrent) -> float:
        """Root mean square of the free-run errors over all records, each in deviations of its output."""
        squares, p = [], len(system.outputs)
        for item, deviation in zip(self.experiments, self.deviations, strict=True):
            start = system.record_map().states_from_record(
                item.outputs[:1], item.states[:1, p : 2 * p], item.inputs[:1]
            )[0]
            states = simulate(system, start, item.inputs, step=self.sampling.step, every=self.every)
            squares.append(((states[:, :p] - item.outputs) / deviation) ** 2)
        return float(np.sqrt(np.mean(np.concatenate(squares))))


def _check(experiments: Sequence[PreparedRecord], shortest: int) -> None:
    for item in experiments:
        if item.samples <= shortest:
            raise UserError(
                f"{item.name}: {item.samples} samples are too short: training needs rollouts of {shortest} at least"
            )
        if min(np.ptp(item.outputs, axis=0).min(), np.ptp(item.inputs, axis=0).min()) == 0.0:
            raise UserError(f"{item.name}: input or output is constant; leave the record out")


def _torch() -> Any:
    with extra("train"):
        import torch
    return torch
