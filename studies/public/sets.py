"""The public sets: rigs, splits and starts, as nonlinearbenchmark.org has them."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

HERE = Path(__file__).parent


@dataclass(frozen=True, kw_only=True)
class PublicSet:
    """A set with its training records and tests."""

    name: str
    train: Sequence[Record]
    tests: Sequence[Record]
    sampling: Sampling
    """With the number of first samples that the benchmark gives for the start and does not score."""
    unit: str
    """Of its errors."""
    scale: float
    """In SI units of the record."""
    goals: Mapping[str, Sequence[float]]
    """Error that is asked for, by kind of structure, for each test."""
    published: Mapping[str, Sequence[float]]
    """Errors of others."""

    @property
    def rig(self) -> Rig:
        return load_rig(HERE / self.name)


Split = tuple[Sequence[Record], Sequence[Record]]
Reader = Callable[[Path], Split]


def read(name: str, folder: Path, reader: Reader | None = None) -> PublicSet:
    """A set from the files of a folder, or by another reader. Raises UserError for a set that is unknown, and for files
    that are missing or of another kind.
    """
    if name not in SETS:
        raise UserError(f"there is no public set {name}; known are {', '.join(SETS)}")
    own, described = SETS[name]
    train, tests = (reader or own)(folder)
    return PublicSet(name=name, train=train, tests=tests, **described)


def record_of(name: str, inputs: Array, outputs: Array, period: float) -> Record:
    """A record of one input and one output, (samples,) each."""
    return Record(
        name=name,
        time=np.arange(len(inputs), dtype=np.float64) * period,
        input=np.ascontiguousarray(inputs, dtype=float)[:, None],
        output=np.ascontiguousarray(outputs, dtype=float)[:, None],
    )


def _silverbox(folder: Path) -> Split:
    parts = "validation", "train", "test"
    u, y = (
        np.concatenate([_column(folder / "silverbox" / f"{letter}_{part}.txt") for part in parts]) for letter in "XY"
    )
    if len(u) != len(y) or len(u) < 127400:
        raise UserError(f"{folder / 'silverbox'}: {len(u)} inputs and {len(y)} outputs; the set has 131072 of each")
    cuts = {"multisine, training": (40650, 105712), "multisine": (105712, 127400), "arrow": (100, 40575)}
    cuts["arrow, inside"] = (100, 32100)
    first, *rest = (record_of(name, u[a:b], y[a:b], SILVERBOX_PERIOD) for name, (a, b) in cuts.items())
    return [first], rest


def _tanks(folder: Path) -> Split:
    path = folder / "cascaded_tanks" / "dataBenchmark.csv"
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.DictReader(file) if (row.get("uEst") or "").strip()]
        u0, u1, y0, y1 = (np.array([float(row[key]) for row in rows]) for key in ("uEst", "uVal", "yEst", "yVal"))
    except (OSError, KeyError, ValueError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: {error!r}; it needs the columns uEst, uVal, yEst, yVal of the set") from error
    return [record_of("estimation", u0, y0, 4.0)], [record_of("validation", u1, y1, 4.0)]


def _drives(folder: Path) -> Split:
    train, tests = [], []
    for name, file in (("low amplitude", "train"), ("high amplitude", "test")):
        u, y = (_column(folder / "coupled_drives" / f"{letter}_{file}.txt") for letter in "XY")
        train.append(record_of(f"{name}, training", u[:400], y[:400], 0.02))
        tests.append(record_of(name, u[400:], y[400:], 0.02))
    return train, tests


def _column(path: Path) -> Array:
    """The last column of a text file with a line of names. Raises UserError where it is none."""
    try:
        return np.loadtxt(path, skiprows=1, usecols=-1, ndmin=1)
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: {error}; it needs one number a line below a title") from error


SILVERBOX_PERIOD = 0.0016384
"""1 / 610.35 Hz [s], to the digit that is published."""

SETS: dict[str, tuple[Reader, dict[str, Any]]] = {
    "drives": (
        _drives,
        {
            "sampling": Sampling(step=0.005, period=0.02, initial_samples=10, warm_up=10),
            "unit": "ticks/s",
            "scale": 1.0,
            "goals": {"any": (0.084, 0.090)},
            "published": {"best": (0.115, 0.074), "black box": (0.096, 0.090), "linear": (0.224, 0.384)},
        },
    ),
    "tanks": (
        _tanks,
        {
            "sampling": Sampling(step=1.0, period=4.0, initial_samples=50, warm_up=50),
            "unit": "V",
            "scale": 1.0,
            "goals": {"gray": (0.25,), "hybrid": (0.25,)},
            "published": {"best": (0.18,), "black box": (0.396,), "linear": (0.588,)},
        },
    ),
    "silverbox": (
        _silverbox,
        {
            "sampling": Sampling(
                step=SILVERBOX_PERIOD / 4,
                period=SILVERBOX_PERIOD,
                input="interpolated",
                initial_samples=50,
                warm_up=50,
            ),
            "unit": "mV",
            "scale": 1e-3,
            "goals": {"gray": (1.5, 1.6), "black box": (0.5, 1.2)},
            "published": {"best": (0.36, 1.4), "black box": (1.5, 2.8), "linear": (7.0, 14.4)},
        },
    ),
}
"""Reader and what is known of each set; published errors as on nonlinearbenchmark.org in 2025."""
