"""hybrid-sysid accuracy: systematic error and dispersion from simulated and live shots."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hybrid_sysid_ros.commands.options import Json, Seed
from hybrid_sysid_ros.commands.terminal import console, print_table, status, typed
from hybrid_sysid_ros.extensions.accuracy.report.accuracy_page import accuracy_rows, write_accuracy
from hybrid_sysid_ros.extensions.accuracy.statistics import (
    Accuracy,
    AccuracyEstimate,
    Bounded,
    Discrepancy,
    Shots,
    Strata,
    assess,
    mean_width,
    read_shots,
    shots_until,
    spread_width,
)
from hybrid_sysid_ros.extensions.accuracy.statistics.sequential import ASSURANCE, Width
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file, sha256

COLUMNS = ["share", "success"]
STRATA_SHOTS = 100


def command(
    simulated: Annotated[Path, typer.Argument(help="Simulated shots: CSV, NPZ or JSON; coordinates are NAME [UNIT].")],
    live: Annotated[Path, typer.Argument(help="Live shots of the same coordinates.")],
    mean_off: Annotated[
        float, typer.Option(help="Declared: the simulated mean is off by so many standard deviations (one sigma).")
    ],
    spread_off: Annotated[
        float, typer.Option(help="Declared: the simulated spread is off by a factor of e to this (one sigma).")
    ],
    level: Annotated[float, typer.Option(help="Probability of the intervals.")] = 0.9,
    until: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=WIDTH", help="Predict the number of further shots until the interval of a mean has a width."
        ),
    ] = None,
    spread_until: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=WIDTH", help="Predict the number of further shots until the interval of a spread has a width."
        ),
    ] = None,
    strata: Annotated[
        Path | None,
        typer.Option(
            help="CSV with the columns share and success: the share of each condition, and the expected success in it."
        ),
    ] = None,
    strata_shots: Annotated[
        int | None,
        typer.Option(
            help=f"Number of live shots to distribute over the conditions; {STRATA_SHOTS} by default.", min=1, max=10**6
        ),
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of coordinates whose heading states none.")] = "",
    page: Annotated[Path | None, typer.Option("--report", help="Write a page with plots (.html).")] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Tell the accuracy from simulated and live shots, by what is declared of the simulation beforehand."""
    discrepancy = Discrepancy(mean=mean_off, spread=spread_off)
    if page is not None:
        check_file(page, suffix=".html")
        report.check_available()
    if strata is None and strata_shots is not None:
        raise UserError("--strata-shots shares shots out among strata: name their file by --strata, or leave it out")
    found = assess(read_shots(simulated, unit=unit), read_shots(live, unit=unit), discrepancy, level=level, seed=seed)
    wanted = [
        *_further("mean", mean_width, until or [], found),
        *_further("spread", spread_width, spread_until or [], found),
    ]
    conditions = _strata(strata) if strata is not None else None
    content = _content(found, wanted, conditions, strata_shots or STRATA_SHOTS)
    if page is not None:
        hashes = {"simulated shots": sha256(simulated), "live shots": sha256(live)}
        source = report.Provenance(command=typed(), hashes=hashes)
        write_accuracy(page, found, source, [*_remarks(found, content)])
    if as_json:
        console.print_json(json.dumps(content))
    else:
        _show(found, content)
        if page is not None:
            console.print(f"report: {page}")
    for doubt in found.doubts:
        status.print(f"warning: {doubt}")
    if found.contradictions:
        status.print(f"warning: {', and '.join(found.contradictions)}: {found.cure}")


def _further(interval: str, width: Width, texts: list[str], found: Accuracy) -> Iterator[dict[str, Any]]:
    """How many more shots each NAME=WIDTH takes."""
    for text in texts:
        name, k, wanted = _wanted(text, found.live)
        shots = shots_until(width, found.joint.posterior, k, wanted, found.level)
        yield {"interval": interval, "of": name, "width": wanted, "shots": shots}


def _wanted(text: str, shots: Shots) -> tuple[str, int, float]:
    """Name, index and width of NAME=WIDTH. Raises UserError for anything else."""
    name, _, value = text.partition("=")
    try:
        width = float(value)
    except ValueError:
        width = math.nan
    if name not in shots.names or not 0.0 < width < math.inf:
        raise UserError(
            f"{text!r} is no NAME=WIDTH of a coordinate, as in {shots.names[0]}=0.5: known are {', '.join(shots.names)}"
        )
    return name, shots.names.index(name), width


