"""Run the studies of the winged cone: python -m benchmarks.winged_cone [autopilot] [identification] [hybrids]."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from rich.table import Table

from benchmarks import parts, result
from benchmarks.winged_cone import autopilot, hybrids, identification
from hybrid_sysid_ros.rigs.rig import Rig


def _autopilot(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = autopilot.measured(rig)
    return found, [autopilot.table(found)]


def _identification(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = identification.measured(rig)
    return found, identification.tables(found)


def _hybrids(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = hybrids.measured(rig)
    return found, hybrids.tables(found)


PARTS = {"autopilot": _autopilot, "identification": _identification, "hybrids": _hybrids}
main = partial(parts.run, "winged_cone", PARTS)

if __name__ == "__main__":
    result.run(main)
