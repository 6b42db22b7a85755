"""A policy as self-contained C99: a header, a source and a test with its vectors built in."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.export.c_templates import CORRECTION, FOLLOWED, HEADER, SOURCE, TEST
from hybrid_sysid_ros.control.export.vectors import Vectors, parts
from hybrid_sysid_ros.control.policy.adaptation import FARTHEST
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.core.networks import Layers

Array = NDArray[np.float64]
WIDTH = 118


def sources(
    policy: Policy, vectors: Vectors, *, name: str, about: Mapping[str, str], tolerance: float
) -> dict[str, str]:
    """The texts of NAME.h, NAME.c and NAME_test.c by their file names.

    name: of the C function, an identifier. about: what the comment at the head of each says. tolerance: of the test
    [unit of the inputs].
    """
    correction = policy.correction
    layers = policy.layers if correction is None else (*policy.layers, *correction.layers)
    values = {
        "name": name,
        "NAME": name.upper(),
        "about": "\n".join(f" * {key}: {value}" for key, value in about.items()),
        "states": policy.states,
        "horizon": policy.horizon,
        "inputs": policy.inputs,
        "outputs": policy.outputs,
        "stages": policy.stages,
        "parameters": 0 if correction is None else len(correction.names),
        "widest": max(max(matrix.shape) for matrix, _ in layers),
        "tracked": len(policy.tracked),
        "reach": number(policy.training_range.reach),
        "farthest": number(FARTHEST),
        "tolerance": number(tolerance),
        "vectors": len(vectors),
        "signature": "" if correction is None else f"\n    const double parameters[{name.upper()}_PARAMETERS],",
        "followed": "" if correction is None else FOLLOWED.substitute(names=", ".join(correction.names)),
        "asked": "" if correction is None else "vectors[i].parameters, ",
        "field": "" if correction is None else f"double parameters[{name.upper()}_PARAMETERS]; ",
        "weights": _weights(policy),
        "network": _network("network", policy.layers, ""),
        "sensitivity": "" if correction is None else _network("sensitivity", correction.layers, "S"),
        "correct": "" if correction is None else "        correct(z, parameters, answers);\n",
        "table": _table(policy, vectors),
    }
    values["corrected"] = "" if correction is None else CORRECTION.substitute(values)
    return {
        f"{name}.h": HEADER.substitute(values),
        f"{name}.c": SOURCE.substitute(values),
        f"{name}_test.c": TEST.substitute(values),
    }


def number(value: float) -> str:
    """A double that a C compiler reads back to the last bit."""
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def _numbers(values: Array) -> str:
    return ", ".join(number(value) for value in np.ravel(values))


def _array(name: str, values: Array) -> str:
    body = textwrap.fill(_numbers(values), WIDTH, initial_indent="    ", subsequent_indent="    ")
    return f"static const double {name}[{np.size(values)}] = {{\n{body}\n}};\n"


def _weights(policy: Policy) -> str:
    inside = policy.training_range
    triangle = inside.whitening[np.tril_indices(len(inside.whitening))]
    problem = policy.problem
    arrays: list[tuple[str, Array]] = [("centre", policy.centre), ("scale", policy.scale)]
    arrays += [("input_low", np.array(problem.input_low)), ("input_high", np.array(problem.input_high))]
    arrays += [("rate_limit", np.array(problem.rate_limits)), ("output_map", policy.output_map)]
    arrays += [("lowest", inside.low), ("highest", inside.high), ("whitening", triangle)]
    if policy.correction is not None:
        arrays += [("nominal", policy.correction.nominal), ("spread", policy.correction.spread)]
    for prefix, layers in _networks(policy):
        for index, (matrix, bias) in enumerate(layers):
            arrays += [(f"{prefix}W{index}", matrix), (f"{prefix}b{index}", bias)]
    tracked = f"static const int tracked[{len(policy.tracked)}] = {{{', '.join(map(str, policy.tracked))}}};\n"
    return "\n".join([tracked, *(_array(name, values) for name, values in arrays)])


def _networks(policy: Policy) -> Sequence[tuple[str, Layers]]:
    plain = ("", policy.layers)
    return (plain,) if policy.correction is None else (plain, ("S", policy.correction.layers))


def _network(function: str, layers: Layers, prefix: str) -> str:
    """One call of layer() for each; the values go to and fro between two arrays."""
    begin = f"static void {function}(const double z[FEATURES], double answers[{len(layers[-1][1])}])\n{{\n"
    lines = ["double one[WIDEST], other[WIDEST];" if len(layers) > 2 else "double one[WIDEST];", ""]
    come, go = "z", "one"
    for index, (matrix, _) in enumerate(layers):
        rows, columns = matrix.shape
        last = index == len(layers) - 1
        target = "answers" if last else go
        activation = "STRAIGHT" if last else "TANH"
        weights, biases = f"{prefix}W{index}", f"{prefix}b{index}"
        lines.append(f"layer({weights}, {biases}, {come}, {columns}, {target}, {rows}, {activation});")
        come, go = target, "other" if target == "one" else "one"
    return begin + "".join(f"    {line}\n" if line else "\n" for line in lines) + "}\n"


def _table(policy: Policy, vectors: Vectors) -> str:
    rows = []
    *given, parameters = parts(policy, vectors.instances)
    given += [parameters] if parameters.size else []
    for *numbers, answered, inside in zip(*given, vectors.inputs, vectors.answered, vectors.inside, strict=True):
        cells = [f"{{{_numbers(values)}}}" for values in numbers] + [str(int(answered[0])), str(int(inside[0]))]
        row = "{" + ", ".join(cells) + "}"
        rows.append(textwrap.fill(row, WIDTH, initial_indent="    ", subsequent_indent="     ", break_on_hyphens=False))
    return ",\n".join(rows)
