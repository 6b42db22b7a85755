"""A policy as an ONNX graph in double precision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.policy.policy import FARTHEST, Policy
from hybrid_sysid_ros.core.networks import NetworkLayers
from hybrid_sysid_ros.extensions.export.vectors import NAMES, Vectors, parts
from hybrid_sysid_ros.support.extras import extra

OPERATORS, INTERMEDIATE = 13, 8
"""Versions of ONNX's operator set and file format: what runtimes of 2021 and later read."""

LARGEST = float(np.finfo(float).max)
BATCH = "instances"


class Graph:
    """Nodes and constants as they are added; each method returns the name of its result.

    Values are (instances, size) or, where stated, (instances, 1).
    """

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, kind: Any = np.float64) -> str:
        from onnx import numpy_helper

        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(values, dtype=kind), name))
        return name

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        from onnx import helper

        name = attributes.pop("name", f"v{len(self.nodes)}")
        self.nodes.append(helper.make_node(operator, list(inputs), [name], **attributes))
        return str(name)

    def picked(self, value: str, indices: Sequence[int], axis: int) -> str:
        """Some columns or rows."""
        return self.add("Gather", value, self.constant(indices, np.int64), axis=axis)

    def shaped(self, value: str, *sizes: int) -> str:
        """Other sizes behind the instances."""
        return self.add("Reshape", value, self.constant([-1, *sizes], np.int64))

    def clipped(self, value: str, low: str, high: str) -> str:
        return self.add("Min", self.add("Max", value, low), high)

    def finite(self, value: str) -> str:
        """Truths (instances, size): comparisons with what is not a number are false."""
        return self.add("LessOrEqual", self.add("Abs", value), self.constant(LARGEST))

    def all_of(self, truths: Sequence[str], **attributes: Any) -> str:
        """Truth (instances, 1) of truths (instances, sizes)."""
        joined = self.add("Concat", *truths, axis=1)
        least = self.add("ReduceMin", self.add("Cast", joined, to=_type("DOUBLE")), axes=[1], keepdims=1)
        return self.add("Greater", least, self.constant(0.5), **attributes)

    def network(self, value: str, layers: NetworkLayers) -> str:
        for index, (matrix, bias) in enumerate(layers):
            value = self.add("Gemm", value, self.constant(matrix), self.constant(bias), transB=1)
            if index < len(layers) - 1:
                value = self.add("Tanh", value)
        return value


def model(policy: Policy, *, name: str, about: Mapping[str, str]) -> Any:
    """The graph, checked by ONNX.

    Inputs, in SI units, over any number of instances: x (instances, states), d and u_previous (instances, inputs),
    preview (instances, horizon, outputs), and parameters (instances, followed parameters) where the policy has a
    correction. Outputs: inputs (instances, stages, inputs); answered and inside (instances, 1), as in C. Raises
    UserError where onnx is missing.
    """
    with extra("export"):
        import onnx
        from onnx import helper
    graph = Graph()
    problem, sizes = policy.problem, _sizes(policy)
    features = _features(graph, policy)
    shifted = graph.add("Sub", features, graph.constant(policy.centre))
    z = graph.add("Div", shifted, graph.constant(policy.scale))
    answers = graph.network(z, policy.layers)
    if policy.correction is not None:
        answers = graph.add("Add", answers, _correction(graph, policy, z))
    low, high = np.array(problem.input_low), np.array(problem.input_high)
    answers = graph.shaped(answers, policy.stages, policy.inputs)
    halves = graph.add("Mul", answers, graph.constant(0.5 * (high - low)))
    answers = graph.add("Add", halves, graph.constant(0.5 * (low + high)))
    flat = graph.shaped(answers, policy.stages * policy.inputs)
    answered = graph.all_of([graph.finite(z), graph.finite(flat)], name="answered")
    bounds = graph.constant(low), graph.constant(high)
    last = graph.clipped("u_previous", *bounds)
    nearest = graph.constant(np.clip(0.0, low, high))
    held = graph.add("Where", graph.finite("u_previous"), last, nearest)
    held = graph.add("Unsqueeze", held, graph.constant([1], np.int64))
    known = graph.add("Unsqueeze", answered, graph.constant([2], np.int64))
    graph.add("Where", known, _bounded(graph, policy, answers, last, bounds), held, name="inputs")
    _inside(graph, policy, features, z)
    given = [helper.make_tensor_value_info(key, _type("DOUBLE"), [BATCH, *size]) for key, size in sizes.items()]
    made = [helper.make_tensor_value_info("inputs", _type("DOUBLE"), [BATCH, policy.stages, policy.inputs])]
    made += [helper.make_tensor_value_info(key, _type("BOOL"), [BATCH, 1]) for key in ("answered", "inside")]
    whole = helper.make_model(
        helper.make_graph(graph.nodes, name, given, made, initializer=graph.constants),
        opset_imports=[helper.make_opsetid("", OPERATORS)],
        ir_version=INTERMEDIATE,
        producer_name="hybrid_sysid_ros",
    )
    helper.set_model_props(whole, dict(about))
    onnx.checker.check_model(whole, full_check=True)
    return whole


