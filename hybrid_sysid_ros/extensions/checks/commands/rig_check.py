"""hybrid-sysid rig check: checks of a rig."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.commands.options import Json, RigPlace
from hybrid_sysid_ros.commands.terminal import console, end, print_table
from hybrid_sysid_ros.extensions.checks.findings import MOST_STEPS, check, step_responses
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime import preflight
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.extensions import blaming, loaded, targets

BLOCKS = "▁▂▃▄▅▆▇█"
StepResponses = tuple[Array, Mapping[str, Array]]
SAMPLES = 24
SHOWN = 6
"""Number of values shown of each step response."""


def command(
    rig: RigPlace,
    seconds: Annotated[
        float, typer.Option(help="Length of the step responses [s]; 0: two seconds, or 24 to 20000 steps.", min=0.0)
    ] = 0.0,
    as_json: Json = False,
) -> None:
    """Check a rig's equations, sensors, limits, signals and node parameters, and show its step response."""
    described = load(rig)
    findings = check(described)
    loop = preflight.of_rig(described)
    without = not described.content.get("nodes")
    problems = [*findings.problems, *(() if without else loop), *_sections(described)]
    unread = [name for name in described.content if name not in targets("sections")]
    remarks = [*findings.remarks, *(f"{name}: no extension that reads it is installed" for name in unread)]
    if without and loop:
        remarks.append(preflight.needed_of(loop))
    step = described.step
    shown = seconds or min(max(2.0, SAMPLES * step), MOST_STEPS * step)  # as many steps as are shown, or a moment's
    responses = None if findings.problems else step_responses(described, seconds=shown, samples=SAMPLES)
    if as_json:
        found = {"rig": described.name, "folder": str(described.folder), "problems": problems, "remarks": remarks}
        console.print(json.dumps(found | {"step_responses": _content(described, responses)}, indent=2))
        end(problems)
        return
    print_table(_facts(described))
    for remark in remarks:
        console.print(f"note: {remark}")
    if responses is not None:
        print_table(_responses(described, *responses))
    end(problems)
    console.print(f"{described.name}: no problems")


def _facts(rig: Rig) -> Table:
    """Table of the rig's parts."""
    system = rig.system
    table = Table("what", "name", "unit", "carried as", "", title=f"{rig.name}, {rig.folder}: {type(system).__name__}")
    for item in system.states:
        table.add_row("state", item.name, item.unit, "", "")
    for item, actuator, delay in zip(system.inputs, rig.actuators, system.input_delays, strict=True):
        joint, field = rig.joints.place(item.name)
        limits = f"{actuator.low:g} to {actuator.high:g}{f', {1e3 * delay:g} ms late' if delay else ''}"
        table.add_row("input", item.name, item.unit, f"{field}[{joint}]", limits)
    for item, sensor in zip(system.outputs, rig.sensors, strict=True):
        joint, field = rig.joints.place(item.name)
        read = f"1 {sensor.unit} is {sensor.scale:.6g} {item.unit}" if sensor.scale != 1.0 else ""
        noise = f"noise {sensor.noise:.3g} {sensor.unit} rms" if sensor.noise else ""
        table.add_row("output", item.name, item.unit, f"{field}[{joint}]", ", ".join(filter(None, (read, noise))))
    return table


def _sections(rig: Rig) -> list[str]:
    """What is wrong with the sections of extensions."""
    problems = list[str]()
    for section, target in targets("sections").items():
        if target and section in rig.content:
            with preflight.collected_in_file(problems, rig, section), blaming(target, target):
                loaded(target)(rig)
    return problems


def _content(rig: Rig, responses: StepResponses | None) -> dict[str, Any] | None:
    """Step responses as plain data, None where there are none."""
    if responses is None:
        return None
    times, found = responses
    shown = [f"{item.name} [{display.unit}]" for item, display in zip(rig.system.outputs, rig.display, strict=True)]
    curves = {name: dict(zip(shown, outputs.T.tolist(), strict=True)) for name, outputs in found.items()}
    return {"time [s]": times.tolist(), **curves}


def _responses(rig: Rig, times: Array, found: Mapping[str, Array]) -> Table:
    """Table with a row for each input and output: the curve and a few of its values."""
    chosen = np.linspace(0, SAMPLES - 1, SHOWN).round().astype(int)
    headings = (f"{times[k]:.3g} s" for k in chosen)
    table = Table("step of", "output", "", *headings, title="after a step of each input half way to its upper limit")
    for name, outputs in found.items():
        for column, (item, display) in enumerate(zip(rig.system.outputs, rig.display, strict=True)):
            values = outputs[:, column]
            unit = f"{item.name} [{display.unit}]"
            table.add_row(name, unit, _curve(values), *(f"{values[k]:.4g}" for k in chosen))
    return table


def _curve(values: Array) -> str:
    """A curve as a line of block characters."""
    span = float(np.ptp(values)) or 1.0
    levels = ((values - values.min()) / span * (len(BLOCKS) - 1)).round().astype(int)
    return "".join(BLOCKS[level] for level in levels)
