"""Views of a recorded loop: what its figures enlarge, and the bounds that they draw."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection, Window
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import defaults, mpc_problem
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

STEP_SHOWN, SMOOTH_SHOWN = (1.0, 2.25), (5.0, 15.0)
"""Windows that are enlarged, in horizons: before and after a step, or start and end in a smooth part."""


def zooms(section: ClosedLoopSection) -> dict[str, Window]:
    """Windows that are enlarged, by the names of those that they lie in."""
    problem, found = _problem(section.rig), {}
    horizon = problem.horizon * problem.period
    for name, item in section.windows.items():
        begin, end = item.start + SMOOTH_SHOWN[0] * horizon, min(item.start + SMOOTH_SHOWN[1] * horizon, item.stop)
        if not item.smooth:
            begin, end = _largest_step(section.loop, item, horizon)
        found[name] = Window(output=item.output, start=begin, stop=end)
    return found


def bounds_of(section: ClosedLoopSection) -> dict[int, tuple[float, float]]:
    """Lowest and highest value [SI] of outputs without a reference that the controller keeps within bounds, from the
    rig's file.
    """
    loop, rig, problem = section.loop, section.rig, _problem(section.rig)
    names = [item.name for item in rig.system.states]
    limits = dict(zip(names, zip(problem.state_low, problem.state_high, strict=True), strict=True))
    return {
        k: limits[item.name]
        for k, item in enumerate(rig.system.outputs)
        if k not in loop.tracked and np.isfinite(limits.get(item.name, (-np.inf, np.inf))).any()
    }


def _problem(rig: Rig) -> ControlProblem:
    return mpc_problem(defaults(rig, "controller"), rig)


def _largest_step(loop: LoopRecord, window: Window, horizon: float) -> tuple[float, float]:
    """Start and stop [s] around the reference's largest jump in a window, for a controller's horizon [s]."""
    reference = loop.reference[:, window.output]
    inside = np.isfinite(reference) & loop.within(window.start + 0.5, window.stop)
    jump = np.abs(np.diff(np.nan_to_num(reference))) * (inside[1:] & inside[:-1])
    middle = float(loop.time[int(np.argmax(jump))]) if jump.any() else window.start
    return max(middle - STEP_SHOWN[0] * horizon, 0.0), middle + STEP_SHOWN[1] * horizon
