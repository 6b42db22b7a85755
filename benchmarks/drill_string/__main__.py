"""Run the studies of the drill string: python -m benchmarks.drill_string [identification] [suppression]."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from rich.table import Table

from benchmarks import parts, result
from benchmarks.drill_string import identification, suppression
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration


def _identification(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = identification.measured(rig)
    return found, identification.tables(found)


def _suppression(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = suppression.measured(rig, load_model(configuration.shipped(rig.name, "model")))
    return found, [suppression.table(found)]


main = partial(parts.run, "drill_string", {"identification": _identification, "suppression": _suppression})

if __name__ == "__main__":
    result.run(main)
