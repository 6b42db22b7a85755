"""hybrid-sysid design: the next experiment, and what one has shown."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands import options
from hybrid_sysid_ros.commands.terminal import console, print_table, status
from hybrid_sysid_ros.extensions.experiment_design.design import Design, designed
from hybrid_sysid_ros.extensions.experiment_design.gain import InformationGain, gained
from hybrid_sysid_ros.extensions.experiment_design.plan_folder import SHEET, SIGNALS, content, save_plan
from hybrid_sysid_ros.library.records import checked_bag
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import defaults
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder
from hybrid_sysid_ros.support.progress import progress_bars

LEARNED = 0.9
"""Share of a deviation below which an experiment has taught something."""
FAR = 3.0
"""Deviations beyond which a parameter of the record is another one than the model's."""


def command(
    model: options.ModelFolder,
    rig: options.RigName = "",
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the experiment.")] = None,
    seconds: Annotated[float, typer.Option(help="Length of the experiment [s].", min=1.0, max=3600.0)] = 60.0,
    parameters: Annotated[
        str, typer.Option(help="Parameters to learn more of, separated by commas; all that were fitted by default.")
    ] = "",
    amplitude: Annotated[
        float, typer.Option(help="Share of the limits of inputs and references that is used.", min=0.01, max=1.0)
    ] = 0.9,
    rate: Annotated[
        float | None, typer.Option(help="Samples of the drive per second [Hz]; the rate of the rig's loop by default.")
    ] = None,
    visit: Annotated[
        list[Path] | None,
        typer.Option(help="Bag that the model is from, may be repeated: go where these have not been, instead."),
    ] = None,
    seed: options.Seed = 0,
    done: Annotated[
        Path | None, typer.Option(help="Bag of an experiment that was done: say what it has shown.")
    ] = None,
    signals: options.SignalsFile = None,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Design the experiment that tells most of what a model does not know yet, or say what a record has shown."""
    if out is not None:
        check_folder(out, marker=SHEET, replace=overwrite)
    known = load_model(model, rig=rig)
    described = load_rig(rig or known.rig)

    def read(path: Path) -> Record:
        return checked_bag(path, described, signals=signals, period=0.0, recover=False, doubtful=status.print)

    if done is not None:
        if out is not None:
            raise UserError("--done says what a record has shown, and designs nothing: leave --out out")
        _show_gain(gained(known, described, read(done)), as_json)
        return
    most = 1.0 / known.sampling.step
    hertz = min(float(defaults(described, "plant")["rate"]), most) if rate is None else rate
    if not 0.0 < hertz <= most * (1.0 + 1e-9):
        raise UserError(
            f"--rate {hertz:g} Hz: give more than 0 and at most {most:g}, since the model's step is no shorter"
        )
    names = [name.strip() for name in parameters.split(",") if name.strip()]
    with progress_bars(status) as update:
        found = designed(
            known, described, seconds=seconds, period=1.0 / hertz, amplitude=amplitude, parameters=names, seed=seed,
            records=[read(path) for path in visit or ()],
            progress=lambda count, most: update("trials", count, most),
        )  # fmt: skip
    if out is not None:
        save_plan(out, found)
    if as_json:
        console.print_json(json.dumps(content(found)))
    else:
        _show(found, names)
    tell = status if as_json else console
    if out is not None:
        tell.print(f"{out}: play it by hybrid-sysid simulate {out / SIGNALS}, or run --reference {out / SIGNALS}")


def _show(found: Design, wanted: Sequence[str]) -> None:
    units = {item.name: item.unit for item in found.bench.model.system.parameters}
    table = Table("parameter", "deviation now", "expected after", "unit", title="what the experiment will tell")
    for name, now, then in zip(found.names, found.before.tolist(), found.after.tolist(), strict=True):
        if name in units and (not wanted or name in wanted):
            table.add_row(name, f"{now:.2g}", f"{then:.2g}", units[name])
    print_table(table)
    asked = [name in units and (not wanted or name in wanted) for name in found.names]
    if found.visits is None and not np.any((found.after < LEARNED * found.before)[asked]):
        console.print("this experiment hardly teaches anything that the model does not know: ask for a longer one")
    if found.visits is not None:
        visited, new, total = found.visits
        console.print(f"cells of states and inputs: the bags have visited {visited} of {total}, this adds {new}")
    for (low, high), item, shown, values in zip(
        found.bench.rig.reach.T, found.bench.rig.system.outputs, found.bench.rig.display, found.outputs.T, strict=True
    ):
        least, most = shown.shown([values.min(), values.max()]).tolist()
        ends = f", of {shown.shown(low):.4g} to {shown.shown(high):.4g}" if np.isfinite([low, high]).all() else ""
        console.print(f"{item.name}: {least:.4g} to {most:.4g} {shown.unit} by the model{ends}")
    console.print(
        f"within limits in all of {len(found.bench.systems)} simulations: the model, and others that its records "
        "leave open"
    )


def _show_gain(found: InformationGain, as_json: bool) -> None:
    rows = [
        dict(zip(("parameter", "before", "expected", "after", "value", "found", "moved"), row, strict=True))
        for row in zip(
            found.names, *_lists(found.before, found.expected, found.after, found.values, found.found, found.moved),
            strict=True,
        )
        if not row[0].startswith("weight_")
    ]  # fmt: skip
    if as_json:
        console.print_json(json.dumps(rows))
        return
    table = Table("parameter", "deviation before", "expected", "reached", "value of the model", "of the record")
    for row in rows:
        numbers = (f"{row[key]:.2g}" for key in ("before", "expected", "after"))
        table.add_row(row["parameter"], *numbers, f"{row['value']:.4g}", f"{row['found']:.4g}")
    print_table(table)
    for row in rows:
        if row["moved"] > FAR:
            console.print(
                f"{row['parameter']} of the record is {row['moved']:.1f} deviations from that of the model: the law "
                "or the rig is not the same in both"
            )


def _lists(*values: Array) -> list[list[float]]:
    return [[float(value) for value in item] for item in values]
