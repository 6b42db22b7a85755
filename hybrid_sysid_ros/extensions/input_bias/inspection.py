"""The option ``--adapt`` of evaluate: free runs over the rest of records, without and with the input bias of their
first seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Annotated

import typer

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.input_bias.input_bias import Adapted, adapt_model
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.validation.unstable import UnstableError
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.report import FurtherSection, Inspection
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError


def inspection(
    adapt: Annotated[
        float,
        typer.Option(
            "--adapt",
            help="Estimate a constant bias of each input over the first so many seconds, and score the free run over "
            "the rest without and with it; 0: not.",
            min=0.0,
        ),
    ] = 0.0,
) -> partial[Inspection] | None:
    """The inspection, where it is asked for."""
    return partial(_inspected, adapt) if adapt else None


def _inspected(seconds: float, model: Model, records: Sequence[tuple[Record, Part]], rig: Rig) -> Inspection:
    """By record, the free run with a bias from the first seconds. Raises UserError for an unstable model."""
    low, high = rig.limits
    try:
        found = {
            record.name: adapt_model(model, part.of(record, model.sampling), spans=high - low, seconds=seconds)
            for record, part in records
        }
    except UnstableError as error:
        raise UserError(f"{error}: leave out --adapt") from error
    units = [f"{item.name} [{item.unit}]" for item in rig.system.inputs]
    several = len(rig.system.outputs) > 1
    rmse = "RMSE" if several else f"RMSE [{rig.display[0].unit}]"
    headings = ("record", *(["output"] if several else []), *(f"bias of {name}" for name in units), "held")
    section = FurtherSection(
        title=f"Free run after {seconds:g} s, without and with the bias of those {seconds:g} s",
        text="A constant bias of each input, estimated over the first seconds of a record only; then a free run over "
        "the rest of it, from the same state and on the same samples without and with the bias.",
        headings=(*headings, "R2 without", rmse, "R2 with", rmse),
        rows=list(_rows(found, rig, several)),
    )
    content = {name: run.content(model.system) for name, run in found.items()}
    return Inspection(name="adapted", section=section, content=content)


def _rows(found: Mapping[str, Adapted], rig: Rig, several: bool) -> Iterator[list[str]]:
    """A row for each record and output, with errors in the output's display unit."""
    for record, run in found.items():
        bias = [f"{b:.3g} ±{s:.2g}" for b, s in zip(run.estimated, run.deviation, strict=True)]
        held = run.reason or ", ".join(f"{value:.3g}" for value in run.bias)
        for item, shown in zip(rig.system.outputs, rig.display, strict=True):
            cells = [record, *([item.name] if several else []), *bias, held]
            for scores in (run.without, run.adapted):
                own = scores.outputs.get(item.name, scores)
                rmse = f"{float(shown.shown(own.rmse)):.4g}{f' {shown.unit}' if several else ''}"
                cells += [f"{own.r2:.4f}", rmse]
            yield cells
