"""How far manoeuvres go from the data that hybrids learn from, in their features: what a region of trust can fade."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.table import Table
from scipy.spatial.distance import cdist

from benchmarks import result
from benchmarks.winged_cone import flights
from benchmarks.winged_cone.flights import Flight
from benchmarks.winged_cone.hybrids import PLANTS, SEEDS, reported
from benchmarks.winged_cone.identification import FLOWN, MANOEUVRES, SECONDS
from hybrid_sysid_ros.core.symbolic import symbolic_features
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

SHARES = (0.8, 0.95, 0.99, 1.0)
"""Of a record, that an edge would enclose."""
END = 10.0
"""Seconds at the end of a manoeuvre, where it holds."""


def features(rig: Rig, flight: Flight) -> Array:
    """(samples - 1, features)."""
    return np.array(symbolic_features(rig.structures["known_air"])(flight.states[:-1].T, flight.inputs.T)).T


def measured(rig: Rig) -> dict[str, Any]:
    """Distances of Mahalanobis from the mean of each record: of its own samples by share, and of manoeuvres on its
    plant, in the middle of their time, at their end and at most.
    """
    edges: dict[float, list[float]] = {share: [] for share in SHARES}
    went: dict[str, dict[str, list[float]]] = {name: {"median": [], "end": [], "max": []} for name in MANOEUVRES}
    for number in PLANTS:
        plant = flights.plant(rig.system, 100 + number)
        seen = {
            name: features(rig, flights.fly(rig, plant, flights.steps(rig, levels, FLOWN)).since(flights.SETTLING))
            for name, levels in MANOEUVRES.items()
        }
        for seed in SEEDS:
            signals = flights.experiment(rig, "flight", seed, flights.SETTLING + SECONDS)
            learnt = features(rig, flights.fly(rig, plant, signals, seed=seed).since(flights.SETTLING))
            inverse = np.linalg.inv(np.cov(learnt.T))

            def away(points: Array, learnt: Array = learnt, inverse: Array = inverse) -> Array:
                return np.asarray(cdist(points, learnt.mean(axis=0)[None], "mahalanobis", VI=inverse)[:, 0])

            for share, found in edges.items():
                found.append(float(np.quantile(away(learnt), share)))
            for name, points in seen.items():
                far, last = away(points), round(END / (FLOWN / len(points)))
                for key, value in (("median", np.median(far)), ("end", np.mean(far[-last:])), ("max", np.max(far))):
                    went[name][key].append(float(value))
    return {
        "edges": {str(share): result.spread(found) for share, found in edges.items()},
        "manoeuvres": {name: {key: result.spread(found) for key, found in row.items()} for name, row in went.items()},
    }


def tables(found: Mapping[str, Any]) -> list[Table]:
    """Of the records, and of the manoeuvres."""
    records = Table("share of a record", "within", title="distances of Mahalanobis from a record's mean, mean (range)")
    for share, row in found["edges"].items():
        records.add_row(share, reported(row))
    shown = Table("manoeuvre", "median", "end", "max")
    for name, row in found["manoeuvres"].items():
        shown.add_row(name, *(reported(row[key]) for key in ("median", "end", "max")))
    return [records, shown]
