"""One record in the files of every program becomes the same bag; damaged and inflated files are refused."""

from __future__ import annotations

import zipfile
import zlib
from datetime import date, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags import joint_states, write_bag
from hybrid_sysid_ros.extensions.importing import log_file
from hybrid_sysid_ros.extensions.importing.readers import open_log
from hybrid_sysid_ros.rigs import rig as rigs
from tests.command_line import refused

TIME = 0.01 * np.arange(300)
DRIVE = 5.0 * np.sign(np.sin(3.0 * TIME))
POSITION = 50.0 * np.sin(3.0 * TIME)
"""mrad."""


def npz(path: Path) -> None:
    np.savez_compressed(path, t=TIME, drive=DRIVE, position=POSITION)


def mat(path: Path) -> None:
    """As Simulink writes structures with time."""
    savemat(path, {"out": {"drive": DRIVE, "position": POSITION, "time": TIME}, "title": "x"}, do_compression=True)


def mat_73(path: Path) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("tout", TIME), ("drive", DRIVE), ("position", POSITION)):
            file[name] = values[None]


def parquet(path: Path) -> None:
    import polars

    polars.DataFrame({"time": TIME, "drive": DRIVE, "position [mrad]": POSITION}).write_parquet(path)


def mf4(path: Path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(DRIVE, TIME, name="drive", unit="V")])
        file.append([Signal(POSITION, TIME, name="position", unit="mrad")])
        file.save(path)


