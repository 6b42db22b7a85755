"""Bands of free runs on rigs that are made of a record of a world that the project knows nothing of."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import hybrid_sysid_ros as hs
from benchmarks.trust.worlds import KINDS, WORLDS
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.importing.commands import rig_from
from hybrid_sysid_ros.support.arrays import Array

STRUCTURES = ("gray", "hybrid", "state_space")
SEEDS = range(len(KINDS))
"""Each trains on a kind of excitation and is judged by the next kind."""
WITHIN, LEAST = (0.85, 0.95), 0.7
"""Share of all samples that bands of 90 % are to hold, and least of those of a record."""


def measured() -> dict[str, Any]:
    """By structure and record: the share of the unseen samples that the band of 90 % holds, R2 of the run, and the
    mean width in that of the narrowest band of constant width which holds as much as that of 90 % is to.
    """
    found: dict[str, dict[str, dict[str, float]]] = {name: {} for name in STRUCTURES}
    with TemporaryDirectory() as folder:
        for world in WORLDS:
            for seed in SEEDS:
                kinds = KINDS[seed], KINDS[(seed + 1) % len(KINDS)]
                rig, training, unseen = _records(Path(folder) / f"{world}_{seed}", world, kinds, seed)
                for structure in STRUCTURES:
                    model = hs.identify(training, rig, structure)
                    found[structure][f"{world} {seed}"] = _judged(model, unseen)
    shares = {name: [row["held_90"] for row in rows.values()] for name, rows in found.items()}
    return {
        "records": found,
        "held_90": {name: float(np.mean(values)) for name, values in shares.items()},
        "least": {name: min(values) for name, values in shares.items()},
        "width": {
            name: float(np.exp(np.mean([np.log(row["width"]) for row in rows.values()])))
            for name, rows in found.items()
        },
    }


def _judged(model: hs.Model, unseen: Record) -> dict[str, float]:
    run = model.free_run(unseen)
    errors, half = np.abs(run.measured - run.outputs), run.bands[0.9]
    narrowest = float(np.quantile(errors, 0.9))
    held = float(np.mean(errors <= half))
    return {"held_90": held, "r2": model.score(unseen).r2, "width": float(np.mean(half)) / narrowest}


def _records(folder: Path, world: str, kinds: tuple[str, str], seed: int) -> tuple[hs.Rig, Record, Record]:
    """A rig that is made of a record of the first kind, and a record of each kind."""
    folder.mkdir()
    tables = [WORLDS[world].record(kind, seed) for kind in kinds]
    file, place = folder / "log.csv", folder / f"{world}_{seed}"
    header = ",".join(tables[0])
    np.savetxt(file, np.column_stack(list(tables[0].values())), delimiter=",", header=header, comments="", fmt="%.9g")
    inputs = [name for name in tables[0] if name.startswith("u")]
    rig_from.command(file, place, inputs=inputs, outputs=["y"])
    rig = hs.load_rig(str(place))
    training, unseen = (_record(table, rig, kind) for table, kind in zip(tables, kinds, strict=True))
    return rig, training, unseen


def _record(table: Mapping[str, Array], rig: hs.Rig, kind: str) -> Record:
    inputs = {name: values for name, values in table.items() if name.startswith("u")}
    return hs.record(time=table["time"], inputs=inputs, outputs={"y": table["y"]}, rig=rig, name=kind)
