"""Files of signals drive experiments, and are followed by outputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.rigs.experiments import duration_of, excitation
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.rigs.signal_file import driving_columns, output_columns, write_signals
from hybrid_sysid_ros.runtime.references import length_of, signal_of
from hybrid_sysid_ros.support.errors import UserError

TIMES = np.arange(5, dtype=np.float64) * 0.5


def written(path: Path, *columns: tuple[str, str], peak: float = 4.0) -> str:
    write_signals(path, TIMES, {column: peak * np.array([0.0, 0.25, 0.5, 0.75, 1.0]) for column in columns})
    return str(path)


def test_an_input_holds_each_sample_and_an_output_is_joined_by_lines(tmp_path: Path) -> None:
    rig = load("flexible_joint")
    file = written(tmp_path / "plan.csv", *driving_columns(rig), *output_columns(rig), peak=2.0)
    assert duration_of(rig, file) == length_of(file, rig) == 2.0
    driven = excitation(rig, file, seed=0, duration=2.0, times=np.array([0.0, 0.499, 0.5, 0.74, 2.0]))
    np.testing.assert_allclose(driven[:, 0], [0.0, 0.0, 0.5, 0.5, 2.0])
    np.testing.assert_allclose(signal_of(file, {}, rig)([0.25, 0.5, 9.0]), [[0.25] * 2, [0.5] * 2, [2.0] * 2])


def test_a_loop_is_driven_by_its_reference_in_the_shown_unit(tmp_path: Path) -> None:
    rig = load("cam_beam")
    assert driving_columns(rig) == [("reference", "V")]
    file = written(tmp_path / "plan.csv", ("reference", "V"))
    found = excitation(rig, file, seed=0, duration=2.0, times=TIMES)
    np.testing.assert_allclose(found[:, 0], [volts * rig.sensors[0].scale for volts in (0.0, 1.0, 2.0, 3.0, 4.0)])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "column time [s] is missing: it has no header"),
        ("time [s],position [V]\n0,0\n1,1\n", "column reference [V] is missing"),
        ("time [s],reference [mV]\n0,0\n1,1\n", "column reference is in mV; this rig needs it in V"),
        ("time,reference\n0,0\n1,nan\n", "line 3: reference is 'nan': it needs a number"),
        ("time,reference\n0,0\n1\n", "line 3: reference is 'missing': it needs a number"),
        ("time,reference\n0,0\n0,1\n", "column time must begin at 0 and rise"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_with_its_place(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "plan.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError) as caught:
        duration_of(load("cam_beam"), str(path))
    assert str(path) in str(caught.value)
    assert words in str(caught.value)


def test_a_reference_beyond_the_rig_s_reach_is_refused(tmp_path: Path) -> None:
    rig = load("cam_beam")
    with pytest.raises(UserError, match="position goes from 0 to 11 V; the rig reaches -9"):
        signal_of(written(tmp_path / "plan.csv", ("position", "V"), peak=11.0), {}, rig)
