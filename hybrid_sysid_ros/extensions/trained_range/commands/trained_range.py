"""hybrid-sysid trained-range: what an older model was trained on is noted beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands import options
from hybrid_sysid_ros.commands.records import read_records
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.trained_range.older_models import notes_of
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.model import NOTES, save_notes
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError, counted


def command(
    model: Annotated[Path, typer.Argument(help="Folder of a model that was fitted before these notes were kept.")],
    bag: Annotated[list[Path], typer.Argument(help="The bags that it was fitted to.")],
    signals: options.SignalsFile = None,
    recover: options.Recover = False,
    read_period: options.ReadPeriod = 0.0,
    rig: options.OwnRig = "",
) -> None:
    """Note beside a model which motions it was trained on and how wide its bands are, from its training records.

    The model, its seal and what belongs to it, such as policies, stay as they are.
    """
    found = load_model(model, rig=rig, noted=False)  # those that are there may be damaged
    records = read_records(bag, rig or found.rig, signals, recover, read_period, found.sampling.input, model=None)
    notes = notes_of(found, records, load_rig(rig or found.rig))
    if not notes:
        raise UserError(f"{model}: its training records are too short to tell which motions they have")
    save_notes(model, notes)
    console.print(f"{model / NOTES}: {', '.join(notes)} of {counted(len(found.records), 'record')}")
