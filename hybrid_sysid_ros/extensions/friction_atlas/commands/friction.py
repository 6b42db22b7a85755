"""hybrid-sysid friction: the laws of friction, and what each does."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.extensions.friction_atlas import experiments
from hybrid_sysid_ros.extensions.friction_atlas.laws import LAWS, SlidingBlock, law
from hybrid_sysid_ros.extensions.friction_atlas.line_plots import Plot, draw
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file


def command(
    name: Annotated[
        str, typer.Argument(metavar="LAW", help="Name of a friction law; without it the laws are listed.")
    ] = "",
    out: Annotated[Path, typer.Option("--out", help="Folder for the picture, LAW.svg.")] = Path(),
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter, such as static=2.")
    ] = None,
) -> None:
    """Draw a law of friction over speed, before sliding, at break-away and in stick-slip; without a law, list them."""
    if not name:
        table = Table("law", "friction", "parameters", title="laws of friction")
        for key, known in LAWS.items():
            table.add_row(key, " ".join((known.__doc__ or "").split()), ", ".join(_own(known)))
        print_table(table)
        return
    chosen, picture = law(name, _values(settings or [])), out / f"{name}.svg"
    check_file(picture)
    table = Table("parameter", "value", "unit", "from", "to", "", title=" ".join((chosen.__doc__ or "").split()))
    for item in chosen.parameters:
        if item.name in _own(chosen):
            bounds = (f"{item.low:g}", f"{item.high:g}")
            table.add_row(item.name, f"{chosen.named[item.name]:g}", item.unit, *bounds, item.description)
    print_table(table)
    console.print(f"source: {chosen.source}")
    console.print(str(draw(picture, plots(chosen), title=f"friction law {name}")))


def plots(system: SlidingBlock) -> list[Plot]:
    """The four plots of a law."""
    curve, loop = experiments.friction_over_speed(system), experiments.pre_sliding(system)
    away, (block, end) = experiments.break_away(system), experiments.stick_slip(system)
    return [
        Plot(title="steady friction", across="speed [m/s]", up="friction [N]", lines=[(curve.x, curve.y)]),
        Plot(title="before sliding", across="place [m]", up="friction [N]", lines=[(loop.x, loop.y)]),
        Plot(
            title="break-away after a stop",
            across="rate of the force [N/s]",
            up="force [N]",
            lines=[(away.x, away.y)],
            logarithmic=True,
        ),
        Plot(
            title="stick-slip (grey: the spring's end)",
            across="time [s]",
            up="place [m]",
            lines=[(block.x, block.y), (end.x, end.y)],
        ),
    ]


def _own(system: SlidingBlock) -> list[str]:
    """The parameters that a user may set."""
    return [item.name for item in system.parameters if item.name not in ("spring", "damper")]


def _values(settings: list[str]) -> dict[str, float]:
    values, given = {}, [text.partition("=")[0].strip() for text in settings]
    for text in settings:
        key, equals, number = text.partition("=")
        try:
            values[key.strip()] = float(number)
        except ValueError:
            equals = ""
        if not equals:
            raise UserError(f"--set {text!r}: write NAME=VALUE, such as static=2")
        if given.count(key.strip()) > 1:
            raise UserError(f"--set {key.strip()} is given {given.count(key.strip())} times: give one value")
    return values
