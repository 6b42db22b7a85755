"""Run summary: the lines in which a run of a loop ends, the same on a terminal and in a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.control.safety.supervisor import REJECTIONS
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection, closed_loop_section
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import sha256

ENOUGH = 0.01
"""Share of missed commands up to which a machine is fast enough: where the diagnostics begin to warn."""
FOLLOWED = 0.5
"""Error as a share of the reference's movement (both RMS) up to which a rig follows: one that stood still has 1."""
LARGEST_BAG = 500_000_000
"""Bytes of a bag that is read at once."""
SEAL = 16
"""Digits of a folder's SHA-256."""
PERCENTILES = {"p50": "median", "p99": "99 %", "max": "longest"}


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """What matters of a run, from the last diagnostics of its nodes, as the plant and the controller saw it, and from
    the bag.
    """

    missed: int
    """Measurements that had no command when the next one came."""
    measurements: int
    delay: Mapping[str, float] = field(default_factory=dict)
    """Percentiles of the time from a measurement until its command came to the plant [ms]; none in simulated time."""
    simulated_time: bool = False
    layers: Mapping[str, int] = field(default_factory=dict)
    """Commands by the layer of safety that answered."""
    rejections: Mapping[str, float] = field(default_factory=dict)
    """Shares of the online checks of the network's plans that rejected one, by the reason, the largest first."""
    failsafe: Mapping[str, int] = field(default_factory=dict)
    """How often the loop left what it is for, by what it did instead."""
    tracking: Mapping[str, str] = field(default_factory=dict)
    """Error of each part of the reference (RMSE), with its unit."""
    untracked: str = "not recorded: --bag FOLDER records the run"
    """Why there is none."""
    share: float | None = None
    """Error over the whole run as a share of the reference's movement; None where the reference does not move."""
    ratio: float | None = None
    """The largest of the tracking errors over those of the ideal loop; None where these are not known."""
    disturbed: Sequence[str] = ()
    """What moves the simulated rig that no model knows, with its unit."""
    restarts: int = 0
    """How often the controller was started again: what it counts is of the last one."""
    bag: Path | None = None
    folders: Mapping[str, str] = field(default_factory=dict)
    """What estimator and controller had in the loop, its model and its policy, by name and seal."""

    @classmethod
    def of(
        cls,
        diagnostics: Mapping[str, Mapping[str, Any]],
        rig: Rig,
        *,
        bag: Path | None = None,
        section: ClosedLoopSection | None = None,
        lockstep: bool = False,
        folders: Mapping[str, Path] | None = None,
    ) -> RunSummary:
        """diagnostics: the last values by node and key. section: of the bag, where that was read. folders: those of
        the model and of the policy.
        """
        plant, controller = diagnostics.get("plant", {}), diagnostics.get("controller", {})
        untracked = cls.untracked
        if bag is not None and section is None:
            section, untracked = _read(bag, rig)
        delays = {key: plant[f"delay_ms_{key}"] for key in PERCENTILES if plant.get(f"delay_ms_{key}") is not None}
        times, checks = _counts(controller, "times_"), _counts(controller, "check_")
        return cls(
            missed=plant.get("missed_commands", 0),
            measurements=plant.get("measurements", 0),
            delay={} if lockstep else delays,
            simulated_time=lockstep,
            layers=_counts(controller, "layer_"),
            rejections={name: count / sum(checks.values()) for name, count in checks.items() if name in REJECTIONS},
            failsafe={name: count for name, count in times.items() if name != "driving"}
            | ({"at rest for want of commands": count} if (count := plant.get("command_timeouts")) else {}),
            tracking={} if section is None else {n: f"{v:.3f} {section.units[n]}" for n, v in section.rmse.items()},
            untracked=untracked,
            share=None if section is None else section.share,
            ratio=None if section is None else section.ratio,
            disturbed=[] if section is None else section.disturbed,
            restarts=controller.get("restarts", 0),
            bag=bag,
            folders={name: f"{folder} (SHA-256 {sha256(folder)[:SEAL]})" for name, folder in (folders or {}).items()},
        )

    @property
    def alarms(self) -> frozenset[str]:
        """Of the lines, those that say that something is wrong."""
        slow = {"missed"} if self.fast_enough is False else set()
        return frozenset(slow | ({"tracking"} if self.follows is False else set()))

    @property
    def follows(self) -> bool | None:
        """Whether the rig follows its reference; None where that is not known."""
        return None if self.share is None else self.share <= FOLLOWED

    @property
    def fast_enough(self) -> bool | None:
        """Whether the machine was; None where time was simulated, or nothing was measured."""
        return self.missed <= ENOUGH * self.measurements if self.delay else None

    @property
    def lines(self) -> dict[str, str]:
        """Sentences by what they are about."""
        delays = " / ".join(f"{value:.2f}" for value in self.delay.values())
        names = ", ".join(PERCENTILES.values())
        total = sum(self.layers.values())
        shares = [f"{name} {100.0 * count / total:.3g} %" for name, count in self.layers.items()]
        worst = [f"; worst check: {name}, {100.0 * part:.2g} %" for name, part in self.rejections.items()][:1]
        times = [f"{name} {count} time{'' if count == 1 else 's'}" for name, count in self.failsafe.items()]
        parts = [f"{name.replace('_', ' ')} {error}" for name, error in self.tracking.items()]
        last = f" (since its last restart, of {self.restarts})" if self.restarts else ""
        return {
            "tracking": f"{', '.join(parts)} (RMSE){self.followed and f': {self.followed}'}"
            if parts
            else self.untracked,
            "delay": f"{delays} ms ({names})" if delays else "not measured",
            "missed": f"{self.missed} of {self.measurements} commands: {self._judgement}",
            "layers": (", ".join(shares) or "no command") + "".join(worst) + last,
            "failsafe": (", ".join(times) or "never") + last,
            **{f"{name} used": words for name, words in self.folders.items()},
            "bag": str(self.bag or "none"),
        }

    @property
    def content(self) -> dict[str, Any]:
        """The same as plain data."""
        return {
            "delay_ms": {key: round(value, 4) for key, value in self.delay.items()},
            "missed_commands": self.missed,
            "measurements": self.measurements,
            "fast_enough": self.fast_enough,
            "layers": dict(self.layers),
            "rejections": {name: round(part, 4) for name, part in self.rejections.items()},
            "failsafe": dict(self.failsafe),
            "tracking_share": None if self.share is None else round(self.share, 4),
            "tracking_over_ideal": None if self.ratio is None else round(self.ratio, 4),
            "controller_restarts": self.restarts,
            "folders": dict(self.folders),
        }

    @property
    def followed(self) -> str:
        """Whether the rig followed its reference, in words; "" where that is not known."""
        if self.share is None:
            return ""
        verb = "follows" if self.follows else "does NOT follow"
        ideal = "" if self.ratio is None else f", at most {self.ratio:.2f} times that of the ideal loop"
        return f"rig {verb} its reference (error {100.0 * self.share:.2g} % of the reference's movement{ideal})"

    @property
    def _judgement(self) -> str:
        if self.fast_enough is None:
            return "time was simulated" if self.simulated_time else "nothing was measured"
        share = f"{100.0 * self.missed / max(self.measurements, 1):.2g} % missed"
        if self.fast_enough:
            return f"this machine is fast enough ({share})"
        return f"this machine is TOO SLOW ({share}), which spoils the numbers above"


def _counts(values: Mapping[str, Any], prefix: str) -> dict[str, int]:
    """What was counted under keys that begin with a prefix, the largest first."""
    found = {
        key.removeprefix(prefix).replace("_", " "): value for key, value in values.items() if key.startswith(prefix)
    }
    return {name: found[name] for name in sorted(found, key=found.__getitem__, reverse=True) if found[name]}


def _read(bag: Path, rig: Rig) -> tuple[ClosedLoopSection | None, str]:
    """A recorded loop, or why it can't be judged."""
    try:
        if sum(file.stat().st_size for file in bag.iterdir()) > LARGEST_BAG:
            return None, "the bag is too large to be read at once"
        return closed_loop_section(LoopRecord.from_bag(bag, rig)), ""
    except (OSError, UserError) as error:
        return None, f"not judged: {error}"
