"""The table of records' scores, which commands print."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from hybrid_sysid_ros.rigs.rig import Rig


def score_table(
    scores: Mapping[str, Mapping[str, Any]],
    rig: Rig,
    title: str,
    loops: Mapping[str, Mapping[str, Any]] | None = None,
) -> Table:
    """Table of records' scores, a row for each output with errors in its display unit, beside scores of re-simulated
    loops.
    """
    names = [item.name for item in rig.system.outputs]
    several = len(names) > 1
    error = "RMSE" if several else f"RMSE [{rig.display[0].unit}]"
    table = Table("record", *(["output"] if several else []), "R2", error, "fit [%]", title=title)
    for heading in ("closed loop R2", error) if loops else ():
        table.add_column(heading)
    for record, values in scores.items():
        for index, name in enumerate(names):
            own, shown = values.get("outputs", {}).get(name, values), rig.display[index]
            rmse = f"{float(shown.shown(own['rmse'])):.4g}{f' {shown.unit}' if several else ''}"
            cells = [record, *([name] if several else []), f"{own['r2']:.4f}", rmse, f"{own['fit_percent']:.1f}"]
            if loops:
                loop = loops[record].get("outputs", {}).get(name, loops[record]) if record in loops else None
                cells += [f"{loop['r2']:.4f}", f"{float(shown.shown(loop['rmse'])):.4g}"] if loop else ["", ""]
            table.add_row(*cells)
    return table
