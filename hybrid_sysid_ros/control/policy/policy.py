"""Approximate MPC: a network that answers in microseconds, with numpy and numba but without torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.controller import MpcSolution, Status, held
from hybrid_sysid_ros.control.policy import kernels
from hybrid_sysid_ros.control.policy.kernels import Packed, TrainingRange, widths_of
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.safety import certificate as certificates
from hybrid_sysid_ros.control.safety.certificate import Certificate
from hybrid_sysid_ros.core.networks import NetworkLayers
from hybrid_sysid_ros.models import Model, storage
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

FARTHEST = 2.0
"""Limit of a parameter's deviation in spreads, since the correction is linear."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction:
    """u = NN(z) + NN_S(z) (theta - theta_0) / spread: NN_S is the derivative of the exact MPC's inputs by parameters.

    names: those of theta. nominal, spread (parameters,) in their units. layers: those of NN_S, whose outputs are
    (parameters, outputs of NN) row by row, in units of the input limit. Hose, Gräfe, Trimpe (2024), Parameter-adaptive
    approximate MPC: tuning neural-network controllers without retraining, L4DC.
    """

    names: tuple[str, ...]
    nominal: Array
    spread: Array
    layers: tuple[tuple[Array, Array], ...]

    def deviation(self, values: Mapping[str, float], before: Array) -> Array:
        """Deviation (parameters,) in spreads, limited to +-:data:`FARTHEST`; ``before`` where a value is not finite."""
        found = before.copy()
        for index, name in enumerate(self.names):
            value = values.get(name, np.nan)
            if np.isfinite(value):
                found[index] = (float(value) - float(self.nominal[index])) / float(self.spread[index])
        return np.clip(found, -FARTHEST, FARTHEST)


FORMAT = 3

