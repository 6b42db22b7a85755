"""The section of a report on a recorded loop, as data without figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.rigs.excitation import ReferenceSchedule
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

DRIVING = LoopState.DRIVING.word
SAME_REFERENCE = 1e-3
"""Largest median distance of a loop's reference from the rig's, relative to its peak, for both to be the same."""
SMOOTH = ("sine", "multisine", "swept_sine")
"""Kinds of references without jumps."""


@dataclass(frozen=True, kw_only=True)
class Window:
    """A window [s] in which tracking of an output is judged or shown. smooth: its reference has no jumps."""

    output: int
    start: float
    stop: float
    smooth: bool = False


@dataclass(frozen=True, kw_only=True)
class ClosedLoopSection:
    """A recorded loop."""

    loop: LoopRecord
    windows: Mapping[str, Window] = field(default_factory=dict)
    """Windows in which tracking is judged, by name."""
    ideal: Mapping[str, float] = field(default_factory=dict)
    """Tracking errors of the ideal loop in the windows, in display units; empty where they are not known."""

    @property
    def rig(self) -> Rig:
        """The rig in the loop."""
        return self.loop.rig

    @property
    def disturbed(self) -> list[str]:
        """States that the rig's disturbances move, with their units."""
        states = (self.rig.system.declared_states[k] for k in self.rig.disturbances)
        return [f"{item.name} [{item.unit}]" for item in states]

    @property
    def states(self) -> str:
        """A sentence on the states of the loop, "" where none were recorded."""
        seconds: dict[str, float] = {}
        for start, stop, state in self.loop.spells:
            seconds[state] = seconds.get(state, 0.0) + stop - start
        others = [f"{state} for {time:.1f} s" for state, time in seconds.items() if state != DRIVING]
        if not seconds:
            return ""
        return f"The controller was {', '.join(others)}." if others else "The controller was driving all the time."

    @property
    def rmse(self) -> dict[str, float]:
        """Tracking errors in the windows, in display units."""
        return {
            name: self.loop.tracking_rmse(item.start, item.stop, output=item.output)
            for name, item in self.windows.items()
        }

    @property
    def share(self) -> float | None:
        """Error over the whole run as a share of the reference's movement about its mean, both RMS, of the output that
        is worst; None where no reference moves.
        """
        shares = []
        for k in self.loop.tracked:
            inside = np.isfinite(self.loop.error[:, k]) & (self.loop.time >= 0.0)
            moved = float(np.std(self.loop.reference[inside, k])) if inside.any() else 0.0
            if moved > SAME_REFERENCE * float(np.max(np.abs(self.loop.reference[inside, k]), initial=0.0)):
                shares.append(float(np.sqrt(np.mean(self.loop.error[inside, k] ** 2))) / moved)
        return max(shares, default=None)

    @property
    def ratio(self) -> float | None:
        """The largest of the tracking errors over those of the ideal loop; None where these are not known."""
        ratios = (error / self.ideal[name] for name, error in self.rmse.items() if self.ideal.get(name))
        return max(ratios, default=None)

    @property
    def units(self) -> dict[str, str]:
        """Units of the tracking errors."""
        return {name: self.rig.display[item.output].unit for name, item in self.windows.items()}


def closed_loop_section(loop: LoopRecord, rig: Rig | None = None) -> ClosedLoopSection:
    """A recorded loop, judged on the windows of the rig's reference that it followed, if any, else as a whole.

    rig: by default the one that the loop was read with.
    """
    rig, time = rig or loop.rig, loop.time
    windows: dict[str, Window] = {}
    for schedule in rig.references.values():
        if follows_schedule(loop, schedule):
            for piece in schedule.segments:
                smooth = piece.excitation.kind in SMOOTH
                windows[piece.name] = Window(output=piece.output, start=piece.start, stop=piece.stop, smooth=smooth)
    if not windows:
        several = len(loop.tracked) > 1
        names = {k: f"whole run, {rig.system.outputs[k].name}" if several else "whole run" for k in loop.tracked}
        windows = {name: Window(output=k, start=0.0, stop=float(time[-1])) for k, name in names.items()}
    known = np.isfinite(loop.reference) & (time >= 0.0)[:, None]
    windows = {
        name: item
        for name, item in windows.items()
        if (known[:, item.output] & loop.within(item.start, item.stop)).any()
    }
    return ClosedLoopSection(loop=loop, windows=windows)


def follows_schedule(loop: LoopRecord, schedule: ReferenceSchedule) -> bool:
    """Whether a loop followed a reference schedule of its rig."""
    wanted = schedule(loop.time)
    started = loop.time >= 0.0
    for k in loop.tracked:
        shown = loop.rig.display[k].shown(loop.reference[:, k])
        inside = started & np.isfinite(shown)
        peak = max(float(np.max(np.abs(wanted[:, k]))), 1e-12)
        if not inside.any() or np.median(np.abs(shown - wanted[:, k])[inside]) > SAME_REFERENCE * peak:
            return False
    return bool(loop.tracked)
