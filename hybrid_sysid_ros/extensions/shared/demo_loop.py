"""The loop of a demo: where its results are, how it runs, and how well it tracked."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.commands import terminal
from hybrid_sysid_ros.control import ControlProblem, ExactMpc
from hybrid_sysid_ros.extensions.shared.demo_recipe import DemoRecipe
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection, follows_schedule
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import controller_model, wrap_for_rig
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant, simulated_loop
from hybrid_sysid_ros.support.progress import progress_bars

OUT = Path("out/demo")


def tracked(section: ClosedLoopSection, plan: DemoRecipe) -> dict[str, Any]:
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


def ideal_errors(section: ClosedLoopSection, model: Model, problem: ControlProblem) -> dict[str, float]:
    """Tracking errors of the ideal loop in a section's windows, in display units: those of the exact MPC of a model and
    a problem on a plant that is this model, without disturbance and noise, which is then read by the rig's sensors.
    Empty where the loop followed no reference of its rig.
    """
    rig, loop = section.rig, section.loop
    schedule = next((item for item in rig.references.values() if follows_schedule(loop, item)), None)
    if schedule is None:
        return {}
    system = controller_model(rig, model.system)
    done = simulated_loop(
        rig,
        model,
        wrap_for_rig(rig, system, ExactMpc(system, problem)),
        schedule,
        duration=min(schedule.duration, float(loop.time[-1])),
        plant=predicted_plant(rig, model.system),
    )
    found = {}
    for name, window in section.windows.items():
        left = rig.display[window.output].shown(done.tracking_rmse(window.start, window.stop)[window.output])
        found[name] = float(np.hypot(left, rig.sensors[window.output].floor))
    return found
