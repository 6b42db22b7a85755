"""Bodies beside the C unit: what FMUs, pages, native nodes and MJCF files of each rig answer beside Python, and how
large they are.

Each comes from its shipped model by the export that users call, which compares before it writes; the beam's controller
also with its policy. Nothing here depends on the machine's load.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.table import Table

from benchmarks import result
from benchmarks.bodies import RIGS
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.export.fmu.export import export_controller, export_simulation
from hybrid_sysid_ros.extensions.export.page.export import export_page
from hybrid_sysid_ros.extensions.export.robots.export import export_mjcf
from hybrid_sysid_ros.extensions.native.build import MANIFEST, native_loop
from hybrid_sysid_ros.extensions.native.rig_parameters import NODES
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime.configuration import settings, shipped
from hybrid_sysid_ros.support.errors import UserError

NAME = "exports"
BEAM = "cam_beam"
ASKED = 1e-9
"""Largest difference. Joints in MuJoCo have none, for they are no translation: theirs is a share of the velocities."""
SUFFIXES = {
    "FMU of the model": ".fmu",
    "FMU of the plant": ".fmu",
    "FMU of the controller": ".fmu",
    "native node": "",
    "page": ".html",
    "MJCF": ".xml",
}
"""Of each body's file."""
WITH_POLICY = ("FMU of the controller", "native node", "page")
"""Bodies that the beam has with its policy, too."""
REAL_TIME: dict[str, Any] = {"real_time": True}
SUPERVISED: dict[str, Any] = {**REAL_TIME, "policy": "supervised"}


def written(body: str, rig: Rig, model: Model, place: Path, given: dict[str, Any]) -> dict[str, Any]:
    """Largest difference and bytes of a body, written into a folder; given: parameters of the controller.

    Raises UserError where it can't be written.
    """
    difference: float | None
    out = place / f"body{SUFFIXES.get(body, '')}"
    match body:
        case "FMU of the model" | "FMU of the plant":
            difference = export_simulation(rig, out, model=model if body.endswith("model") else None).difference
        case "FMU of the controller":
            difference = export_controller(rig, model, out, settings=given, seal="").difference
        case "page":
            difference = max(export_page(rig, model, out, seal="", settings=given).differences.values(), default=None)
        case "MJCF":
            difference = export_mjcf(rig, model, out, seal="").difference
        case "native node":
            own = {"controller": {"policy": "exact", **given}}
            out = native_loop(rig, {node: settings(rig, node, own.get(node, {}))[0] or {} for node in NODES})
            difference = json.loads((out.parent / MANIFEST).read_text(encoding="utf-8"))["largest_difference"]
    if difference is None:
        raise UserError("not compared: a compiler, node or MuJoCo is not there")
    return {"difference": difference, "bytes": out.stat().st_size}


def main() -> int:
    """Run, print the table, write the results."""
    machine, found = result.machine(), dict[str, dict[str, Any]]()
    cases = [(body, rig, rig, REAL_TIME) for body in SUFFIXES for rig in RIGS]
    cases += [(body, f"{BEAM}, supervised", BEAM, SUPERVISED) for body in WITH_POLICY]
    shown = Table("body", "loop", "difference", "size [kB]", title="Bodies beside the C unit")
    short = []
    for body, name, rig, given in cases:
        with TemporaryDirectory() as scratch:
            try:
                row = written(body, load(rig), load_model(shipped(rig, "model")), Path(scratch), given)
            except UserError as error:
                row = {"refused": str(error)}
        found.setdefault(body, {})[name] = row
        numbers = ["refused"] if "refused" in row else [f"{row['difference']:.1e}", f"{row['bytes'] / 1e3:.0f}"]
        shown.add_row(body, name, *numbers)
        if body != "MJCF" and not row.get("difference", math.inf) <= ASKED:
            short.append(f"{body} of {name}")
    print_table(shown)
    print(f"short: {', '.join(short) or 'none'}")
    print(result.write(NAME, {"bodies": found, "asked": ASKED, "short": len(short)}, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
