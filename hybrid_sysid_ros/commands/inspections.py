"""Inspections: what extensions find of a model over records, by options that they add to a command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from rich.table import Table

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.report import Inspection
from hybrid_sysid_ros.rigs.rig import Rig

Inspect: TypeAlias = Callable[[Model, Sequence[tuple[Record, Part]], Rig], Inspection | None]
"""Finds something of a model over parts of records; None where there is nothing to find."""


def inspected(
    inspections: Sequence[Inspect], model: Model, records: Sequence[tuple[Record, Part]], rig: Rig
) -> list[Inspection]:
    """What extensions find of a model."""
    return [found for inspect in inspections if (found := inspect(model, records, rig)) is not None]


def print_inspections(found: Sequence[Inspection]) -> None:
    """Print the tables of what extensions found."""
    for item in found:
        table = Table(*item.section.headings, title=item.section.title)
        for row in item.section.rows:
            table.add_row(*map(str, row))
        print_table(table)
