"""A policy as self-contained C99: a header, a source and a test with its vectors built in."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from string import Template

import numpy as np

from hybrid_sysid_ros.control.policy.policy import FARTHEST, Policy, named_layers
from hybrid_sysid_ros.core.networks import NetworkLayers
from hybrid_sysid_ros.extensions.export.vectors import Vectors, parts
from hybrid_sysid_ros.support.arrays import Array

WIDTH = 118
TEMPLATES = Path(__file__).parent / "c"
"""policy.h, policy.c and policy_test.c; what stands behind an @ is filled in."""


class Text(Template):
    """C has no use for @, but format strings for %."""

    delimiter = "@"


def sources(
    policy: Policy, vectors: Vectors, *, name: str, about: Mapping[str, str], tolerance: float
) -> dict[str, str]:
    """The texts of NAME.h, NAME.c and NAME_test.c by their file names.

    name: of the C function, an identifier. about: what the comment at the head of each says. tolerance: of the test
    [unit of the inputs].
    """
    correction = policy.correction
    names = () if correction is None else correction.names
    followed: NetworkLayers = () if correction is None else correction.layers
    values = {
        "name": name,
        "NAME": name.upper(),
        "about": "\n".join(f" * {key}: {value}" for key, value in about.items()),
        "states": policy.states,
        "horizon": policy.horizon,
        "inputs": policy.inputs,
        "outputs": policy.outputs,
        "stages": policy.stages,
        "parameters": len(names),
        "names": ", ".join(names) or "none",
        "widest": max(max(matrix.shape) for matrix, _ in (*policy.layers, *followed)),
        "tracked": len(policy.tracked),
        "reach": number(policy.training_range.reach),
        "farthest": number(FARTHEST),
        "tolerance": number(tolerance),
        "vectors": len(vectors),
        "weights": _weights(policy),
        "layers": _layers(policy.layers, ""),
        "corrections": _layers(followed, "S"),
        "table": _table(policy, vectors),
    }
    return {
        f"{name}{ending}": Text((TEMPLATES / f"policy{ending}").read_text(encoding="utf-8")).substitute(values)
        for ending in (".h", ".c", "_test.c")
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
    arrays += named_layers("", policy.layers).items()
    if policy.correction is not None:
        arrays += [("nominal", policy.correction.nominal), ("spread", policy.correction.spread)]
        arrays += named_layers("S", policy.correction.layers).items()
    tracked = f"static const int tracked[{len(policy.tracked)}] = {{{', '.join(map(str, policy.tracked))}}};\n"
    return "\n".join([tracked, *(_array(name, values) for name, values in arrays)])


def _layers(layers: NetworkLayers, prefix: str) -> str:
    sizes = [matrix.shape for matrix, _ in layers]
    return ",\n".join(f"    {{{prefix}W{k}, {prefix}b{k}, {wide}, {high}}}" for k, (high, wide) in enumerate(sizes))


def _table(policy: Policy, vectors: Vectors) -> str:
    rows = []
    *given, parameters = parts(policy, vectors.instances)
    given += [parameters] if parameters.size else []
    for *numbers, answered, inside in zip(*given, vectors.inputs, vectors.answered, vectors.inside, strict=True):
        cells = [f"{{{_numbers(values)}}}" for values in numbers] + [str(int(answered[0])), str(int(inside[0]))]
        row = "{" + ", ".join(cells) + "}"
        rows.append(textwrap.fill(row, WIDTH, initial_indent="    ", subsequent_indent="     ", break_on_hyphens=False))
    return ",\n".join(rows)
