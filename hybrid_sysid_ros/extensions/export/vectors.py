"""Instances with the answers that an exported policy must give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Status
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.support.arrays import Array

Truths = NDArray[np.bool_]

NAMES = ("x", "d", "u_previous", "preview", "parameters")
"""Of the parts of an instance."""

PLAIN = 4
"""How many of the self-check instances are asked again with other previous inputs, states and parameters."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Vectors:
    """What is asked, and what must be answered."""

    instances: Array
    """(vectors, width): [x, d, u_previous, q_1, .., q_N, followed parameters] in their units."""
    inputs: Array
    """(vectors, stages, inputs) [their units]."""
    answered: Truths
    """(vectors, 1), whether they are the network's."""
    inside: Truths
    """(vectors, 1), whether the instance is in the training range."""

    def __len__(self) -> int:
        return len(self.instances)

    def difference(self, inputs: Array, answered: Truths, inside: Truths) -> float:
        """Largest difference of the inputs; infinite where one is no number, or a truth is another."""
        if inputs.shape != self.inputs.shape or np.any(answered != self.answered) or np.any(inside != self.inside):
            return np.inf
        apart = np.abs(inputs - self.inputs)
        return float(np.max(apart)) if np.all(np.isfinite(apart)) else np.inf


def parts(policy: Policy, instances: Array) -> tuple[Array, Array, Array, Array, Array]:
    """The parts of instances by :data:`NAMES`: (vectors, size) each, the preview (vectors, horizon, outputs)."""
    sizes = [policy.states, policy.inputs, policy.inputs, policy.horizon * policy.outputs]
    x, d, previous, preview, parameters = np.split(instances, np.cumsum(sizes).tolist(), axis=1)
    return x, d, previous, preview.reshape(len(instances), policy.horizon, policy.outputs), parameters


def vectors(policy: Policy) -> Vectors:
    """The policy's own self-check vectors within their bounds, then instances at the edge of what may be asked: spoilt
    by NaN and infinity, with previous inputs out of bounds, and with moved parameters. Those the policy answers itself.
    """
    features, answers = policy.check
    count, first = len(features), policy.states + 2 * policy.inputs
    preview = np.zeros((count, policy.horizon, policy.outputs))
    errors = features[:, first:].reshape(count, policy.horizon, -1)
    preview[:, :, list(policy.tracked)] = errors + (features[:, : policy.states] @ policy.output_map.T)[:, None, :]
    nominal = np.zeros(0) if policy.correction is None else policy.correction.nominal
    instances = np.hstack([features[:, :first], preview.reshape(count, -1), np.tile(nominal, (count, 1))])
    known = asked(policy, instances)
    inputs = bounded(answers, parts(policy, instances)[2], policy.problem)
    edge = asked(policy, _edge(policy, instances))
    known = replace(known, inputs=inputs, answered=np.ones_like(known.answered))
    return Vectors(**{name: np.concatenate([values, getattr(edge, name)]) for name, values in vars(known).items()})


def bounded(answers: Array, previous_inputs: Array, problem: ControlProblem) -> Array:
    """Answers (vectors, stages, inputs) within bounds and rate limits after the previous inputs (vectors, inputs)."""
    low, high, rate = (np.array(getattr(problem, name)) for name in ("input_low", "input_high", "rate_limits"))
    inputs = np.empty_like(answers)
    last = np.clip(previous_inputs, low, high)
    for k in range(answers.shape[1]):
        last = np.clip(np.clip(answers[:, k], last - rate, last + rate), low, high)
        inputs[:, k] = last
    return inputs


def asked(policy: Policy, instances: Array) -> Vectors:
    """What the policy answers, adapted afresh to the parameters of each instance."""
    plans, inside = [], []
    for *instance, values in zip(*parts(policy, instances), strict=True):
        fresh = replace(policy)
        if fresh.correction is not None:
            fresh.adapt(dict(zip(fresh.correction.names, map(float, values), strict=True)))
        plans.append(fresh.control(*instance))
        inside.append([fresh.inside(*instance)])
    return Vectors(
        instances=instances,
        inputs=np.array([plan.inputs for plan in plans]),
        answered=np.array([[plan.status is Status.POLICY] for plan in plans]),
        inside=np.array(inside),
    )


def _edge(policy: Policy, instances: Array) -> Array:
    """Instances at the edge, made of those given."""
    rows = []
    read = np.ones(instances.shape[1], dtype=bool)  # what the untracked outputs should be is not read
    first = policy.states + 2 * policy.inputs
    last = first + policy.horizon * policy.outputs
    read[first:last] = np.isin(np.arange(last - first) % policy.outputs, policy.tracked)
    for column in np.flatnonzero(read):
        rows.append(instances[0].copy())
        rows[-1][column] = (np.nan, np.inf, -np.inf)[column % 3]
    low, high = np.array(policy.problem.input_low), np.array(policy.problem.input_high)
    previous = slice(policy.states + policy.inputs, first)
    for plain in instances[:PLAIN]:
        for value in (np.nan, -2.0, 0.0, 0.5, 1.0, 1e12):
            rows.append(plain.copy())
            rows[-1][previous] = low + value * (high - low)
        rows.append(plain.copy())
        rows[-1][: policy.states] *= 1e3
        if policy.correction is not None:
            for spreads in (-5.0, -1.0, 0.3, 5.0):
                rows.append(plain.copy())
                rows[-1][last:] += spreads * policy.correction.spread
    return np.array(rows)
