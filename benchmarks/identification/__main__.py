"""Identification beside SysIdentPy, jax-sysid and a plain PyTorch loop: free-run R2 on unseen records, and time.

Every method gets the same real records (HYBRID_SYSID_DATA; see docs/guides/bags.md) and is scored by the same strict
free run on the raw output every 50 ms, under two protocols: trained on both multisines, tested on all seven records;
and trained on the first halves of multisine and random steps, tested on the rest. Settings and seeds of the peers are
chosen on the training records, which is timed apart and left out of the ratios; so is compilation. A ratio is the time
at which a peer's fit first has this project's mean R2 on the test, as if one had known when to stop, over this
project's time. A peer that isn't installed is skipped (extra: peers).
"""

from __future__ import annotations

import importlib
import math
import os
import statistics
import sys
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from benchmarks.identification.peer import Peer, r2
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.identification import Part, evaluate, identify, prepare
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import Rig, load
from studies.beam_lecture import lecture
from studies.beam_lecture.lecture import DATA

NAME = "identification"
PEERS = {"sysidentpy": "narmax", "jax_sysid": "jax_state_space", "torch": "torch_rollout"}
STRUCTURES = ("gray", "hybrid")
REPEATS = 3
"""Fits of this project; the median of their seconds counts."""

Parts = Sequence[tuple[Record, Part]]


def main() -> int:
    """Run, print a table for each protocol, write the results."""
    if not os.environ.get(DATA):
        print(f"skipped: {DATA} is not set, and the benchmark is about the real records", file=sys.stderr)
        return 0
    machine = result.machine()
    peers = available()
    records = lecture.read_folder(Path(os.environ[DATA]))
    protocols: dict[str, tuple[Parts, Parts]] = {}
    for number in lecture.PUBLISHED:
        arranged = lecture.arrange(records, number)
        protocols[f"protocol {number}"] = ([(record, arranged.part) for record in arranged.training], arranged.tests)
    rig = load(lecture.RIG)
    results: dict[str, Any] = {"versions": {name: version(name) for peer in peers for name in peer.packages}}
    for protocol, (training, unseen) in protocols.items():
        ours = {structure: identified(rig, structure, training, unseen) for structure in STRUCTURES}
        theirs = {peer.name: fitted(rig, peer, training, unseen) for peer in peers}
        for found in theirs.values():
            found["against"] = {structure: against(found, ours[structure]) for structure in STRUCTURES}
        results[protocol] = ours | theirs
        print_table(table(protocol, ours, theirs))
    print(result.write(NAME, results, on=machine))
    return 0


def available() -> list[Peer]:
    """The peers that are installed; a line for each that isn't."""
    peers: list[Peer] = []
    for package, module in PEERS.items():
        try:
            peers += importlib.import_module(f"benchmarks.identification.{module}").PEERS
        except ImportError as error:
            print(f"skipped: {package} is not usable here ({error}); pip install -e '.[peers]'", file=sys.stderr)
    return peers


def identified(rig: Rig, structure: str, training: Parts, unseen: Parts) -> dict[str, Any]:
    """What this project makes of the records: seconds of each fit, R2 by record. The first fit alone compiles."""
    seconds, total = [], []
    for _ in range(REPEATS):
        began = time.perf_counter()
        model = identify([record for record, _ in training], rig, structure, sampling=Sampling(), part=training[0][1])
        total.append(time.perf_counter() - began)
        seconds.append(float(model.fit["seconds"]))
    return {
        "seconds": statistics.median(seconds),
        "all_seconds": seconds,
        "compile_seconds": max(total[0] - seconds[0], 0.0),
        **scored({lecture.table_name(record.name): evaluate(model, record, part=part).r2 for record, part in unseen}),
    }


def fitted(rig: Rig, peer: Peer, training: Parts, unseen: Parts) -> dict[str, Any]:
    """The same of a peer: the settings it chose on the training records, its fit with them, R2 as the fit went on."""
    known, unknown = (
        [prepare(part.of(record, peer.sampling), rig.system, peer.sampling) for record, part in parts]
        for parts in (training, unseen)
    )
    candidate, choosing = peer.choose(known)
    fit = peer.fit(known, **candidate)
    curve = [(at, [r2(simulation, item) for item in unknown]) for at, simulation in fit.snapshots]
    return {
        "seconds": fit.seconds,
        "compile_seconds": fit.compile_seconds,
        "choosing_seconds": choosing,
        "settings": dict(candidate),
        "candidates": len(peer.candidates),
        **scored(dict(zip((lecture.table_name(record.name) for record, _ in unseen), curve[-1][1], strict=True))),
        "curve": [{"seconds": at, "mean_r2": finite(float(np.mean(values)))} for at, values in curve],
    }


def scored(values: dict[str, float]) -> dict[str, Any]:
    """R2 by record and their mean; None where the free run diverged."""
    return {
        "r2": {name: finite(value) for name, value in values.items()},
        "mean_r2": finite(float(np.mean(list(values.values())))),
    }


def finite(value: float) -> float | None:
    """The value, None where a free run diverged."""
    return value if math.isfinite(value) else None


def against(found: dict[str, Any], ours: dict[str, Any]) -> dict[str, float | None]:
    """A peer's seconds in multiples of this project's: until it had the same mean R2 (None: never), and of its fit."""
    reached = [point["seconds"] for point in found["curve"] if better(point["mean_r2"], ours["mean_r2"])]
    return {
        "ratio_at_same_r2": min(reached) / ours["seconds"] if reached else None,
        "ratio_of_fits": found["seconds"] / ours["seconds"],
    }


def better(value: float | None, than: float | None) -> bool:
    """Whether an R2 is the same or better; None is the worst."""
    return value is not None and (than is None or value >= than)


def table(protocol: str, ours: dict[str, dict[str, Any]], theirs: dict[str, dict[str, Any]]) -> Table:
    """One line for each method. best: highest mean R2 at any time of the fit."""
    names = list(next(iter(ours.values()))["r2"])
    shown = Table(
        "method", *names, "mean", "best", "fit", "compile", "choosing", *(f"to R2 of {name}" for name in ours),
        title=f"free-run R2, {protocol}",
    )  # fmt: skip
    for name, found in (ours | theirs).items():
        curve = [point["mean_r2"] for point in found.get("curve", []) if point["mean_r2"] is not None]
        shown.add_row(
            name,
            *(number(value) for value in found["r2"].values()),
            number(found["mean_r2"]),
            number(max(curve, default=found["mean_r2"])),
            f"{found['seconds']:.2f} s",
            f"{found['compile_seconds']:.1f} s",
            f"{found.get('choosing_seconds', 0.0):.0f} s",
            *(ratio(value) for value in found.get("against", {}).values()),
        )
    return shown


def number(value: float | None) -> str:
    """Three decimals of an R2."""
    return "diverged" if value is None else "< -10" if value < -10 else f"{value:.3f}"


def ratio(value: dict[str, float | None]) -> str:
    """12.0x: the same R2 after so many times the seconds; never (2x): not in its whole fit, which took so many."""
    same = value["ratio_at_same_r2"]
    return f"{same:.1f}x" if same is not None else f"never ({value['ratio_of_fits']:.2g}x)"


if __name__ == "__main__":
    result.run(main)
