"""Run the studies of the flexible joint: python -m benchmarks.flexible_joint [identification] [steps] [processes]."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from rich.table import Table

from benchmarks import parts, result
from benchmarks.flexible_joint import identification, steps
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration


def _identification(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = identification.measured(rig)
    return found, identification.tables(found)


def _steps(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = steps.measured(rig, load_model(configuration.shipped(rig.name, "model")))
    return found, [steps.table(found["loops"])]


def _processes(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = {name: steps.processes(rig, policy=name) for name in ("exact", "supervised")}
    return found, [steps.table(found)]


main = partial(
    parts.run, "flexible_joint", {"identification": _identification, "steps": _steps, "processes": _processes}
)

if __name__ == "__main__":
    result.run(main)
