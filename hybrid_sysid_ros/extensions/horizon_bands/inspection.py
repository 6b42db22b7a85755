"""The option ``--ahead`` of evaluate: errors over the horizon, and what bands hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import typer

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.horizon_bands.horizon_bands import HorizonBands, horizon_bands
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.report import FurtherSection, Inspection
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

ROWS = 6
"""Horizons of the table."""


def inspection(
    ahead: Annotated[
        bool,
        typer.Option("--ahead", help="Say how far predictions some samples ahead are off, and what their bands hold."),
    ] = False,
) -> Any:
    """The inspection, where it is asked for."""
    return _inspected if ahead else None


def _inspected(model: Model, records: Sequence[tuple[Record, Part]], rig: Rig) -> Inspection:
    """By record, errors and bands over the horizon. Raises UserError for a model without bands."""
    found = dict[str, HorizonBands]()
    for record, part in records:
        bands = horizon_bands(model, experiment_of(model, record, part=part))
        if bands is None:
            raise UserError(
                f"--ahead: the model of {model.rig} has no bands over the horizon: an older model gets them by "
                "hybrid-sysid trained-range; unstable rigs and state spaces have none"
            )
        found[record.name] = bands
    section = FurtherSection(
        title="Predictions from measured states, by time ahead",
        text="90 % of the errors, and half of the width of the bands that are known before. Bands come from errors of "
        "training records that were left out of the fit.",
        headings=("record", "output", "ahead", "90 % of errors", "90 % band", "it holds", "50 % band", "it holds"),
        rows=list(_rows(found, rig)),
        figures=_figures(found, rig),
    )
    content = {name: bands.content(model.system) for name, bands in found.items()}
    return Inspection(name="horizon_bands", section=section, content=content)


def _rows(found: Mapping[str, HorizonBands], rig: Rig) -> Iterator[list[str]]:
    """A row for each record, output and some horizons, in the output's display unit."""
    for name, bands in found.items():
        held = bands.held
        for k, (item, display) in enumerate(zip(rig.system.outputs, rig.display, strict=True)):
            for h in np.unique(np.linspace(0, len(bands.seconds) - 1, ROWS).round().astype(int)):
                sizes = [float(np.quantile(np.abs(bands.errors[:, h, k]), 0.9))]
                sizes += [float(bands.halves[level][h, k]) for level in (0.9, 0.5)]
                error, wide, half = (f"{float(display.shown(size)):.3g} {display.unit}" for size in sizes)
                most, some = (f"{held[level][h, k]:.0%}" for level in (0.9, 0.5))
                yield [name, item.name, f"{bands.seconds[h]:.3g} s", error, f"± {wide}", most, f"± {half}", some]


def _figures(found: Mapping[str, HorizonBands], rig: Rig) -> list[Any]:
    """Of each record, errors and bands over the horizon; none without the libraries of reports."""
    try:
        from hybrid_sysid_ros.extensions.horizon_bands.report.figures import over_horizon
    except ModuleNotFoundError:
        return []
    return [over_horizon(bands, rig) for bands in found.values()]
