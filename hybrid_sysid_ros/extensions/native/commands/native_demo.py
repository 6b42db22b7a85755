"""The demo in a native body: the loop in C drives the simulated rig as a process of this computer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands.terminal import print_lines, status
from hybrid_sysid_ros.extensions.native.companion import Native
from hybrid_sysid_ros.extensions.shared.demo_body import DemoBody, demo_folder
from hybrid_sysid_ros.extensions.shared.demo_loop import run_loop
from hybrid_sysid_ros.report.run_summary import RunSummary
from hybrid_sysid_ros.rigs.rig import default
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import processes
from hybrid_sysid_ros.support.files import check_folder, make_folder

BODY = "native"


def instead(
    body: DemoBody = "",
    rig: str = "",
    out: Path | None = None,
    seed: int = 0,
    overwrite: bool = False,
    as_json: bool = False,
) -> Callable[[], dict[str, Any]] | None:
    """This demo instead of the usual one, where the native loop is the body."""
    if body != BODY:
        return None
    chosen = load_rig(rig or default())
    place = demo_folder(out, body, chosen)

    def run() -> dict[str, Any]:
        processes.check_ros()
        make_folder(place)
        check_folder(place / "loop", marker=bags.METADATA, replace=overwrite)
        status.print(f"the loop of {chosen.name} in C, its plant, reference and recorder in Python")
        native = Native(tell=status.print)
        bag, diagnostics = run_loop(place / "loop", chosen, chosen.reference, seed=seed, companions=[native])
        summary = RunSummary.of(diagnostics, chosen, bag=bag)
        if not as_json:
            print_lines(summary.lines, summary.alarms)
        return dict(summary.content)

    return run
