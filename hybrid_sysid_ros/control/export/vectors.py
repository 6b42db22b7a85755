"""Questions with the answers that an exported policy must give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Status
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.problem import Problem

Array = NDArray[np.float64]
Truths = NDArray[np.bool_]

NAMES = ("x", "d", "u_previous", "preview", "parameters")
"""Of the parts of a question."""

PLAIN = 4
"""How many of the self-check questions are asked again with other previous inputs, states and parameters."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Vectors:
    """questions (vectors, width): [x, d, u_previous, q_1..q_N, followed parameters] in their units. inputs (vectors,
    outputs) [drive unit], answered and inside (vectors, 1): the answers, whether they are the network's, and whether
    the question is in the training range.
    """

    questions: Array
    inputs: Array
    answered: Truths
    inside: Truths

    def __len__(self) -> int:
        return len(self.questions)

    def __add__(self, other: Vectors) -> Vectors:
        return Vectors(
            questions=np.concatenate([self.questions, other.questions]),
            inputs=np.concatenate([self.inputs, other.inputs]),
            answered=np.concatenate([self.answered, other.answered]),
            inside=np.concatenate([self.inside, other.inside]),
        )

    def difference(self, inputs: Array, answered: Truths, inside: Truths) -> float:
        """Largest difference of the inputs [drive unit]; infinite where one is no number, or a truth is another."""
        if inputs.shape != self.inputs.shape or np.any(answered != self.answered) or np.any(inside != self.inside):
            return np.inf
        apart = np.abs(inputs - self.inputs)
        return float(np.max(apart)) if np.all(np.isfinite(apart)) else np.inf


def parts(policy: Policy, questions: Array) -> tuple[Array, Array, Array, Array, Array]:
    """The parts of questions by :data:`NAMES`, each (vectors, its size)."""
    x, d, previous, preview, parameters = np.split(
        questions, np.cumsum([policy.states, 1, 1, policy.horizon]).tolist(), axis=1
    )
    return x, d, previous, preview, parameters


def vectors(policy: Policy) -> Vectors:
    """The policy's own self-check vectors within their bounds, then questions at the edge of what may be asked: spoilt
    by NaN and infinity, with previous inputs out of bounds, and with moved parameters. Those the policy answers itself.
    """
    features, answers = policy.check
    tracked = features[:, [policy.output]]
    nominal = np.zeros(0) if policy.correction is None else policy.correction.nominal
    first = policy.states + 2
    questions = np.hstack(
        [features[:, :first], features[:, first:] + tracked, np.broadcast_to(nominal, (len(features), len(nominal)))]
    )
    known = asked(policy, questions)
    inputs = bounded(answers, questions[:, [policy.states + 1]], policy.problem)
    return replace(known, inputs=inputs, answered=np.ones_like(known.answered)) + asked(
        policy, _edge(policy, questions)
    )


def bounded(answers: Array, previous_inputs: Array, problem: Problem) -> Array:
    """Answers (vectors, outputs) within the bounds of inputs and rate; previous_inputs (vectors, 1)."""
    limit, rate = problem.input_high[0], problem.rate_limits[0]
    inputs = np.empty_like(answers)
    last = np.clip(previous_inputs[:, 0], -limit, limit)
    for k in range(answers.shape[1]):
        last = np.clip(np.clip(answers[:, k], last - rate, last + rate), -limit, limit)
        inputs[:, k] = last
    return inputs


def asked(policy: Policy, questions: Array) -> Vectors:
    """What the policy answers, adapted afresh to the parameters of each question."""
    plans, inside = [], []
    for *question, values in zip(*parts(policy, questions), strict=True):
        fresh = replace(policy)
        if fresh.correction is not None:
            fresh.adapt(dict(zip(fresh.correction.names, map(float, values), strict=True)))
        plans.append(fresh.control(*question))
        inside.append([fresh.inside(*question)])
    return Vectors(
        questions=questions,
        inputs=np.array([plan.inputs[:, 0] for plan in plans]),
        answered=np.array([[plan.status is Status.POLICY] for plan in plans]),
        inside=np.array(inside),
    )


def _edge(policy: Policy, questions: Array) -> Array:
    """Questions at the edge, made of those given."""
    rows = []
    for column in range(questions.shape[1]):
        spoilt = questions[0].copy()
        spoilt[column] = (np.nan, np.inf, -np.inf)[column % 3]
        rows.append(spoilt)
    previous, first_parameter = policy.states + 1, policy.states + 2 + policy.horizon
    for plain in questions[:PLAIN]:
        for value in (np.nan, -3.0, -1.0, 0.0, 1.0, 1e12):
            rows.append(plain.copy())
            rows[-1][previous] = policy.problem.input_high[0] * value
        rows.append(plain.copy())
        rows[-1][: policy.states] *= 1e3
        if policy.correction is not None:
            for spreads in (-5.0, -1.0, 0.3, 5.0):
                rows.append(plain.copy())
                rows[-1][first_parameter:] += spreads * policy.correction.spread
    return np.array(rows)
