"""Approximate MPC: a network that answers in microseconds. It needs numpy and numba, not torch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Plan, Status
from hybrid_sysid_ros.control.policy import kernels as policy_kernels
from hybrid_sysid_ros.control.policy.adaptation import Correction
from hybrid_sysid_ros.control.policy.kernels import Form, Kernels
from hybrid_sysid_ros.control.policy.training_range import TrainingRange
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.control.safety import certificate as certificates
from hybrid_sysid_ros.control.safety.certificate import Certificate
from hybrid_sysid_ros.core.perceptron import Layers, Perceptron
from hybrid_sysid_ros.models import Model, storage
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

FORMAT = 2

SELF_CHECK_TOLERANCE = 1e-9
"""Largest difference [drive unit] of the self-check vectors on loading."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Policy:
    """u_0..u_{K-1} = NN(x, d, u_previous, q_1..q_N), the imitation of an exact MPC, kept within its bounds.

    The features are [x, d, u_previous, q_1 - y, ..., q_N - y], shifted by ``centre`` and divided by ``scale``
    (features,); tanh layers with weights W and biases b follow and a straight output in units of the input limit.
    K is 1, or the horizon: the whole sequence, which can be checked by simulating it (Hose, Köhler, Zeilinger,
    Trimpe 2025, Approximate nonlinear MPC with safety-augmented neural networks, IEEE TCST 33(6)).

    problem: the MPC it imitates. model: seal of that MPC's model. output: the state that is measured. layers: W (out,
    in) and b (out,) in turn. training_range: of the features. correction: for parameters that are estimated online, if
    any. training: how it was made and how near it comes. check: features (samples, features) and inputs (samples, K)
    that the network must reproduce when it is loaded. certificate: what closed loops say about it, where it has one.
    """

    problem: Problem
    model: str
    rig: str
    states: int
    output: int
    centre: Array
    scale: Array
    layers: tuple[tuple[Array, Array], ...]
    training_range: TrainingRange
    correction: Correction | None = None
    training: Mapping[str, Any] = field(default_factory=dict)
    check: tuple[Array, Array] = (np.zeros((0, 0)), np.zeros((0, 1)))
    certificate: Certificate | None = None
    # What an answer needs, made once.
    kernels: Kernels = field(init=False, repr=False)
    memory: Array = field(init=False, repr=False)
    _range: Array = field(init=False, repr=False)
    _shape: tuple[int, int] = field(init=False, repr=False)
    _no_states: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        features = self.states + 2 + self.problem.horizon
        network = _perceptron(self.layers, features)
        if network.widths[-1] not in (1, self.problem.horizon):
            raise UserError(f"policy: {network.widths[-1]} outputs are neither 1 nor the horizon")
        if not 0 <= self.output < self.states:
            raise UserError(f"policy: output {self.output} is none of its {self.states} states")
        if self.centre.shape != (features,) or self.scale.shape != (features,) or not np.all(self.scale > 0):
            raise UserError(f"policy: centre and scale need {features} numbers, the scale above 0")
        if self.training_range.low.shape != (features,):
            raise UserError(f"policy: the training range does not fit its {features} features")
        corrector: Perceptron | None = None
        names: tuple[str, ...] = ()
        if self.correction is not None:
            corrector, names = _perceptron(self.correction.layers, features), self.correction.names
            if corrector.widths[-1] != len(names) * network.widths[-1]:
                raise UserError(
                    f"policy: the correction has {corrector.widths[-1]} outputs for {len(names)} parameters"
                )
        form = Form(
            network=network, states=self.states, output=self.output, correction=corrector, parameters=len(names)
        )
        corrections = np.zeros(0)
        if corrector is not None and self.correction is not None:
            corrections = corrector.packed(self.correction.layers)
        memory = policy_kernels.memory(
            input_limit=self.problem.input_high[0],
            rate_limit=self.problem.rate_limits[0],
            centre=self.centre,
            scale=self.scale,
            weights=network.packed(self.layers),
            correction=corrections,
            deviation=np.zeros(len(names)),
        )
        made = {
            "kernels": policy_kernels.kernels(form),
            "memory": memory,
            "_range": self.training_range.packed,
            "_shape": (network.widths[-1], 1),
            "_no_states": np.zeros((0, self.states)),
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)

    @property
    def horizon(self) -> int:
        return self.problem.horizon

    @property
    def period(self) -> float:
        return self.problem.period

    @property
    def outputs(self) -> int:
        """How many inputs it answers with: 1 or the horizon."""
        return len(self.layers[-1][1])

    def reset(self) -> None:
        """A policy remembers nothing but the parameters it is adapted to."""

    def prepare(self, elapsed: float) -> None:
        """A policy has nothing to prepare."""

    def adapt(self, parameters: Mapping[str, float]) -> None:
        """Follow the plant's parameters as they are estimated, by name [their unit]; a policy without a correction
        leaves them unread.
        """
        if self.correction is not None:
            deviation = self.memory[len(self.memory) - len(self.correction.names) :]
            deviation[:] = self.correction.deviation(parameters, deviation)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`. An input that is not a number gives HELD: the
        previous input within its bounds, or zero. Raises ValueError for a state or a preview of another length.
        """
        inputs, preview = np.empty(self._shape), np.ravel(preview)
        try:
            found = self.kernels.control(state, disturbance, previous_input, preview, self.memory, inputs)
        except TypeError:  # other kinds of arrays
            parts = (np.asarray(part, dtype=float) for part in (state, disturbance, previous_input, preview))
            found = self.kernels.control(*parts, self.memory, inputs)
        if found:
            return Plan(inputs[0], inputs, self._no_states, Status.POLICY)
        last, limit = float(previous_input[0]), self.problem.input_high[0]
        inputs[:] = min(max(last, -limit), limit) if math.isfinite(last) else 0.0
        return Plan(inputs[0], inputs, self._no_states, Status.HELD)

    def inside(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> bool:
        """Whether a question is one like those of the training; never where something is not a number."""
        question = np.concatenate([state, disturbance, previous_input, np.ravel(preview)])
        return bool(self.kernels.contains(question, self.memory, self._range))

    def evaluate(self, features: Array) -> Array:
        """Unbounded answers (samples, K) to raw features (samples, features)."""
        rows = np.ascontiguousarray(features, dtype=float)
        answers = np.empty((len(rows), self.outputs))
        self.kernels.raw(rows, self.memory, answers)
        return answers

    def __reduce__(self) -> tuple[Any, ...]:
        """Compiled functions don't travel to other processes; they are made there."""
        return _remade, ({item.name: getattr(self, item.name) for item in fields(self) if item.init},)

    def save(self, folder: Path | str) -> None:
        """Write the policy folder; see :mod:`~hybrid_sysid_ros.models.storage`."""
        arrays = {
            "centre": self.centre,
            "scale": self.scale,
            "range_low": self.training_range.low,
            "range_high": self.training_range.high,
            "range_whitening": self.training_range.whitening,
            "check_features": self.check[0],
            "check_inputs": self.check[1],
            **_named("", self.layers),
        }
        content = {
            "rig": self.rig,
            "model": self.model,
            "states": self.states,
            "output": self.output,
            "layers": len(self.layers),
            "problem": {
                name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self.problem).items()
            },
            "range_reach": self.training_range.reach,
            "correction": None,
            "training": dict(self.training),
        }
        if self.correction is not None:
            arrays |= {"nominal": self.correction.nominal, "spread": self.correction.spread}
            arrays |= _named("S", self.correction.layers)
            content["correction"] = {"names": self.correction.names, "layers": len(self.correction.layers)}
        storage.save(folder, kind="policy", version=FORMAT, content=content, arrays=arrays)


def load(folder: Path | str, *, model: Model | None = None, certified: bool = True) -> Policy:
    """Read a policy folder and let it check itself.

    model: the one that it is to be used with. certified: read its certificate, where there is one. Raises UserError
    where a file is missing, altered, newer or older, where the policy was made for another model, where its self-check
    vectors are not reproduced, and where the certificate is not this policy's.
    """
    content, arrays = storage.load(folder, kind="policy", version=FORMAT)
    path = Path(folder) / "policy.yaml"
    certificate = None
    if certified and "model" in content:
        certificate = certificates.find(folder, policy=content["seal"], model=content["model"])
    try:
        policy = Policy(
            problem=Problem(**content["problem"]),
            model=content["model"],
            rig=content["rig"],
            states=content["states"],
            output=content["output"],
            centre=arrays["centre"],
            scale=arrays["scale"],
            layers=_layers("", content["layers"], arrays),
            training_range=TrainingRange(
                low=arrays["range_low"],
                high=arrays["range_high"],
                whitening=arrays["range_whitening"],
                reach=float(content["range_reach"]),
            ),
            correction=_correction(content["correction"], arrays),
            training=content["training"],
            check=(arrays["check_features"], arrays["check_inputs"]),
            certificate=certificate,
        )
    except UserError as error:
        raise UserError(f"{path}: {error}; train it again") from error
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise UserError(f"{path}: {error!r} is missing or malformed; train it again") from error
    if model is not None and policy.model != model.seal:
        raise UserError(f"{path}: was trained for another model; train it for this one (hybrid-sysid policy train)")
    features, inputs = policy.check
    if not len(inputs) or features.shape != (len(inputs), len(policy.centre)) or inputs.ndim != 2:
        raise UserError(f"{path}: has no self-check vectors that fit the network; train it again")
    answers = policy.evaluate(features)
    if answers.shape != inputs.shape or not np.allclose(answers, inputs, rtol=0.0, atol=SELF_CHECK_TOLERANCE):
        raise UserError(f"{path}: does not reproduce its self-check vectors; train it again")
    return policy


def _remade(given: dict[str, Any]) -> Policy:
    return Policy(**given)


def _perceptron(layers: Layers, features: int) -> Perceptron:
    network = Perceptron.of(layers)
    if network.widths[0] != features:
        raise UserError(f"policy: a network of {network.widths[0]} features does not fit the {features} of its problem")
    return network


def _named(prefix: str, layers: Layers) -> dict[str, Array]:
    """W0, b0, W1, ... with a prefix."""
    return {f"{prefix}{kind}{i}": part for i, pair in enumerate(layers) for kind, part in zip("Wb", pair, strict=True)}


def _layers(prefix: str, count: int, arrays: Mapping[str, Array]) -> tuple[tuple[Array, Array], ...]:
    return tuple((arrays[f"{prefix}W{i}"], arrays[f"{prefix}b{i}"]) for i in range(count))


def _correction(content: Mapping[str, Any] | None, arrays: Mapping[str, Array]) -> Correction | None:
    if content is None:
        return None
    return Correction(
        names=tuple(content["names"]),
        nominal=arrays["nominal"],
        spread=arrays["spread"],
        layers=_layers("S", content["layers"], arrays),
    )