SELF_CHECK_TOLERANCE = 1e-9
"""Largest difference [unit of the input] from the self-check vectors on loading."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Policy:
    """u_0..u_{K-1} = NN(x, d, u_previous, q_1..q_N), the imitation of an exact MPC, kept within its bounds.

    The features are [x, d, u_previous, q_1 - C x, ..., q_N - C x] with the tracked outputs q, less ``centre`` and
    divided by ``scale``. Tanh layers with weights W and biases b and a linear output follow: 0 is the middle of an
    input's bounds, +-1 are the bounds. K is 1, or the horizon: a whole plan can be checked by simulation (Hose, Köhler,
    Zeilinger, Trimpe 2025, Approximate nonlinear MPC with safety-augmented neural networks, IEEE TCST 33(6)).
    """

    problem: ControlProblem
    """The problem of the imitated MPC, sized: n states, m inputs, p outputs."""
    model: str
    """Seal of that MPC's model."""
    rig: str
    output_map: Array
    """C (tracked, n), derivative of the tracked outputs by the states near rest, for the errors among the features."""
    centre: Array
    """(features,)."""
    scale: Array
    """(features,), above 0."""
    layers: tuple[tuple[Array, Array], ...]
    """W (out, in) and b (out,) in turn."""
    training_range: TrainingRange
    """Range of the features in training."""
    correction: Correction | None = None
    """Correction for parameters that are estimated online, if any."""
    training: Mapping[str, Any] = field(default_factory=dict)
    """How it was trained, and how well it imitates."""
    check: tuple[Array, Array] = (np.zeros((0, 0)), np.zeros((0, 1, 1)))
    """Features (samples, features) and unbounded inputs (samples, K, m) that it must reproduce when it is loaded."""
    certificate: Certificate | None = None
    """Its certificate, if it has one."""
    packed: Packed = field(init=False, repr=False)
    """The policy for compiled functions."""
    _shape: tuple[int, int] = field(init=False, repr=False)
    _no_states: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        features, inputs = self._feature_count(), self.inputs
        count = _answers(self.layers, features)
        if count not in (inputs, inputs * self.horizon):
            raise UserError(f"policy: {count} answers are neither {inputs} inputs nor a plan of {self.horizon}")
        if self.centre.shape != (features,) or self.scale.shape != (features,) or not np.all(self.scale > 0):
            raise UserError(f"policy: centre and scale need {features} numbers, the scale above 0")
        if self.training_range.low.shape != (features,):
            raise UserError(f"policy: the training range does not fit its {features} features")
        names = () if self.correction is None else self.correction.names
        if self.correction is not None:
            if not np.all(self.correction.spread > 0):
                raise UserError("policy: the spread of the correction must be above 0")
            found = _answers(self.correction.layers, features)
            if found != len(names) * count:
                raise UserError(f"policy: the correction has {found} answers for {len(names)} parameters")
        problem = self.problem
        packed = kernels.packed(
            bounds=[np.array(problem.input_low), np.array(problem.input_high), np.array(problem.rate_limits)],
            outputs=self.outputs,
            tracked=self.tracked,
            output_map=self.output_map,
            horizon=self.horizon,
            standard=(self.centre, self.scale),
            training_range=self.training_range.packed,
            layers=self.layers,
            correction=() if self.correction is None else self.correction.layers,
            followed=len(names),
        )
        made = {"packed": packed, "_shape": (count // inputs, inputs), "_no_states": np.zeros((0, self.states))}
        for name, value in made.items():
            object.__setattr__(self, name, value)

    def _feature_count(self) -> int:
        """Raises UserError for a problem that is not sized, or an output map that does not fit it."""
        problem = self.problem
        sizes = {len(problem.input_low), len(problem.rate_limits), len(problem.rate_weights)}
        if len(sizes) > 1 or len(problem.output_weights) != len(problem.output_scales):
            raise UserError("policy: its problem needs a value for each input and output")
        if self.output_map.ndim != 2 or self.output_map.shape != (len(self.tracked), len(problem.state_low)):
            shape = f"{len(self.tracked)} tracked outputs and {len(problem.state_low)} states"
            raise UserError(f"policy: an output map of shape {self.output_map.shape} does not fit {shape}")
        return self.states + 2 * self.inputs + self.horizon * len(self.tracked)

    @property
    def states(self) -> int:
        return self.output_map.shape[1]

    @property
    def inputs(self) -> int:
        return len(self.problem.input_low)

    @property
    def outputs(self) -> int:
        return len(self.problem.output_weights)

    @property
    def tracked(self) -> tuple[int, ...]:
        """Indices of the outputs that the problem weights; references of the others are not read."""
        return tuple(index for index, weight in enumerate(self.problem.output_weights) if weight > 0)

    @property
    def horizon(self) -> int:
        return self.problem.horizon

    @property
    def period(self) -> float:
        return self.problem.period

    @property
    def stages(self) -> int:
        """K, the number of intervals in an answer: 1 or the horizon."""
        return len(self.layers[-1][1]) // self.inputs

    def reset(self) -> None:
        """A policy remembers nothing but the parameters it is adapted to."""

    def prepare(self, elapsed: float) -> None:
        """A policy has nothing to prepare."""

    def adapt(self, parameters: Mapping[str, float]) -> None:
        """Adapt to estimated parameters of the plant, by name, in their units. A policy without a correction ignores
        them.
        """
        if self.correction is not None:
            numbers = self.packed.numbers
            deviation = numbers[len(numbers) - len(self.correction.names) :]
            deviation[:] = self.correction.deviation(parameters, deviation)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`. A part that is not a number gives HELD: the
        previous input within its bounds, or the value nearest to zero. Raises ValueError for a part of another size.
        """
        plan, (sizes, numbers) = np.empty(self._shape), self.packed
        try:
            found = kernels.answer_in_parts()(state, disturbance, previous_input, preview, sizes, numbers, plan)
        except TypeError:  # other kinds of arrays
            parts = (np.asarray(part, dtype=float) for part in (state, disturbance, previous_input, preview))
            found = kernels.answer_in_parts()(*parts, sizes, numbers, plan)
        if found:
            return MpcSolution(plan[0], plan, self._no_states, Status.POLICY)
        kept = held(np.asarray(previous_input, dtype=float), self.problem, Status.HELD)
        return kept._replace(inputs=kept.inputs[: self.stages])

    def inside(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> bool:
        """Whether an instance is within the training range; False where something is not a number."""
        flat = np.concatenate([np.ravel(part) for part in (state, disturbance, previous_input, preview)])
        return bool(kernels.contains(*self.packed, flat.astype(float)))

    def features(self, instances: Array) -> Array:
        """Raw features (samples, features) of flat instances (samples, n + 2 m + N p)."""
        return policy_features(instances, self.output_map, self.tracked, self.inputs, self.outputs)

    def evaluate(self, features: Array) -> Array:
        """Unbounded inputs (samples, K, m) for raw features (samples, features)."""
        rows = np.ascontiguousarray(features, dtype=float)
        answers = np.empty((len(rows), len(self.layers[-1][1])))
        kernels.rows(*self.packed, rows, answers)
        return answers.reshape(len(rows), self.stages, self.inputs)

    def save(self, folder: Path | str) -> None:
        """Write the policy folder; see :mod:`~hybrid_sysid_ros.models.storage`."""
        arrays = {
            "output_map": self.output_map,
            "centre": self.centre,
            "scale": self.scale,
            "range_low": self.training_range.low,
            "range_high": self.training_range.high,
            "range_whitening": self.training_range.whitening,
            "check_features": self.check[0],
            "check_inputs": self.check[1],
            **named_layers("", self.layers),
        }
        content = {
            "rig": self.rig,
            "model": self.model,
            "layers": len(self.layers),
            "problem": asdict(self.problem),
            "range_reach": self.training_range.reach,
            "correction": None,
            "training": dict(self.training),
        }
        if self.correction is not None:
            arrays |= {"nominal": self.correction.nominal, "spread": self.correction.spread}
            arrays |= named_layers("S", self.correction.layers)
            content["correction"] = {"names": self.correction.names, "layers": len(self.correction.layers)}
        storage.save(folder, kind="policy", version=FORMAT, content=content, arrays=arrays)


def policy_features(instances: Array, output_map: Array, tracked: Sequence[int], inputs: int, outputs: int) -> Array:
    """Raw features (samples, features) of flat instances [x, d, u_previous, q_1 (outputs,), ..] (samples, size)."""
    states = output_map.shape[1]
    first, count = states + 2 * inputs, len(instances)
    previews = instances[:, first:].reshape(count, -1, outputs)[:, :, list(tracked)]
    errors = previews - (instances[:, :states] @ output_map.T)[:, None, :]
    return np.column_stack([instances[:, :first], errors.reshape(count, -1)])


def load(folder: Path | str, *, model: Model | None = None, certified: bool = True) -> Policy:
    """Read a policy folder and run its self-check.

    model: the model that it will be used with. certified: read its certificate, if there is one. Raises UserError where
    a file is missing, altered, newer or older, where the policy was made for another model, where its self-check
    vectors are not reproduced, and where the certificate belongs to another policy.
    """
    content, arrays = storage.load(folder, kind="policy", version=FORMAT)
    path = Path(folder) / "policy.yaml"
    certificate = None
    if certified and "model" in content:
        certificate = certificates.find_certificate(folder, policy=content["seal"], model=content["model"])
    numbers = partial(storage.numbers, arrays)
    try:
        policy = Policy(
            problem=ControlProblem(**content["problem"]),
            model=content["model"],
            rig=rigs.name_in(content),
            output_map=numbers("output_map", None, None),
            centre=numbers("centre", None),
            scale=numbers("scale", None),
            layers=_layers("", content["layers"], arrays),
            training_range=TrainingRange(
                low=numbers("range_low", None),
                high=numbers("range_high", None),
                whitening=numbers("range_whitening", None, None),
                reach=float(content["range_reach"]),
            ),
            correction=_correction(content["correction"], arrays),
            training=content["training"],
            check=(numbers("check_features", None, None), numbers("check_inputs", None, None, None)),
            certificate=certificate,
        )
    except UserError as error:
        raise UserError(f"{path}: {error}; train it again") from error
    except (KeyError, TypeError, ValueError, OverflowError, IndexError, AttributeError) as error:
        raise UserError(f"{path}: {error!r} is missing or malformed; train it again") from error
    if model is not None and policy.model != model.seal:
        raise UserError(f"{path}: was trained for another model; train it for this one (hybrid-sysid policy train)")
    features, inputs = policy.check
    if not len(inputs) or features.shape != (len(inputs), len(policy.centre)):
        raise UserError(f"{path}: has no self-check vectors that fit the network; train it again")
    answers = policy.evaluate(features)
    if answers.shape != inputs.shape or not np.allclose(answers, inputs, rtol=0.0, atol=SELF_CHECK_TOLERANCE):
        raise UserError(f"{path}: does not reproduce its self-check vectors; train it again")
    return policy


def _answers(layers: NetworkLayers, features: int) -> int:
    """Number of a network's outputs. Raises UserError where its features don't fit."""
    widths = widths_of(layers)
    if widths[0] != features:
        raise UserError(f"policy: a network of {widths[0]} features does not fit the {features} of its problem")
    return widths[-1]


def named_layers(prefix: str, layers: NetworkLayers) -> dict[str, Array]:
    """Weights and biases by the names W0, b0, W1, ... with a prefix."""
    return {f"{prefix}{kind}{i}": part for i, pair in enumerate(layers) for kind, part in zip("Wb", pair, strict=True)}


def _layers(prefix: str, count: int, arrays: Mapping[str, Array]) -> tuple[tuple[Array, Array], ...]:
    numbers = partial(storage.numbers, arrays)
    return tuple((numbers(f"{prefix}W{i}", None, None), numbers(f"{prefix}b{i}", None)) for i in range(count))


def _correction(content: Mapping[str, Any] | None, arrays: Mapping[str, Array]) -> Correction | None:
    if content is None:
        return None
    names = tuple(content["names"])
    return Correction(
        names=names,
        nominal=storage.numbers(arrays, "nominal", len(names)),
        spread=storage.numbers(arrays, "spread", len(names)),
        layers=_layers("S", content["layers"], arrays),
    )
