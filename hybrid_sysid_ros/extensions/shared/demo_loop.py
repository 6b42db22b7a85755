"""The loop of a demo: where its results are, how it runs, and how well it tracked."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hybrid_sysid_ros import report
from hybrid_sysid_ros.commands import terminal
from hybrid_sysid_ros.extensions.shared.demo_recipe import DemoRecipe
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.progress import progress_bars

OUT = Path("out/demo")


def tracked(section: report.ClosedLoopSection, plan: DemoRecipe) -> dict[str, Any]:
    """The summary of the loop's tracking; the unit is one where all parts have the same, else one for each."""
    rmse, units = section.rmse, section.units
    scored = [name for name in plan.scored if name in rmse]
    named = {name: units[name] for name in scored}
    return {
        "unit": next(iter(named.values())) if len(set(named.values())) == 1 else named,
        "tracking_rmse": {name: round(rmse[name], 4) for name in scored},
    }


def run_loop(bag: Path, rig: Rig, reference: str, **options: Any) -> tuple[Path, Mapping[str, Mapping[str, Any]]]:
    """The bag of the loop, and the last diagnostics of its nodes; options: fields of :class:`~.runtime.run.Run`."""
    with progress_bars(terminal.status) as update:
        outcome = Run(
            rig=rig.source,
            reference=reference,
            bag=bag,
            overwrite=True,
            domain=None if "ROS_DOMAIN_ID" in os.environ else 1 + os.getpid() % 100,  # away from running rigs
            tell=terminal.status.print,
            progress=lambda seconds, duration: update("reference, seconds", int(seconds), int(duration)),
            **options,
        ).go()
    if outcome.interrupted or outcome.bag is None:
        raise KeyboardInterrupt
    return outcome.bag, outcome.diagnostics
