"""Approximate MPC: a network that answers in microseconds. It needs numpy and numba, not torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Plan, Status
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.models import Model, storage

Array = NDArray[np.float64]

FORMAT = 1

SELF_CHECK_TOLERANCE = 1e-9
"""Largest difference [drive unit] of the self-check vectors on loading."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Policy:
    """u = NN(x, d, u_previous, q_1..q_N), the imitation of an exact MPC, kept within the input's bounds.

    The features are [x, d, u_previous, q_1 - y, ..., q_N - y], shifted by ``centre`` and divided by ``scale``
    (features,); tanh layers with weights W and biases b follow and a straight output in units of the input limit.

    problem: the MPC it imitates. model: seal of that MPC's model. output: the state that is measured. layers: W (out,
    in) and b (out,) in turn. training: how it was made and how near it comes. check: features and inputs that the
    network must reproduce when it is loaded.
    """

    problem: Problem
    model: str
    rig: str
    states: int
    output: int
    centre: Array
    scale: Array
    layers: tuple[tuple[Array, Array], ...]
    training: Mapping[str, Any] = field(default_factory=dict)
    check: tuple[Array, Array] = (np.zeros((0, 0)), np.zeros(0))
    # What an answer needs, made once: nothing is allocated in the loop.
    _packed: Array = field(init=False, repr=False)
    _widths: NDArray[np.int64] = field(init=False, repr=False)
    _buffers: Array = field(init=False, repr=False)
    _features: Array = field(init=False, repr=False)
    _inverse: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        widths = [len(self.centre), *(len(bias) for _, bias in self.layers)]
        for (matrix, _), before, after in zip(self.layers, widths[:-1], widths[1:], strict=True):
            if matrix.shape != (after, before):
                raise UserError(f"policy: a layer has shape {matrix.shape}; {(after, before)} is needed")
        if widths[0] != self.states + 2 + self.problem.horizon or widths[-1] != 1:
            raise UserError(f"policy: {widths[0]} features don't fit a horizon of {self.problem.horizon}")
        if not 0 <= self.output < self.states:
            raise UserError(f"policy: output {self.output} is none of its {self.states} states")
        if self.scale.shape != self.centre.shape or not np.all(self.scale > 0):
            raise UserError("policy: scale needs a number above 0 for every feature")
        packed = np.concatenate([np.concatenate([matrix.ravel(), bias]) for matrix, bias in self.layers])
        object.__setattr__(self, "_packed", packed)
        object.__setattr__(self, "_widths", np.array(widths))
        object.__setattr__(self, "_buffers", np.zeros((2, max(widths))))
        object.__setattr__(self, "_features", np.zeros(widths[0]))
        object.__setattr__(self, "_inverse", 1.0 / self.scale)

    @property
    def horizon(self) -> int:
        return self.problem.horizon

    @property
    def period(self) -> float:
        return self.problem.period

    def reset(self) -> None:
        """A policy remembers nothing."""

    def prepare(self, elapsed: float) -> None:
        """A policy has nothing to prepare."""

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`. An input that is not a number gives HELD: the
        previous input within its bounds, or zero.
        """
        features = self._features
        states, limit = self.states, self.problem.input_limit
        features[:states] = state
        features[states] = disturbance[0]
        features[states + 1] = previous_input[0]
        features[states + 2 :] = preview
        features[states + 2 :] -= state[self.output]
        u = self._evaluate(features)
        if not np.isfinite(u):
            last = float(previous_input[0])
            held = np.array([min(max(last, -limit), limit) if np.isfinite(last) else 0.0])
            return Plan(input=held, inputs=held[None], states=np.zeros((0, states)), status=Status.HELD)
        value = np.array([min(max(u, -limit), limit)])
        return Plan(input=value, inputs=value[None], states=np.zeros((0, states)), status=Status.POLICY)

    def _evaluate(self, features: Array) -> float:
        """Unbounded answer to raw features (features,)."""
        return self.problem.input_limit * float(
            _forward(
                features,
                self.centre,
                self._inverse,
                self._packed,
                self._widths,
                self._buffers,
            )
        )

    def evaluate(self, features: Array) -> Array:
        """Unbounded answers (samples,) to raw features (samples, features)."""
        return np.array([self._evaluate(row) for row in np.ascontiguousarray(features)])

    def save(self, folder: Path | str) -> None:
        """Write the policy folder; see :mod:`~hybrid_sysid_ros.models.storage`."""
        arrays = {
            "centre": self.centre,
            "scale": self.scale,
            "check_features": self.check[0],
            "check_inputs": self.check[1],
        }
        for index, (matrix, bias) in enumerate(self.layers):
            arrays[f"W{index}"], arrays[f"b{index}"] = matrix, bias
        content = {
            "rig": self.rig,
            "model": self.model,
            "states": self.states,
            "output": self.output,
            "layers": len(self.layers),
            "problem": asdict(self.problem),
            "training": dict(self.training),
        }
        storage.save(folder, kind="policy", version=FORMAT, content=content, arrays=arrays)


def load(folder: Path | str, *, model: Model | None = None) -> Policy:
    """Read a policy folder and let it check itself.

    model: the one that it is to be used with. Raises UserError where a file is missing, altered or newer, where the
    policy was made for another model, and where its self-check vectors are not reproduced.
    """
    content, arrays = storage.load(folder, kind="policy", version=FORMAT)
    path = Path(folder) / "policy.yaml"
    try:
        policy = Policy(
            problem=Problem(**content["problem"]),
            model=content["model"],
            rig=content["rig"],
            states=content["states"],
            output=content["output"],
            centre=arrays["centre"],
            scale=arrays["scale"],
            layers=tuple((arrays[f"W{i}"], arrays[f"b{i}"]) for i in range(content["layers"])),
            training=content["training"],
            check=(arrays["check_features"], arrays["check_inputs"]),
        )
    except UserError as error:
        raise UserError(f"{path}: {error}; train it again") from error
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: {error!r} is missing or malformed; train it again") from error
    if model is not None and policy.model != model.seal:
        raise UserError(f"{path}: was trained for another model; train it for this one (hybrid-sysid policy train)")
    features, inputs = policy.check
    if not len(inputs) or features.shape != (len(inputs), len(policy.centre)):
        raise UserError(f"{path}: has no self-check vectors that fit the network; train it again")
    if not np.allclose(policy.evaluate(features), inputs, rtol=0.0, atol=SELF_CHECK_TOLERANCE):
        raise UserError(f"{path}: does not reproduce its self-check vectors; train it again")
    return policy


@numba.njit(error_model="numpy")
def _forward(features: Array, centre: Array, inverse: Array, packed: Array, widths: Array, buffers: Array) -> float:
    """The network, without allocation: buffers (2, widest layer). NaN if a feature is not a number or infinite."""
    inside, outside = 0, 1
    for j in range(widths[0]):
        if not np.isfinite(features[j]):
            return np.nan
        buffers[inside, j] = (features[j] - centre[j]) * inverse[j]
    at = 0
    last = widths.shape[0] - 2
    for layer in range(last + 1):
        columns, rows = widths[layer], widths[layer + 1]
        biases = at + rows * columns
        for i in range(rows):
            total = packed[biases + i]
            for j in range(columns):
                total += packed[at + i * columns + j] * buffers[inside, j]
            buffers[outside, i] = total if layer == last else np.tanh(total)
        at = biases + rows
        inside, outside = outside, inside
    return buffers[inside, 0]
