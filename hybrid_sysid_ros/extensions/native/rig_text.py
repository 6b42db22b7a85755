"""What a native loop knows of its rig, model and parameters, as C: the rest of it is the same for all."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.safety.guard import CAUSES, REASONS
from hybrid_sysid_ros.extensions.export.unit.folder import unit_name
from hybrid_sysid_ros.extensions.export.unit.python_loop import PythonLoop
from hybrid_sysid_ros.extensions.native.rig_parameters import AT_START, LIVE, NODES, UNWATCHED_LOOP, UNWATCHED_SENSORS
from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.adapters import SLACK, WINDOW
from hybrid_sysid_ros.nodes.signal_layout import FIELDS, SignalLayout, SignalPlace
from hybrid_sysid_ros.rigs.rig import BEYOND, Rig
from hybrid_sysid_ros.runtime.parameters import NodeParameter, declarations, parameters

KINDS = {bool: "IS_BOOL", int: "IS_WHOLE", float: "IS_NUMBER", str: "IS_TEXT"}


def of_ros() -> dict[str, NodeParameter]:
    """The parameter that every node of ROS has."""
    return {
        "use_sim_time": NodeParameter(
            name="use_sim_time", default=False, description="Time is that of /clock, not of the system"
        )
    }


def texts(rig: Rig, python: PythonLoop, values: Mapping[str, Mapping[str, Any]], *, body: str) -> dict[str, str]:
    """rig.h and rig.c of a loop. values: all parameters of both nodes. body: what the diagnostics call it."""
    layout, followed = SignalLayout(rig, python.estimator.system), tuple(python.estimator.tuning.followed)
    forms = {
        "estimate_form": layout.estimate(followed),
        "command_form": layout.inputs,
        "plan_form": [*layout.states, *layout.inputs],
    }
    header, source = [f'#include "{unit_name(rig.name)}.h"', *_HEAD], ["#include <math.h>", "", '#include "rig.h"', ""]
    header += [f"#define {key} {value}" for key, value in _numbers(rig, python, layout, values, body).items()]
    for key, (kind, items) in _arrays(rig, python, layout).items():
        header.append(f"extern const {kind} {key}[];")
        source.append(f"const {kind} {key}[] = {{{', '.join(items or ['0'])}}};")
    for key, places in forms.items():
        header.append(f"extern const message_form {key};")
        source += _form(key, places)
    every = {node: {"rig": _RIG, **parameters(rig, node), **of_ros()} for node in NODES}
    for node, known in every.items():
        header += _names(node, known)
        source += _parameters(node, known, {"rig": rig.source, "use_sim_time": False, **values[node]})
    others = {item for names in declarations().values() for item in names} - {*every["estimator"], *every["controller"]}
    others |= {*every["estimator"]} ^ {*every["controller"]}
    header += [f"#define OTHER_PARAMETERS {len(others)}", "extern const char *const other_parameters[];"]
    source.append(f"const char *const other_parameters[] = {{{', '.join(map(text, sorted(others)))}}};")
    qualities = topics.qualities()
    header += [f"#define TOPICS {len(qualities)}", *_TOPICS]
    source.append(f"const topic topics[] = {{{', '.join(_topic(*item) for item in qualities.items())}}};")
    header.append("#define LOCKSTEP (controller_parameters[CONTROLLER_LOCKSTEP].number != 0.0)")
    guarded = ["#ifndef RIG_H", "#define RIG_H", "", *header, "", "#endif", ""]
    return {"rig.h": "\n".join(guarded), "rig.c": "\n".join([*source, ""])}


def _numbers(
    rig: Rig, python: PythonLoop, layout: SignalLayout, values: Mapping[str, Mapping[str, Any]], body: str
) -> dict[str, Any]:
    """Macros by name."""
    estimator, labels = python.estimator, python.estimator.labels
    return {
        "STATES": len(layout.states),
        "INPUTS": len(layout.inputs),
        "OUTPUTS": len(layout.outputs),
        "HORIZON": python.mpc.horizon,
        "FOLLOWED": len(estimator.tuning.followed),
        "FURTHER": len(layout.further),
        "PERIOD": number(estimator.period),
        "INTERVAL": number(python.mpc.period),
        "REACH": f"INT64_C({round((estimator.system.delay + values['controller']['latency']) * 1e9)})",
        "GATE": number(estimator.tuning.gate),
        "INNOVATIONS": round(WINDOW * values["estimator"]["rate"]),
        "BEYOND": number(BEYOND),
        "DOUBTS": len(REASONS),
        "LOCKSTEP_DEPTH": 10_000,
        "COVARIANCE_SIZE": len(labels),
        "COVARIANCE_LABEL": text(f"covariance of {', '.join(labels)}"),
        "RIG": text(rig.name),
        "BODY": text(body),
        "NOT_WATCHED_SENSORS": text(UNWATCHED_SENSORS),
        "NOT_WATCHED_LOOP": text(UNWATCHED_LOOP),
        "UNIT(what)": f"{unit_name(rig.name)}_##what",
    }


def _arrays(rig: Rig, python: PythonLoop, layout: SignalLayout) -> dict[str, tuple[str, Sequence[str]]]:
    """Types and items of constant arrays by name."""
    bounds = [
        (item.low - slack, item.high + slack) for item in rig.actuators for slack in [SLACK * (item.high - item.low)]
    ]
    slots = [(place, -BEYOND, BEYOND) for place in layout.outputs]
    slots += [(place, *bound) for place, bound in zip(layout.inputs, bounds, strict=True)]
    system, rates = python.estimator.system, python.guarded.guard.settings.rate
    return {
        "measured_slots": ("slot", [_slot(*item) for item in slots]),
        "further_outputs": ("int", [str(k) for k in layout.further]),
        "followed_names": ("char *const", [text(item) for item in python.estimator.tuning.followed]),
        "tracked": ("bool", [str(int(weight > 0.0)) for weight in python.mpc.problem.output_weights]),
        "rest": ("double", [number(item.rest) for item in rig.actuators]),
        "input_low": ("double", list(map(number, python.limits[0]))),
        "input_high": ("double", list(map(number, python.limits[1]))),
        "input_rate": ("double", list(map(number, rates))),
        "output_names": ("char *const", [text(item.name) for item in system.outputs]),
        "input_names": ("char *const", [text(item.name) for item in system.inputs]),
        "doubt_names": ("char *const", list(map(text, REASONS))),
        "doubts": ("char *const", list(map(text, CAUSES))),
        "reach_low": ("double", list(map(number, rig.reach[0]))),
        "reach_high": ("double", list(map(number, rig.reach[1]))),
    }


_RIG = NodeParameter(name="rig", default="", description="Rig, by its name or by the path of its folder")
_HEAD = ['#include "joints.h"', '#include "parameter.h"', ""]
_TOPICS = [
    "typedef struct {",
    "    const char *name;",
    "    int depth;",
    "    bool reliable, kept;",
    "} topic;",
    "extern const topic topics[];",
]


def text(value: str) -> str:
    """A text in C."""
    return json.dumps(value, ensure_ascii=False)


def number(value: float) -> str:
    """A number in C."""
    value = float(value)
    if math.isnan(value):
        return "(double)NAN"
    if math.isinf(value):
        return "(double)INFINITY" if value > 0 else "-(double)INFINITY"
    return repr(value)


def _slot(place: SignalPlace, low: float, high: float) -> str:
    return f"{{{text(place.entry)}, {FIELDS.index(place.field)}, {number(low)}, {number(high)}}}"


def _form(key: str, places: Iterable[SignalPlace]) -> list[str]:
    places = list(places)
    names = list(dict.fromkeys(place.entry for place in places))
    lists = [int(any(place.field == field for place in places)) for field in FIELDS]
    rows = [f"{{{FIELDS.index(place.field)}, {names.index(place.entry)}}}" for place in places]
    return [
        f"static const char *const {key}_names[] = {{{', '.join(map(text, names))}}};",
        f"static const place {key}_places[] = {{{', '.join(rows)}}};",
        f"const message_form {key} = {{{len(names)}, {key}_names, {{{', '.join(map(str, lists))}}}, {len(places)}, "
        f"{key}_places}};",
    ]


def _topic(name: str, quality: Mapping[str, Any]) -> str:
    reliable, kept = quality["reliability"].name == "RELIABLE", quality["durability"].name == "TRANSIENT_LOCAL"
    return f"{{{text(name)}, {quality['depth']}, {int(reliable)}, {int(kept)}}}"


def _names(node: str, known: Mapping[str, NodeParameter]) -> list[str]:
    words = [f"{node.upper()}_{name.upper()}" for name in known]
    return [
        f"enum {node}_parameter {{ {', '.join(words)}, {node.upper()}_PARAMETERS }};",
        f"extern parameter {node}_parameters[];",
    ]


def _parameters(node: str, known: Mapping[str, NodeParameter], values: Mapping[str, Any]) -> list[str]:
    lists, rows = [], []
    for name, item in known.items():
        value = values[name]
        kind, count, listed = KINDS[item.kind], 0, "0"
        if item.each:
            kind, numbers = "IS_NUMBERS", np.atleast_1d(np.asarray(value, float)).tolist()
            count, listed = len(numbers), f"{node}_{name}_numbers"
            lists.append(f"static const double {listed}[] = {{{', '.join(map(number, numbers))}}};")
        ranged = math.isfinite(item.low) and not item.each and item.kind in (int, float)
        said = [f"each within {item.within}"] if item.each else []
        said += [f"one of {', '.join(item.choices)}"] if item.choices else []
        said += [f"more than {item.above}"] if item.above else []
        said += [] if name in LIVE else ["read at the start"] if name in AT_START else ["a part of the compiled loop"]
        unit = f" [{item.unit}]" if item.unit else ""
        fields = [
            text(name),
            text(f"{item.description}{unit}"),
            text("; ".join(said)),
            kind,
            str(count),
            number(value) if item.kind in (int, float, bool) and not item.each else "0.0",
            text(value if item.kind is str else ""),
            listed,
            *(str(int(flag)) for flag in (ranged, name in LIVE, name in AT_START)),
            number(item.low if ranged else 0.0),
            number(item.high if ranged else 0.0),
            f"{node.upper()}_{item.above.upper()}" if item.above else "-1",
        ]
        rows.append(f"    {{{', '.join(fields)}}},")
    return [*lists, f"parameter {node}_parameters[] = {{", *rows, "};"]
