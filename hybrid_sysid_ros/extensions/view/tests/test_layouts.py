"""Layouts for other tools: what they name is what the nodes send."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.view import layouts
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, Slots
from hybrid_sysid_ros.rigs.folder import names
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.parameters import defaults

NAMES = tuple(names())


def names_of(name: str) -> dict[str, list[str]]:
    """Names of the entries of messages, as the nodes write them."""
    rig = load(name)
    layout = SignalLayout(rig, rig.system)
    tracked = [k for k, weight in enumerate(defaults(rig, "controller")["output_weight"]) if weight > 0.0]
    return {
        "joint_states": Slots([*layout.outputs, *layout.inputs]).names,
        "state_estimate": Slots(layout.estimate(())).names,
        "joint_command": Slots(layout.inputs).names,
        "reference": Slots([layout.outputs[k] for k in tracked]).names,
    }


@pytest.mark.parametrize("name", NAMES)
def test_a_path_of_foxglove_names_the_entry_that_carries_the_output(name: str) -> None:
    rig, names = load(name), names_of(name)
    content = json.loads(layouts.foxglove(rig))
    shown = {panel.removeprefix("Plot!"): entry for panel, entry in content["configById"].items() if "paths" in entry}
    assert list(shown) == [item.name for item in (*rig.system.outputs, *rig.system.inputs)]
    for variable, entry in shown.items():
        joint, field = rig.joints.place(variable)
        for path in entry["paths"]:
            topic, found, index = re.fullmatch(
                rf"/{rig.namespace}/(\w+)\.(?:points\[0\]\.)?(\w+)\[(\d+)\]", path["value"]
            ).groups()  # type: ignore[union-attr]
            assert names[topic][int(index)] == joint
            assert found[:6] == field[:6]
    panels: list[str] = []

    def collect(part: Any) -> None:
        if isinstance(part, str):
            panels.append(part)
        else:
            collect(part["first"])
            collect(part["second"])

    collect(content["layout"])
    assert sorted(panels) == sorted(content["configById"])


@pytest.mark.parametrize("name", NAMES)
def test_a_curve_of_plotjuggler_is_a_series_of_a_joint(name: str) -> None:
    rig, names = load(name), names_of(name)
    root = ElementTree.fromstring(layouts.plotjuggler(rig))
    curves = [curve.get("name", "") for curve in root.iter("curve")]
    assert len(curves) >= 2 * (len(rig.system.outputs) + len(rig.system.inputs))
    for curve in curves:
        topic, *rest = curve.removeprefix(f"/{rig.namespace}/").split("/")
        assert topic in names
        if topic != "reference":
            assert rest[0] in names[topic]
            assert rest[1] in ("position", "velocity", "effort")


def test_the_command_writes_three_files(call: Any, tmp_path: Path) -> None:
    status, out, err = call(app.main, "hybrid-sysid", "rig", "layouts", "wheel_motor", tmp_path / "new")
    assert (status, err) == (0, "")
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        "wheel_motor.foxglove.json",
        "wheel_motor.plotjuggler.xml",
        "wheel_motor.urdf",
    ]
    assert out.count("\n") == 3