def _strata(path: Path) -> Strata:
    table = read_shots(path, row="stratum")
    if sorted(table.names) != COLUMNS:
        raise UserError(f"{path}: has the columns {', '.join(table.names)}: it needs {' and '.join(COLUMNS)}")
    shares, successes = (table.values[:, table.names.index(name)] for name in COLUMNS)
    return Strata(shares=shares, successes=successes)


def _content(found: Accuracy, wanted: list[dict[str, Any]], strata: Strata | None, shots: int) -> dict[str, Any]:
    """Everything as plain data; what is no number is null."""
    names, conflict = found.live.names, found.conflict
    content: dict[str, Any] = {
        "units": dict(zip(names, found.live.units, strict=True)),
        "level": found.level,
        "shots": {"simulated": len(found.simulated.values), "live": len(found.live.values)},
        "declared": asdict(found.discrepancy),
        "simulation_counts_as": {"mean": found.prior.strength, "spread": found.prior.marginal_degrees},
        **{key: _estimate(getattr(found, key), names) for key in ("joint", "live_only", "simulated_only")},
        "conflict": {
            "offset": dict(zip(names, conflict.offset.tolist(), strict=True)),
            "ratio": dict(zip(names, conflict.ratio.tolist(), strict=True)),
            "p_mean": _known(conflict.mean),
            "p_spread": _known(conflict.spread),
            "contradictions": found.contradictions,
        },
        "doubts": found.doubts,
        "further_shots": wanted,
    }
    content["declared"] = {name: _known(value) for name, value in content["declared"].items()}
    if strata is not None:
        content["strata"] = {
            "efficiency": strata.efficiency,
            "saved": strata.saved,
            "allocation": strata.allocation(shots).tolist(),
        }
    return content


def _estimate(estimate: AccuracyEstimate, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        "mean": {name: asdict(item) for name, item in zip(names, estimate.mean, strict=True)},
        "spread": {name: asdict(item) for name, item in zip(names, estimate.spread, strict=True)},
        "correlation": {f"{names[i]}, {names[j]}": asdict(item) for (i, j), item in estimate.correlation.items()},
        "circular_error_probable": asdict(estimate.circular_error) if estimate.circular_error else None,
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _show(found: Accuracy, content: dict[str, Any]) -> None:
    live, prior = found.live, found.prior
    table = Table(
        "", "live alone", "simulated alone", "together", "narrower than live",
        title=f"accuracy by {len(live.values)} live and {len(found.simulated.values)} simulated shots, "
        f"{100.0 * found.level:g} % intervals",
    )  # fmt: skip
    for row in accuracy_rows(found):
        table.add_row(row.name, *map(_text, (row.live, row.simulated, row.together)), f"{row.narrower:.0f} %")
    print_table(table)
    declared, conflict = found.discrepancy, found.conflict
    console.print(
        f"declared: mean off by {declared.mean:g} standard deviations, spread by a factor of "
        f"{math.exp(declared.spread):.3g}; so the simulation counts as {prior.strength:.3g} live shots for the mean, "
        f"{prior.marginal_degrees:.3g} for the spread"
    )
    title = "conflict with what was declared"
    differs = Table("live against simulated", "mean off by [sd]", "spread ratio", title=title)
    for name, offset, ratio in zip(live.names, conflict.offset, conflict.ratio, strict=True):
        differs.add_row(name, f"{offset:+.3f}", f"{ratio:.3f}")
    values = (f"{p:.3g}" if math.isfinite(p) else "-" for p in (conflict.mean, conflict.spread))
    differs.add_row("p-value of all", *values)
    print_table(differs)
    for remark in _remarks(found, content):
        console.print(remark)


def _remarks(found: Accuracy, content: dict[str, Any]) -> Iterator[str]:
    """How many more shots, and what strata save, a sentence each."""
    units = dict(zip(found.live.names, found.live.units, strict=True))
    for item in content["further_shots"]:
        unit = f" {units[item['of']]}".rstrip()
        shots = "shot" if item["shots"] == 1 else "shots"
        yield (
            f"{item['shots']} more {shots} until the interval of the {item['interval']} of {item['of']} is at most "
            f"{item['width']:g}{unit} wide, with a probability of {100.0 * ASSURANCE:g} %"
        )
    if "strata" in content:
        shared = content["strata"]
        yield (
            f"stratified: K_a {shared['efficiency']:.3f}, {100.0 * shared['saved']:.0f} % of the live shots saved; "
            f"of {sum(shared['allocation'])} shots the strata get {', '.join(map(str, shared['allocation']))}"
        )


def _text(item: Bounded) -> str:
    return f"{item.value:.4g} ({item.low:.4g} to {item.high:.4g})"
