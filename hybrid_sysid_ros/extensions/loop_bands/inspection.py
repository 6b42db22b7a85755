"""The option ``--loop`` of evaluate: loops that are forecast from their commands, with bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.loop_bands.loop_bands import LoopBands, loop_bands
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.report import FurtherSection, Inspection
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError


def inspection(
    loop: Annotated[
        bool,
        typer.Option("--loop", help="Say what the bands of the closed loop hold that is done again."),
    ] = False,
) -> Any:
    """The inspection, where it is asked for."""
    return _inspected if loop else None


def _inspected(model: Model, records: Sequence[tuple[Record, Part]], rig: Rig) -> Inspection:
    """By record, the forecast loop and its bands. Raises UserError for a model without bands, and where no record has
    a loop that can be done again.
    """
    found, reasons = dict[str, LoopBands](), list[str]()
    for record, part in records:
        try:
            bands = loop_bands(model, record, rig, part=part)
        except UserError as error:
            reasons.append(str(error))
            continue
        if bands is None:
            raise UserError(
                f"--loop: the model of {model.rig} has no bands of its loop: an older model gets them by "
                "hybrid-sysid trained-range; rigs of several outputs, unstable rigs and state spaces have none"
            )
        found[record.name] = bands
    if not found:
        raise UserError(f"--loop: {reasons[0]}")
    section = FurtherSection(
        title="Closed loops, forecast from their commands",
        text="Bands are known before the measurement: errors like those of training records that were left out of the "
        "fit go round the loop.",
        headings=("record", "output", "90 % band", "it holds", "50 % band", "it holds"),
        rows=[_row(name, bands, rig) for name, bands in found.items()],
        figures=_figures(found, rig),
    )
    return Inspection(
        name="loop_bands", section=section, content={name: bands.content for name, bands in found.items()}
    )


def _row(name: str, bands: LoopBands, rig: Rig) -> list[str]:
    """A record's widths, in the output's display unit, and shares."""
    cells, display = [name, rig.system.outputs[0].name], rig.display[0]
    for level in (0.9, 0.5):
        half = float(display.shown(float(bands.halves[level].mean())))
        cells += [f"± {half:.3g} {display.unit}", f"{bands.held[level]:.0%}"]
    return cells


def _figures(found: Mapping[str, LoopBands], rig: Rig) -> list[Any]:
    """Of each record, forecast and bands over time; none without the libraries of reports."""
    try:
        from hybrid_sysid_ros.extensions.loop_bands.report.figures import over_time
    except ModuleNotFoundError:
        return []
    return [over_time(bands, rig) for bands in found.values()]
