"""hybrid-sysid promote: a model takes the place of the one in use, if it is better."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands import options
from hybrid_sysid_ros.commands.records import read_records
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.promotion.model_gain import FEWEST, LEVEL, ModelGain, gain_of
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.support.errors import UserError, counted
from hybrid_sysid_ros.support.files import written_folder


def command(
    model: Annotated[Path, typer.Argument(help="Folder of the model that is to be used.")],
    bag: Annotated[list[Path], typer.Argument(help="Bags that neither model was trained on.")],
    in_use: Annotated[Path, typer.Option("--in-use", help="Folder of the model in use, which is replaced.")],
    part: options.PartText = "0:1",
    as_json: options.Json = False,
    signals: options.SignalsFile = None,
    recover: options.Recover = False,
    read_period: options.ReadPeriod = 0.0,
    rig: options.OwnRig = "",
) -> None:
    """Put a model into use if its free runs over records that neither model has seen are better than those of the one
    in use, by more than their uncertainty. Its folder then holds a copy, and nodes use it when they start again.
    """
    new, old = load_model(model, rig=rig), load_model(in_use, rig=rig)
    records = read_records(bag, new.rig, signals, recover, read_period, new.sampling.input, model=new)
    found = gain_of(new, old, records, Part.parse(part))
    if not found.is_better:
        raise UserError(f"{in_use} stays in use: {_why(found)}")
    with written_folder(in_use, marker="model.yaml") as partial:
        shutil.copytree(model, partial, dirs_exist_ok=True)
        load_model(partial, rig=rig)
    if as_json:
        console.print_json(json.dumps({"gain": found.gain, "needed": found.needed, "independent": found.independent}))
    else:
        console.print(
            f"{in_use}: now the model of {model}, whose R2 over {counted(len(records), 'record')} is higher "
            f"by {found.gain:.3g} (more than {found.needed:.2g} is certain at {LEVEL:.0%}); train policies for it anew"
        )


def _why(found: ModelGain) -> str:
    """Why the new model is not better."""
    if found.independent < FEWEST:
        return (
            f"the records have {found.independent:.1f} independent errors only, where {FEWEST:g} are needed: give "
            "longer ones, or more"
        )
    if found.gain <= 0.0:
        return "the new model is no better" + (f": its R2 is lower by {-found.gain:.3g}" if found.gain else "")
    return f"the new model's R2 is higher by {found.gain:.3g} only, where {found.needed:.2g} would be certain"
