"""Run the studies of the winged cone: python -m benchmarks.winged_cone [NAME] ..."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from rich.table import Table

from benchmarks import parts, result
from benchmarks.winged_cone import autopilot, control, hybrids, identification, processes, regions
from hybrid_sysid_ros.rigs.rig import Rig


def _autopilot(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = autopilot.measured(rig)
    return found, [autopilot.table(found)]


def _scheduled(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = autopilot.scheduled_measured(rig)
    return found, [autopilot.table(found)]


def _identification(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = identification.measured(rig)
    return found, identification.tables(found)


def _mpc(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = control.measured(rig)
    return found, [control.flight_table(found)]


def _mpc_timing(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = control.timing(rig)
    return found, [control.timing_table(found)]


def _hybrids(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = hybrids.measured(rig)
    return found, hybrids.tables(found)


def _regions(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = regions.measured(rig)
    return found, regions.tables(found)


def _processes(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = processes.measured(rig)
    return found, [processes.table(found)]


PARTS = {
    "autopilot": _autopilot,
    "scheduled": _scheduled,
    "identification": _identification,
    "hybrids": _hybrids,
    "regions": _regions,
    "mpc": _mpc,
    "mpc_timing": _mpc_timing,
    "processes": _processes,
}
main = partial(parts.run, "winged_cone", PARTS)

if __name__ == "__main__":
    result.run(main)
