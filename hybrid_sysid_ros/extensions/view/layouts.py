"""Layouts: a rig's names as files for other people's tools: Foxglove or Lichtblick, and PlotJuggler."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults

COLOURS = ("#9aa5b8", "#1f6fd6", "#d9730d", "#0f8f63")  # measured, estimated, asked for, planned
SHOWN = ("joint_states", "state_estimate")
"""Topics that carry an output."""
PLURAL = {"position": "positions", "velocity": "velocities"}
"""Fields of a trajectory's points."""


def foxglove(rig: Rig) -> str:
    """A layout of Foxglove and Lichtblick, JSON: plots of each output and input, diagnostics, and the rig in 3D by the
    URDF on the topic robot_description. Entries go by their place in the messages that this package sends.
    """
    panels: dict[str, Any] = {}
    plots = []
    for name, curves in _plots(rig).items():
        plots.append(f"Plot!{name}")
        panels[plots[-1]] = {
            "title": name,
            "paths": [
                {"value": path, "enabled": True, "timestampMethod": "headerStamp", "color": colour, "label": label}
                for path, colour, label in curves
            ],
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "showLegend": True,
            "legendDisplay": "floating",
            "isSynced": True,
            "xAxisVal": "timestamp",
            "followingViewWidth": 10,
        }
    panels["DiagnosticSummary!all"] = {
        "minLevel": 0,
        "pinnedIds": [],
        "hardwareIdFilter": rig.name,
        "topicToRender": "/diagnostics",
        "sortByLevel": True,
    }
    panels["3D!rig"] = {
        "followTf": "base",
        "layers": {},
        "topics": {f"/{rig.namespace}/robot_description": {"visible": True}},
        "cameraState": {"distance": 2.0, "phi": 90.0, "thetaOffset": 0.0, "perspective": True, "target": [0, 0, 0]},
    }
    side = {"first": "3D!rig", "second": "DiagnosticSummary!all", "direction": "column", "splitPercentage": 50}
    layout = {"first": _split(plots), "second": side, "direction": "row", "splitPercentage": 70}
    content = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(content, indent=2) + "\n"


def _split(panels: Sequence[str]) -> Any:
    """Panels one below the other."""
    if len(panels) == 1:
        return panels[0]
    share = 100 / len(panels)
    return {"first": panels[0], "second": _split(panels[1:]), "direction": "column", "splitPercentage": share}


def _plots(rig: Rig) -> Mapping[str, Sequence[tuple[str, str, str]]]:
    """By title: path, colour and name of each curve."""
    names = _names(rig)
    found = {}
    for item in rig.system.outputs:
        joint, field = rig.joints.place(item.name)
        found[item.name] = [
            (f"/{rig.namespace}/joint_states.{field}[{names['joint_states'].index(joint)}]", COLOURS[0], "measured"),
            (
                f"/{rig.namespace}/state_estimate.{field}[{names['state_estimate'].index(joint)}]",
                COLOURS[1],
                "estimate",
            ),
        ]
        if joint in names["reference"]:
            index = names["reference"].index(joint)
            path = f"/{rig.namespace}/reference.points[0].{PLURAL[field]}[{index}]"
            found[item.name].append((path, COLOURS[2], "reference"))
    for item in rig.system.inputs:
        joint, field = rig.joints.place(item.name)
        found[item.name] = [
            (f"/{rig.namespace}/joint_states.{field}[{names['joint_states'].index(joint)}]", COLOURS[0], "applied"),
            (f"/{rig.namespace}/joint_command.{field}[{names['joint_command'].index(joint)}]", COLOURS[1], "command"),
        ]
    return found


def plotjuggler(rig: Rig) -> str:
    """A layout of PlotJuggler, XML: a plot for each output and input, of the series of its joint by their names."""
    root = ElementTree.Element("root")
    tabs = ElementTree.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    tab = ElementTree.SubElement(tabs, "Tab", tab_name=rig.name, containers="1")
    plots = _series(rig)
    sizes = ";".join([f"{1 / len(plots):.6g}"] * len(plots))
    container = ElementTree.SubElement(tab, "Container")
    splitter = ElementTree.SubElement(container, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes)
    for name, curves in plots.items():
        area = ElementTree.SubElement(splitter, "DockArea", name=name)
        plot = ElementTree.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        for curve, colour in curves:
            ElementTree.SubElement(plot, "curve", name=curve, color=colour)
    ElementTree.SubElement(tabs, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ElementTree.tostring(root, encoding="unicode") + "\n"


def _series(rig: Rig) -> Mapping[str, Sequence[tuple[str, str]]]:
    """By title: PlotJuggler's name of each series, and its colour."""
    names, space = _names(rig), f"/{rig.namespace}"
    found = {}
    for item in rig.system.outputs:
        joint, field = rig.joints.place(item.name)
        found[item.name] = [(f"{space}/{topic}/{joint}/{field}", COLOURS[k]) for k, topic in enumerate(SHOWN)]
        if joint in names["reference"]:
            path = f"{space}/reference/points[0]/{PLURAL[field]}[{names['reference'].index(joint)}]"
            found[item.name].append((path, COLOURS[2]))
    for item in rig.system.inputs:
        joint, field = rig.joints.place(item.name)
        topics = ("joint_states", "joint_command")
        found[item.name] = [(f"{space}/{topic}/{joint}/{field}", COLOURS[k]) for k, topic in enumerate(topics)]
    return found


def _names(rig: Rig) -> dict[str, list[str]]:
    """Names of the entries of each topic's messages, in their order."""
    system = rig.system
    outputs, inputs = ([rig.joints.place(item.name)[0] for item in items] for items in (system.outputs, system.inputs))
    carried = {
        getattr(joint, field): name for name, joint in rig.joints.joints.items() for field in ("position", "velocity")
    }
    states = [carried.get(item.name, item.name) for item in system.states]
    weights = defaults(rig, "controller")["output_weight"]
    tracked = [joint for joint, weight in zip(outputs, weights, strict=True) if weight > 0.0]
    found = {
        "joint_states": [*outputs, *inputs],
        "state_estimate": [*states, *outputs, *inputs],
        "joint_command": inputs,
        "reference": tracked,
    }
    return {topic: list(dict.fromkeys(entries)) for topic, entries in found.items()}