def tdms(path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as file:
        for name, unit, values in (("drive", "V", DRIVE), ("position", "mrad", POSITION)):
            properties = {"unit_string": unit, "wf_increment": 0.01, "wf_start_offset": 0.0}
            file.write_segment([ChannelObject("data", name, values, properties=properties)])


def mcap(path: Path) -> None:
    stamps = 10**18 + np.round(1e9 * TIME).astype(np.int64)
    series = joint_states("/lab/states", stamps, ["beam", "other"], position=np.column_stack([POSITION, DRIVE]))
    command = joint_states("/lab/drive", stamps, ["motor"], effort=DRIVE[:, None])
    write_bag(path, [series, command])


def ros1(path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    number = store.types["std_msgs/msg/Float64"]
    with Writer(path) as writer:
        topics = {
            name: writer.add_connection(f"/{name}", number.__msgtype__, typestore=store)
            for name in ("drive", "position")
        }
        for time, drive, position in zip(TIME, DRIVE, POSITION, strict=True):
            for name, value in (("drive", drive), ("position", position)):
                stamp = 10**18 + round(1e9 * time)
                writer.write(topics[name], stamp, store.serialize_ros1(number(data=value), number.__msgtype__))


def ros1_stamped(path: Path) -> None:
    """Headers of ROS 1 have a number that those of ROS 2 lack."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    joints, header, stamp = (
        store.types[name]
        for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    with Writer(path) as writer:
        topic = writer.add_connection("/states", joints.__msgtype__, typestore=store)
        for k, (time, drive, position) in enumerate(zip(TIME, DRIVE, POSITION, strict=True)):
            at = 10**18 + round(1e9 * time)
            head = header(seq=k, stamp=stamp(sec=at // 10**9, nanosec=at % 10**9), frame_id="lab")
            message = joints(
                header=head, name=["beam"], position=np.array([position]), velocity=np.array([0.0]),
                effort=np.array([drive]),
            )  # fmt: skip
            writer.write(topic, at, store.serialize_ros1(message, joints.__msgtype__))


ROS = ("--column", "drive=/lab/drive.effort[motor]", "--column", "position=/lab/states.position[beam]")
FILES = {
    "a.npz": (npz, ()), "a.mat": (mat, ()), "b.mat": (mat_73, ("--column", "time=tout")), "a.parquet": (parquet, ()),
    "a.mf4": (mf4, ()), "a.tdms": (tdms, ()), "a_bag": (mcap, ROS),
    "b.bag": (ros1_stamped, ("--column", "drive=/states.effort[beam]", "--column", "position=/states.position[beam]")),
    "a.bag": (ros1, ("--column", "drive=/drive.data", "--column", "position=/position.data")),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_record_is_the_same_in_every_format(imported, tmp_path, name):
    write, options = FILES[name]
    write(tmp_path / name)
    status, _, error = imported(str(tmp_path / name), "--unit", "position=mrad", *options)
    assert status == 0, error
    record = bags.read(tmp_path / "bags" / Path(name).stem, rigs.load("cam_beam").signals)
    assert record.samples == 300
    np.testing.assert_allclose(record.output[:, 0], 1e-3 * POSITION, atol=1e-12)
    np.testing.assert_allclose(record.input[:-1, 0], DRIVE[:-1])


def rate_npz(path: Path) -> None:
    np.savez(path, drive=DRIVE, position_mrad=POSITION, fs=100.0)


def rate_mat(path: Path) -> None:
    savemat(path, {"drive": DRIVE, "position_mrad": POSITION, "sampling_rate": 100})


@pytest.mark.parametrize(("write", "name"), [(rate_npz, "a.npz"), (rate_mat, "a.mat")])
def test_a_sampling_rate_beside_the_samples_is_their_time(imported, tmp_path, write, name):
    write(tmp_path / name)
    status, out, error = imported(str(tmp_path / name))
    assert status == 0, error
    assert "300 samples, 2.99 s, one in 0.01 s" in out


def test_a_rig_of_a_table_has_the_units_of_its_names(program, tmp_path):
    """As it has of a text file."""
    parquet(tmp_path / "a.parquet")
    assert program("rig", "from", str(tmp_path / "a.parquet"), str(tmp_path / "unit_of_name"))[0] == 0
    (output,) = rigs.load(str(tmp_path / "unit_of_name")).system.outputs
    assert str(output) == "position [rad]"


@pytest.mark.parametrize("kind", ["moments", "times of day", "texts", "texts of day", "days"])
def test_times_of_a_table_are_seconds_whatever_their_type(tmp_path, kind):
    """Of rows 10 ms apart over midnight, or of a row a day."""
    import polars

    moments = [datetime(2024, 3, 3, 23, 59, 59) + timedelta(seconds=time) for time in TIME.tolist()]
    days = [date(2024, 2, 1) + timedelta(days=k) for k in range(300)]
    times = {
        "moments": moments, "times of day": [moment.time() for moment in moments], "days": days,
        "texts": [moment.isoformat() for moment in moments], "texts of day": [f"{m:%H:%M:%S.%f}" for m in moments],
    }[kind]  # fmt: skip
    polars.DataFrame({"when": times, "drive": DRIVE}).write_parquet(tmp_path / "a.parquet")
    file = open_log(tmp_path / "a.parquet")
    expected = 86400.0 * np.arange(300) if kind == "days" else TIME
    np.testing.assert_allclose(file.read(["when"])["when"], expected, atol=1e-9)
    assert file.columns["when"].unit == "s"


def odd_npz(path: Path) -> None:
    np.savez(path, **{"t": TIME, "drive [V]": DRIVE, "position": np.column_stack([POSITION, DRIVE])})


def odd_h5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in (("t", TIME), ("drive [V]", DRIVE), ("lab/position.raw", np.stack([POSITION, DRIVE]))):
            file[name] = values


@pytest.mark.parametrize(("write", "name", "column"), [
    (odd_npz, "a.npz", "position[0]"), (odd_h5, "a.h5", "lab.position.raw[0]"),
])  # fmt: skip
def test_arrays_may_have_brackets_and_points_in_their_names(imported, tmp_path, write, name, column):
    write(tmp_path / name)
    options = ("--column", "time=t", "--column", "drive=drive [V]", "--column", f"position={column}")
    status, _, error = imported(str(tmp_path / name), "--unit", "position=mrad", *options)
    assert status == 0, error
    record = bags.read(tmp_path / "bags" / "a", rigs.load("cam_beam").signals)
    np.testing.assert_allclose(record.output[:, 0], 1e-3 * POSITION, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in FILES if name != "a_bag"])
def test_a_cut_file_is_refused_in_a_line(imported, tmp_path, name):
    FILES[name][0](tmp_path / name)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: len(content) // 3])
    status, _, error = imported(str(tmp_path / name), *FILES[name][1])
    assert status == 2, error
    assert "Traceback" not in error
    assert not (tmp_path / "bags").exists()


def test_archives_that_unpack_to_more_than_they_should_are_refused(imported, tmp_path, monkeypatch):
    """Zeros, a thousandth of their size on the disk; the limit is made small, the files are not made large."""
    from hybrid_sysid_ros.extensions.importing.readers import matlab

    for module in (log_file, matlab):
        monkeypatch.setattr(module, "LARGEST", 100_000)
    zeros = np.zeros(200_000)
    np.savez_compressed(tmp_path / "a.npz", t=zeros, drive=zeros, position=zeros)
    savemat(tmp_path / "a.mat", {"t": zeros, "drive": zeros, "position": zeros}, do_compression=True)
    for name, words in (("a.npz", "GiB in memory"), ("a.mat", "unpacks to more than")):
        assert (tmp_path / name).stat().st_size < 10_000
        refused(imported(str(tmp_path / name)), words)


def test_an_archive_that_lies_about_its_size_is_damaged(imported, tmp_path):
    npz(tmp_path / "a.npz")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("t.npy", zlib.compress(bytes(1000)))
    refused(imported(str(tmp_path / "b.npz")), "damaged")


def test_python_objects_in_an_archive_are_never_read(imported, tmp_path):
    np.savez(tmp_path / "a.npz", t=TIME, drive=np.array([print, None]), position=POSITION)
    assert "drive" in imported(str(tmp_path / "a.npz"))[2]
