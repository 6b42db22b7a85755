"""Tables of other programs for tests: a drive and a position every 10 ms, written as text and read as records."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.rigs import rig as rigs
from tests.command_line import Answer

TIME = 0.01 * np.arange(400)
DRIVE = np.round(5.0 * np.sign(np.sin(3.0 * TIME)) + 0.01 * np.arange(400) / 400, 6)
POSITION = np.round(0.05 * np.sin(3.0 * TIME), 6)
"""rad."""


def table(path: Path, header: str, *columns, delimiter=",", comma=False, form="%.6f") -> str:
    rows = [
        delimiter.join(form % value if np.isfinite(value) else "" for value in row)
        for row in zip(*columns, strict=True)
    ]
    text = "\n".join(row.replace(".", ",") if comma else row for row in rows)
    path.write_text(f"{header}\n{text}\n", encoding="cp1252")
    return str(path)


def read(folder: Path, name: str = "log"):
    return bags.read(folder / "bags" / name, rigs.load("cam_beam").signals)


def assert_same(record, output=POSITION, samples=400):
    assert record.samples == samples
    np.testing.assert_allclose(record.output[:, 0], output, atol=1e-9)
    np.testing.assert_allclose(record.input[: samples - 1, 0], DRIVE[: samples - 1], atol=1e-9)


def status_of(answer: Answer) -> str:
    status, out, error = answer
    assert status == 0, error
    return out + error
