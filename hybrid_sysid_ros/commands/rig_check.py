"""hybrid-sysid rig check: whether a rig makes sense."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from hybrid_sysid_ros.commands.terminal import RigPlace, console, end, print_table
from hybrid_sysid_ros.rigs.check import check, step_responses
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.parameters import declarations, defaults
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extensions import blaming, loaded, targets

BLOCKS = "▁▂▃▄▅▆▇█"
SAMPLES = 24
SHOWN = 6
"""Numbers of each step response."""


def command(
    rig: RigPlace,
    seconds: Annotated[float, typer.Option(help="Length of the step responses [s].", min=1e-3)] = 2.0,
) -> None:
    """Check a rig's equations, sensors, limits, signals and node parameters, and show its step response."""
    described = load(rig)
    print_table(_facts(described))
    findings = check(described)
    problems = [*findings.problems, *_values(described)]
    unread = [name for name in described.content if name not in targets("sections")]
    for remark in (*findings.remarks, *(f"{name}: no extension that reads it is installed" for name in unread)):
        console.print(f"note: {remark}")
    if not findings.problems:
        print_table(_responses(described, seconds))
    end(problems)
    console.print(f"{described.name}: no problems")


def _facts(rig: Rig) -> Table:
    """What the rig consists of."""
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


def _values(rig: Rig) -> Iterator[str]:
    """What is wrong with the values of nodes, of the controller's problem, and of the policy's sections."""
    try:
        for node in declarations():
            defaults(rig, node)
    except UserError as error:
        yield str(error)
        return
    controller, reference, estimator, plant = (
        defaults(rig, node) for node in ("controller", "reference", "estimator", "plant")
    )
    needed = controller["horizon"] * controller["period"] + controller["latency"] + rig.system.delay
    if reference["preview_seconds"] < needed + reference["publish_period"]:
        yield (
            f"{rig.file}: nodes.reference.preview_seconds is {reference['preview_seconds']:g} s: the controller's "
            f"horizon, the delays and a publish period take {needed + reference['publish_period']:g} s"
        )
    made: list[tuple[str, Callable[[], Any]]] = [
        ("nodes.plant.rate", lambda: rig.steps(1.0 / plant["rate"], f"the period of {plant['rate']:g} Hz")),
        ("nodes.controller.period", lambda: rig.steps(controller["period"], "the period")),
        ("nodes", lambda: configuration.mpc_problem(controller, rig)),
        ("nodes", lambda: configuration.estimator_tuning(estimator, rig)),
        ("policy_training", lambda: configuration.spread_of(rig)),
        ("demo", lambda: _demo(rig)),
        *((name, partial(_of_extension, target, rig)) for name, target in targets("sections").items() if target),
    ]
    for section, make in made:
        try:
            _ = make() if section.startswith("nodes") or section in rig.content else None
        except UserError as error:
            text = str(error)
            yield text if text.startswith(str(rig.file)) else f"{rig.file}: {section}: {text}"


def _of_extension(target: str, rig: Rig) -> None:
    """Let an extension look at its section."""
    with blaming(target, target):
        loaded(target)(rig)


def _demo(rig: Rig) -> None:
    from hybrid_sysid_ros.runtime.demo_recipe import DemoRecipe  # takes a second

    DemoRecipe.of(rig).places(rig)


def _responses(rig: Rig, seconds: float) -> Table:
    """A row for each input and output: the curve and a few of its numbers."""
    times, found = step_responses(rig, seconds=seconds, samples=SAMPLES)
    chosen = np.linspace(0, SAMPLES - 1, SHOWN).round().astype(int)
    headings = (f"{times[k]:.3g} s" for k in chosen)
    table = Table("step of", "output", "", *headings, title="after a step of each input half way to its upper limit")
    for name, outputs in found.items():
        for column, (item, display) in enumerate(zip(rig.system.outputs, rig.display, strict=True)):
            values = outputs[:, column]
            unit = f"{item.name} [{display.unit}]"
            table.add_row(name, unit, _curve(values), *(f"{values[k]:.4g}" for k in chosen))
    return table


def _curve(values: NDArray[np.float64]) -> str:
    """A line of blocks."""
    span = float(np.ptp(values)) or 1.0
    levels = ((values - values.min()) / span * (len(BLOCKS) - 1)).round().astype(int)
    return "".join(BLOCKS[level] for level in levels)
