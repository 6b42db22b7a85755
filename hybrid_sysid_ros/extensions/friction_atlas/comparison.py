"""The option ``--beside`` of identify: friction over speed of the model and of another one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.friction_atlas.friction_curve import friction_curve, speeds_of, velocity_of
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Model, load
from hybrid_sysid_ros.report import FurtherSection, Inspection
from hybrid_sysid_ros.rigs.rig import Rig

SHOWN = 10  # speeds


def comparison(
    out: Path,
    rig: str = "",
    beside: Annotated[
        Path | None,
        typer.Option(help="Another model of the rig whose friction over speed is shown for comparison."),
    ] = None,
    report: Path | None = None,
) -> partial[Inspection] | None:
    """The comparison, where it is asked for. Raises UserError for a model whose friction has no one curve."""
    if beside is None:
        return None
    other = load(beside, rig=rig)
    speeds_of(other)
    return partial(_compared, str(out), str(beside), other, report is not None)


def _compared(
    name: str, beside: str, other: Model, drawn: bool, model: Model, records: Sequence[tuple[Record, Part]], rig: Rig
) -> Inspection:
    """Friction over speed of two models, and its difference."""
    speeds, item = speeds_of(other), rig.system.inputs[0]
    curves = {called: friction_curve(each.system, speeds) for called, each in ((name, model), (beside, other))}
    one, another = curves.values()
    rows = [
        [f"{speeds[k]:.3g}", *(f"{curve.inputs[k]:.4f}" for curve in curves.values())]
        for k in range(0, len(speeds), len(speeds) // SHOWN)
    ]
    velocity, figures = model.system.states[velocity_of(model.system)], []
    if drawn:
        from hybrid_sysid_ros.extensions.friction_atlas.report.figures import friction

        figures = [friction(curves, velocity, item)]
    section = FurtherSection(
        title=f"Friction over speed, in units of {item.name} [{item.unit}]",
        text="Friction as the input that it takes: half of what lies between the inputs that keep a speed and its "
        "opposite.",
        headings=(f"{velocity.name} [{velocity.unit}]", *curves),
        rows=[*rows, ["difference, rms", "", f"{one.difference(another):.2%}"]],
        figures=figures,
    )
    return Inspection(name="friction", section=section)
