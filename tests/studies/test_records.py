"""The author's records as bags: the window, the full rate, and the loop they were recorded in."""

import numpy as np
import pytest
from scipy.io import savemat

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture import records as bab

GAIN, LIMIT = 3.0, 10.0  # of the author's controller: u = clip(3 (ref - yf), +-10 V)


def contents(samples=400, **changes):
    """A file as the author's: a closed loop between samples 100 and 300."""
    k = np.arange(samples)
    reference = np.where((k >= 100) & (k <= 300), 4 * np.sin(0.05 * k) + 0.5, 0.0)
    filtered = 0.3 * np.cos(0.02 * k)
    entries = {
        "time": k * 0.99994e-3,
        "u": np.clip(GAIN * (reference - filtered), -LIMIT, LIMIT),
        "y": filtered + 0.01 * np.sin(k),
        "yf": filtered,
        "ref": reference,
        "trigger": np.where(k >= 100, 5, 0).astype(np.uint8),
    }
    return {key: value for key, value in {**entries, **changes}.items() if value is not None}


def imported(tmp_path, **changes):
    (tmp_path / "mat").mkdir(exist_ok=True)
    savemat(tmp_path / "mat" / "any name.mat", contents(**changes))
    lines: list[str] = []
    (bag,) = bab.import_folder(tmp_path / "mat", tmp_path / "bags", lines.append)
    return bags.read(bag, load_rig("cam_beam").signals), lines


def assert_closed_loop(record):
    """Every sample obeys the author's control law, to rounding."""
    scale = bab.radians_per_volt()
    law = np.clip(GAIN * (record.channels["reference"] - record.channels["filtered"]) / scale, -LIMIT, LIMIT)
    np.testing.assert_allclose(record.channels["command"], law, rtol=0, atol=1e-13)
    np.testing.assert_allclose(record.input[:-1, 0], law[:-1], rtol=0, atol=1e-13)


def test_the_experiment_runs_from_the_trigger_to_the_end_of_the_reference(tmp_path):
    record, lines = imported(tmp_path)
    assert record.name == "any name"
    assert record.samples == 201
    assert record.sampling_time == pytest.approx(1e-3, rel=1e-12)
    assert "201 samples" in lines[0]
    scale = np.deg2rad(1.3)
    np.testing.assert_allclose(record.output[:, 0], scale * contents()["y"][100:301], rtol=1e-14)
    assert_closed_loop(record)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"trigger": None}, "no trigger"),
        ({"trigger": np.zeros(400)}, "trigger is zero"),
        ({"ref": np.zeros(400)}, "reference is zero"),
        ({"ref": None, "yf": None, "trigger": None}, "no trigger"),
    ],
)
def test_without_a_window_the_whole_file_is_taken_and_said(tmp_path, changes, reason):
    record, lines = imported(tmp_path, **changes)
    assert record.samples == 400
    assert f"the whole file (it has {reason})" in lines[0] or f"the whole file (its {reason}" in lines[0]
    np.testing.assert_array_equal(record.input[:-1, 0], contents(**changes)["u"][:-1])


def test_a_bag_has_the_input_that_ended_at_each_stamp(tmp_path):
    imported(tmp_path)
    following = {"topic": "joint_command", "field": "effort[beam]", "holds": "following"}
    signals = tmp_path / "signals.yaml"
    output = {"topic": "joint_states", "field": "position[beam]"}
    signals.write_text(
        f"namespace: cam_beam\nsignals: {{inputs: {{drive: {following}}}, outputs: {{position: {output}}}}}"
    )
    by_command = bags.read(tmp_path / "bags" / "any name", Signals.load(signals))
    by_state = bags.read(tmp_path / "bags" / "any name", load_rig("cam_beam").signals)
    np.testing.assert_allclose(by_command.input[:-1], by_state.input[:-1], rtol=1e-14)


def test_importing_again_gives_the_same_bag(tmp_path):
    first, _ = imported(tmp_path)
    bab.import_folder(tmp_path / "mat", tmp_path / "bags")
    assert bags.read(tmp_path / "bags" / "any name", load_rig("cam_beam").signals).digest == first.digest


def test_other_files_are_skipped_and_said(tmp_path):
    (tmp_path / "mat").mkdir()
    savemat(tmp_path / "mat" / "a_model.mat", {"theta": np.arange(3)})
    _, lines = imported(tmp_path)
    assert lines[0] == "a_model.mat: skipped, it has no time, u, y"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"y": np.where(np.arange(400) == 250, np.nan, 0.0)}, "y is not finite at sample 250"),
        ({"u": np.zeros(399)}, "u has 399 samples, time has 400"),
        (
            {"time": np.where(np.arange(400) >= 70, 1.0, 0.0) + 1e-3 * np.arange(400)},
            "time is not uniform at sample 70",
        ),
        ({"time": np.zeros(400)}, "time is not uniform"),
        ({"u": np.array(["text"] * 400)}, "u holds no numbers"),
    ],
)
def test_a_wrong_file_is_named(tmp_path, changes, reason):
    with pytest.raises(UserError, match=rf"any name\.mat: {reason}"):
        imported(tmp_path, **changes)
    assert not (tmp_path / "bags" / "any name").exists()


def test_where_one_bag_cannot_be_put_none_is_written(tmp_path):
    (tmp_path / "mat").mkdir()
    for name in ("first", "second"):
        savemat(tmp_path / "mat" / f"{name}.mat", contents())
    (tmp_path / "bags" / "second").mkdir(parents=True)
    (tmp_path / "bags" / "second" / "thesis.tex").touch()
    with pytest.raises(UserError, match=r"second.*holds other files"):
        bab.import_folder(tmp_path / "mat", tmp_path / "bags")
    assert [path.name for path in (tmp_path / "bags").iterdir()] == ["second"]


def test_a_folder_without_records_is_named(tmp_path):
    with pytest.raises(UserError, match="no such folder"):
        bab.import_folder(tmp_path / "missing", tmp_path / "bags")
    savemat(tmp_path / "a.mat", {"theta": np.arange(3)})
    with pytest.raises(UserError, match=r"none of its 1 \.mat files is a record"):
        bab.import_folder(tmp_path, tmp_path / "bags")


def test_an_unreadable_file_is_named(tmp_path):
    savemat(tmp_path / "whole.mat", contents(), do_compression=True)
    whole = (tmp_path / "whole.mat").read_bytes()
    hdf5 = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400)
    for content in (b"", b"no mat file", bytes(1000), whole[: len(whole) // 2], whole[:200], hdf5):
        (tmp_path / "whole.mat").write_bytes(content)
        with pytest.raises(UserError, match=r"whole\.mat: (is no readable|is a MATLAB 7\.3|cannot be read)"):
            bab.import_folder(tmp_path, tmp_path / "bags")
    assert not (tmp_path / "bags").exists()


@pytest.mark.slow
def test_the_real_records_are_closed_loops_exactly(author_records):
    assert len(author_records) >= 7
    for record in author_records:
        assert record.duration == pytest.approx(55.0, abs=0.01)
        assert record.sampling_time == pytest.approx(1e-3, rel=1e-12)
        assert_closed_loop(record)