def _sizes(policy: Policy) -> dict[str, tuple[int, ...]]:
    """Of the graph's inputs, but for the number of instances."""
    followed = () if policy.correction is None else policy.correction.names
    inputs = (policy.inputs,)
    sizes = {"x": (policy.states,), "d": inputs, "u_previous": inputs, "preview": (policy.horizon, policy.outputs)}
    return {**sizes, "parameters": (len(followed),)} if followed else sizes


def _features(graph: Graph, policy: Policy) -> str:
    """[x, d, u_previous, q_1 - C x, .., q_N - C x] of the tracked outputs."""
    outputs = graph.add("MatMul", "x", graph.constant(policy.output_map.T))
    previews = graph.picked("preview", policy.tracked, 2)
    errors = graph.add("Sub", previews, graph.add("Unsqueeze", outputs, graph.constant([1], np.int64)))
    flat = graph.shaped(errors, policy.horizon * len(policy.tracked))
    return graph.add("Concat", "x", "d", "u_previous", flat, axis=1)


def evaluator() -> str:
    """What :func:`largest_difference` evaluates with."""
    with extra("export"):
        import onnx
    return f"reference evaluator of onnx {onnx.__version__}"


def largest_difference(path: Path, policy: Policy, vectors: Vectors) -> float:
    """Of a written graph's answers from those expected [drive unit], by ONNX's own evaluator in numpy."""
    with extra("export"):
        from onnx.reference import ReferenceEvaluator
    with np.errstate(all="ignore"):  # of the instances that are no numbers
        inputs, answered, inside = ReferenceEvaluator(str(path)).run(None, feed(policy, vectors.instances))
    return vectors.difference(inputs, answered, inside)


def feed(policy: Policy, instances: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """The graph's inputs by name."""
    given = dict(zip(NAMES, parts(policy, instances), strict=True))
    return given if policy.correction is not None else {name: given[name] for name in NAMES[:-1]}


def _correction(graph: Graph, policy: Policy, z: str) -> str:
    """sum_p slope_pk (theta_p - theta_0p) / spread_p, (instances, stages inputs)."""
    correction = policy.correction
    assert correction is not None
    count = len(correction.names)
    moved = graph.add("Sub", "parameters", graph.constant(correction.nominal))
    spreads = graph.add("Div", moved, graph.constant(correction.spread))
    near = graph.clipped(spreads, graph.constant(-FARTHEST), graph.constant(FARTHEST))
    deviation = graph.add("Where", graph.finite("parameters"), near, graph.constant(0.0))
    slopes = graph.shaped(graph.network(z, correction.layers), count, policy.stages * policy.inputs)
    factors = graph.add("Unsqueeze", deviation, graph.constant([2], np.int64))
    return graph.add("ReduceSum", graph.add("Mul", slopes, factors), graph.constant([1], np.int64), keepdims=0)


def _bounded(graph: Graph, policy: Policy, answers: str, last: str, bounds: tuple[str, str]) -> str:
    """Each stage (instances, inputs) within its bounds, and within the rate limits about the one before."""
    rates = np.array(policy.problem.rate_limits)
    if np.all(np.isinf(rates)):
        return graph.clipped(answers, *bounds)
    rate = graph.constant(rates)
    inputs = []
    for k in range(policy.stages):
        stage = graph.shaped(graph.picked(answers, [k], 1), policy.inputs)
        near = graph.clipped(stage, graph.add("Sub", last, rate), graph.add("Add", last, rate))
        last = graph.clipped(near, *bounds)
        inputs.append(graph.add("Unsqueeze", last, graph.constant([1], np.int64)))
    return graph.add("Concat", *inputs, axis=1)


def _inside(graph: Graph, policy: Policy, features: str, z: str) -> None:
    inside = policy.training_range
    above = graph.add("GreaterOrEqual", features, graph.constant(inside.low))
    below = graph.add("LessOrEqual", features, graph.constant(inside.high))
    rotated = graph.add("Gemm", z, graph.constant(inside.whitening), transB=1)
    squared = graph.add("ReduceSumSquare", rotated, axes=[1], keepdims=1)
    near = graph.add("LessOrEqual", squared, graph.constant(inside.reach**2))
    graph.all_of([above, below, near], name="inside")


def _type(name: str) -> Any:
    from onnx import TensorProto

    return getattr(TensorProto, name)
