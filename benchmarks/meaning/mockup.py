"""Mock-up: how many wrong models are contradicted by ten shots of the rig, and how many right ones.

The rig is the sled that `rig new` writes, with a reference of 4 s. A wrong model has all its parameters off in a random
direction, so far that the output's path moves by a tenth of the loop's tracking error (both rms).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.meaning.rows import Row
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.accuracy.mockup import compared
from hybrid_sysid_ros.extensions.accuracy.monte_carlo_runs import MonteCarloRuns, Range
from hybrid_sysid_ros.extensions.accuracy.statistics import Verdict, overall
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant
from hybrid_sysid_ros.support.arrays import Array

MODELS, LIVE, SIMULATED = 50, 10, 100
MOVED, MATTERS = 0.1, 0.1
CONTRADICTED, FALSE = 45, 5
"""Asked: wrong models that are contradicted at least, right ones at most."""
HALVINGS = 8
SHORTER = {
    "duration: 20.0": "duration: 4.0",
    "stop: 10.0": "stop: 2.0",
    "start: 10.0, stop: 20.0": "start: 2.0, stop: 4.0",
}
"""Of the sled's file."""


def sled(folder: Path) -> Rig:
    """The rig, in a folder."""
    template = Path(rigs.__file__).parent / "_template"
    text = (template / "rig.yaml").read_text(encoding="utf-8")
    for old, new in SHORTER.items():
        text = text.replace(old, new)
    (folder / "rig.yaml").write_text(text, encoding="utf-8")
    (folder / "system.py").write_text((template / "system.py").read_text(encoding="utf-8"), encoding="utf-8")
    return rigs.load(folder)


def wrong_ones(rig: Rig, given: Mapping[str, Any]) -> Iterator[System]:
    """Systems whose loop is moved by MOVED."""
    random, values = np.random.default_rng(0), np.array([rig.system.named[p.name] for p in rig.system.parameters])
    run = Range(seed=0, **given).loop()

    def loop(system: System) -> tuple[Array, Array]:
        done = run(predicted_plant(rig, system))
        return done.outputs, done.references

    right, references = loop(rig.system)
    tracking = float(np.sqrt(np.mean((right - references) ** 2)))
    for _ in range(MODELS):
        direction = random.standard_normal(len(values))
        low, high = 0.0, 0.1

        def off(size: float, direction: Array = direction) -> System:
            return rig.system.with_values(values * np.exp(size * direction / np.linalg.norm(direction)))

        def moved(size: float) -> float:
            return float(np.sqrt(np.mean((loop(off(size))[0] - right) ** 2))) / tracking

        while moved(high) < MOVED:
            low, high = high, 2.0 * high
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if moved(middle) > MOVED else (middle, high)
        yield off(high)


def measured() -> tuple[Mapping[str, Any], list[Row]]:
    """How many are contradicted."""
    with TemporaryDirectory() as place:
        folder = Path(place) / "sled"
        folder.mkdir()
        rig = sled(folder)
        model = Model(
            rig=rig.name, place=str(folder), structure="gray", system=rig.system, sampling=Sampling(), names=(),
            covariance=np.zeros((0, 0)), training_range={},
        )  # fmt: skip
        given: dict[str, Any] = {"rig": rig, "model": model, "schedule": rig.schedule()}

        def runs(count: int, **options: Any) -> MonteCarloRuns:
            where = Range(**given, **options)
            return MonteCarloRuns(where=where, rows=where(range(count)))

        simulated = runs(SIMULATED, seed=0, predicted=True)

        def contradicted(reality: System, seed: int) -> bool:
            found = compared(simulated, runs(LIVE, seed=seed, reality=reality), seed, MATTERS)
            return Verdict.CONTRADICTED in {overall(items) for items in found.values()}

        false = sum(contradicted(rig.system, 100 + k) for k in range(MODELS))
        hits = sum(contradicted(system, 200 + k) for k, system in enumerate(wrong_ones(rig, given)))
    rows = [
        Row(name=f"wrong models contradicted, of {MODELS}", asked=CONTRADICTED, measured=hits),
        Row(name=f"right models contradicted, of {MODELS}", asked=FALSE, measured=false, at_most=True),
    ]
    return {"models": MODELS, "live": LIVE, "simulated": SIMULATED, "wrong": hits, "right": false}, rows
