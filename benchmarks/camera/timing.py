"""A film's time found in a bag's: the error of shift and rate over random offsets."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from hybrid_sysid_ros.extensions.vision.camera.filming import experiment
from hybrid_sysid_ros.extensions.vision.reading.joint_reference import joint_reference
from hybrid_sysid_ros.extensions.vision.reading.synchronisation import synchronise
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.rigs.rig import Rig

OFFSETS = 20
SECONDS, PICTURES = 55.0, 30.002
LARGEST_SHIFT, LARGEST_RATE = 3.0, 100e-6  # s and 1, +-
EXPOSURE = 0.008
DEVIATION = 0.004  # degrees, of an angle as the table of angles has it
ASKED_SHIFT, ASKED_RATE = 0.3, 5.0  # ms, ppm


def measured(rig: Rig) -> dict[str, Any]:
    """Errors of shift [ms] and rate [ppm], each with the deviation that was reported, over random offsets."""
    random, rows = np.random.default_rng(0), list[dict[str, float]]()
    for number in range(OFFSETS):
        with TemporaryDirectory() as folder:
            kind = ("multisine", "random_steps", "swept_sine")[number % 3]
            bag = Path(folder) / "bag"
            motion = experiment(rig, kind, bag, seed=number, duration=SECONDS, rate=200.0)
            known = joint_reference(rig, scene_of(rig).joint, bag)
            times, encoder = known.times, known.values
        shift, rate = random.uniform(-LARGEST_SHIFT, LARGEST_SHIFT), random.uniform(-LARGEST_RATE, LARGEST_RATE)
        begin = max(0.0, random.uniform(0.0, 2.0))
        true = begin + np.arange(int((SECONDS - begin - 0.1) * PICTURES)) / PICTURES
        film = (true - shift) / (1.0 + rate)
        inside = EXPOSURE * ((np.arange(9) + 0.5) / 9 - 0.5)
        angles = np.interp(true[:, None] + inside, motion.times, motion.angles).mean(axis=1)
        angles += np.radians(DEVIATION) * random.standard_normal(len(angles)) + 0.02
        found = synchronise(film, angles, times, encoder)
        rows.append(
            {
                "shift_ms": 1e3 * float(np.mean(found.time(film) - true)),
                "rate_ppm": 1e6 * (found.rate - rate),
                "told_shift_ms": 1e3 * float(found.deviations[0]),
                "told_rate_ppm": 1e6 * float(found.deviations[1]),
            }
        )
    return {
        "offsets": OFFSETS,
        **{f"worst_{key}": max(abs(row[key]) for row in rows) for key in rows[0]},
        **{f"rms_{key}": float(np.sqrt(np.mean([row[key] ** 2 for row in rows]))) for key in rows[0]},
    }


def table(found: dict[str, Any]) -> Table:
    """Of shift and rate."""
    shown = Table("", "worst", "rms", "asked, worst", "reported, rms", title=f"time, {found['offsets']} random offsets")
    for name, key, asked in (("shift [ms]", "shift_ms", ASKED_SHIFT), ("rate [ppm]", "rate_ppm", ASKED_RATE)):
        cells = (f"{found[f'{kind}_{key}']:.3f}" for kind in ("worst", "rms"))
        shown.add_row(name, *cells, f"{asked:g}", f"{found[f'rms_told_{key}']:.3f}")
    return shown
