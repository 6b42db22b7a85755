"""The check of records: faults named first, and good records accused of none."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.trust.spoilt import KINDS
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.rigs.experiments import simulate_experiment
from hybrid_sysid_ros.rigs.rig import Rig, load

RIGS = {"cam_beam": 200.0, "flexible_joint": 200.0, "wheel_motor": 100.0}
"""Samples per second [Hz] by rig."""
EXPERIMENTS = ("multisine", "random_steps", "swept_sine")
GOOD = 20
"""Good records of each rig."""
SECONDS = 30.0
FIRST_SEED = 1000
"""Seeds that nothing was developed with."""
ENOUGH = 8
"""Of nine cases, in which a kind must be named first to count."""


def simulated(rig: Rig, kind: str, seed: int) -> Record:
    """A record of the simulated rig."""
    with TemporaryDirectory() as folder:
        place = Path(folder) / f"{kind}_{seed}"
        simulate_experiment(rig, kind, place, seed=seed, duration=SECONDS, rate=RIGS[rig.name])
        return bags.read(place, rig.signals)


def good_records(first: int = FIRST_SEED, count: int = GOOD) -> Iterator[tuple[Rig, Record]]:
    """Records without a fault."""
    for name in RIGS:
        rig = load(name)
        for k in range(count):
            yield rig, simulated(rig, EXPERIMENTS[k % len(EXPERIMENTS)], first + k)


def named_first(record: Record, rig: Rig, kind: str, strength: int, seed: int) -> str:
    """What the check names first of a spoilt record; "" for nothing."""
    spoilt = KINDS[kind].spoil(record, rig, strength, np.random.default_rng(seed))
    found = findings_of(spoilt, rig)
    return found[0].kind if found else ""


def measured(first: int = FIRST_SEED, good: int = GOOD) -> dict[str, Any]:
    """Kinds with what was named first in each case, accusations of good records, and the longest time of a check."""
    cases: dict[str, dict[str, str]] = {kind: {} for kind in KINDS}
    accused, longest = dict[str, str](), 0.0
    for number, (rig, record) in enumerate(good_records(first, good)):
        begun = time.perf_counter()
        found = findings_of(record, rig)
        longest = max(longest, time.perf_counter() - begun) if number % good else longest  # the first one compiles
        if found:
            accused[f"{rig.name} {record.name}"] = str(found[0])
        if number % good == 0:
            for kind in KINDS:
                for strength in range(3):
                    cases[kind][f"{rig.name} {strength}"] = named_first(record, rig, kind, strength, first)
    right = {kind: sum(word in KINDS[kind].named for word in found.values()) for kind, found in cases.items()}
    return {
        "kinds": {kind: {"right": right[kind], "first": cases[kind]} for kind in KINDS},
        "kinds_named": sum(count >= ENOUGH for count in right.values()),
        "cases_named": sum(right.values()),
        "accused": accused,
        "good": 3 * good,
        "check_seconds": longest,
    }
