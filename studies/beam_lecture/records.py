"""BAB: the author's records of the cam-driven beam (.mat files), turned into bags at their full rate."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, whosmat
from scipy.io.matlab import MatReadError

from hybrid_sysid_ros.bags import Series, joint_states, joint_trajectories, markers, write_bag
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder, sha256

REQUIRED = ("time", "u", "y")
OPTIONAL = ("yf", "ref", "trigger")
RIG = "cam_beam"
REFERENCE_THRESHOLD = 1e-8  # V; the experiment ends with the last sample above it
JITTER = 0.01  # of the sampling time; the records have 1e-4
START = 1_000_000_000  # ns, stamp of the first sample: 0 means "no time yet" to ROS
_UNREADABLE = (MatReadError, ValueError, TypeError, KeyError, IndexError, EOFError, struct.error, zlib.error)


@dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """The experiment window of a .mat file. Arrays are (samples,) in V; what the file has not got is None.

    before: input before the first sample, NaN where the window begins with the file; window: which part it is.
    """

    name: str
    sampling_time: float
    input: NDArray[np.float64]
    before: float
    output: NDArray[np.float64]
    filtered: NDArray[np.float64] | None
    reference: NDArray[np.float64] | None
    window: str


def import_folder(
    folder: Path | str, out: Path | str, progress: Callable[[str], None] = lambda line: None
) -> list[Path]:
    """Turn every record in a folder into a bag out/<name of the file>; return the bags.

    A record is any .mat file with time, u and y (yf, ref and trigger if there), whatever its name; other .mat files
    are skipped. Bags that an earlier import made are replaced. `progress` gets a line for each file.

    Raises:
        UserError: no folder, no record in it, or a file that is not readable, not finite or not uniform in time.
    """
    folder, out = Path(folder), Path(out)
    scale = radians_per_volt()
    paths, skipped = _records(folder)
    for path in paths:
        check_folder(out / path.stem, marker=markers(out / path.stem))
    for path in skipped:
        progress(f"{path.name}: skipped, it has no {', '.join(REQUIRED)}")
    bags = []
    for path in paths:
        experiment = load(path)
        notes = {"source": path.name, "source_sha256": sha256(path), "window": experiment.window}
        bags.append(write_bag(out / experiment.name, topics_of(experiment, scale), replace=True, notes=notes))
        seconds = (len(experiment.output) - 1) * experiment.sampling_time
        progress(f"{path.name}: {len(experiment.output)} samples, {seconds:.1f} s, {experiment.window}")
    return bags


def load(path: Path | str) -> Experiment:
    """Read one .mat file and cut it to the experiment: first trigger to last sample with a reference.

    Raises:
        UserError: it is not readable, no record, not finite, or its time is not uniform.
    """
    path = Path(path)
    with _readable(path):
        content = loadmat(path, variable_names=[*REQUIRED, *OPTIONAL])
    arrays = {key: _array(path, key, content[key]) for key in (*REQUIRED, *OPTIONAL) if key in content}
    for key in REQUIRED:
        if key not in arrays:
            raise UserError(f"{path}: has no {key}: a record has {', '.join(REQUIRED)}")
    for key, array in arrays.items():
        if len(array) != len(arrays["time"]):
            raise UserError(f"{path}: {key} has {len(array)} samples, time has {len(arrays['time'])}")
    sampling_time = _sampling_time(path, arrays["time"])
    first, last, window = _window(arrays)
    inside = slice(first, last + 1)
    return Experiment(
        name=path.stem,
        sampling_time=sampling_time,
        input=arrays["u"][inside],
        before=float(arrays["u"][first - 1]) if first else float("nan"),
        output=arrays["y"][inside],
        filtered=arrays["yf"][inside] if "yf" in arrays else None,
        reference=arrays["ref"][inside] if "ref" in arrays else None,
        window=window,
    )


def topics_of(experiment: Experiment, scale: float, namespace: str = f"/{RIG}") -> list[Series]:
    """Topics of an experiment: joint_states, joint_command and, if known, reference; scale [rad/V].

    The effort of joint_states is the input of the interval that ends at the stamp; joint_command has that of the
    interval that begins there.
    """
    samples = len(experiment.output)
    stamps = START + np.round(np.arange(samples) * experiment.sampling_time * 1e9).astype(np.int64)
    applied = np.concatenate([[experiment.before], experiment.input[:-1]])
    names, positions, efforts = ["beam"], [scale * experiment.output], [applied]
    if experiment.filtered is not None:
        names.append("beam_filtered")
        positions.append(scale * experiment.filtered)
        efforts.append(np.full(samples, np.nan))
    topics = [
        joint_states(
            f"{namespace}/joint_states",
            stamps,
            names,
            position=np.column_stack(positions),
            effort=np.column_stack(efforts),
        ),
        joint_states(f"{namespace}/joint_command", stamps, ["beam"], effort=experiment.input[:, None]),
    ]
    if experiment.reference is not None:
        positions_ahead = scale * experiment.reference[:, None, None]
        topics.append(
            joint_trajectories(f"{namespace}/reference", stamps, ["beam"], positions=positions_ahead, times=[0.0])
        )
    return topics


def radians_per_volt() -> float:
    """Scale of the rig's angle sensor [rad/V]."""
    return load_rig(RIG).display[0].scale


def _records(folder: Path) -> tuple[list[Path], list[Path]]:
    """The folder's .mat files: those that are records, and the others."""
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder: give the one with the .mat files")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() == ".mat" and file.is_file())
    records = [file for file in files if set(REQUIRED) <= _keys(file)]
    if not records:
        raise UserError(f"{folder}: none of its {len(files)} .mat files is a record with {', '.join(REQUIRED)}")
    return records, [file for file in files if file not in records]


def _keys(path: Path) -> set[str]:
    with _readable(path):
        names = {name for name, _, _ in whosmat(path)}
        if "" in names:  # what SciPy before 1.15 makes of a file of zeros
            raise ValueError("a variable without a name")
    return names


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Say in a line why scipy can't read a .mat file."""
    try:
        yield
    except NotImplementedError as error:
        raise UserError(f"{path}: is a MATLAB 7.3 (HDF5) file: save it again with save -v7") from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except _UNREADABLE as error:
        raise UserError(f"{path}: is no readable .mat file (cut short or damaged): copy it again") from error


def _array(path: Path, key: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
    if value.dtype.kind not in "fiub":
        raise UserError(f"{path}: {key} holds no numbers")
    array = np.asarray(value, dtype=np.float64).ravel()
    wrong = ~np.isfinite(array)
    if wrong.any():
        raise UserError(
            f"{path}: {key} is not finite at sample {int(np.argmax(wrong))}, {int(wrong.sum())} such in all"
        )
    return array


def _sampling_time(path: Path, time: NDArray[np.float64]) -> float:
    """Sampling time [s], three digits where they are all that the jitter allows."""
    if len(time) < 3:
        raise UserError(f"{path}: only {len(time)} samples: a record needs 3 or more")
    steps = np.diff(time)
    step = float(np.median(steps))
    wrong = np.abs(steps - step) > JITTER * abs(step)
    if step <= 0 or wrong.any():
        k = int(np.argmax(wrong)) + 1 if wrong.any() else 1
        raise UserError(f"{path}: time is not uniform at sample {k}: a step of {steps[k - 1]:.6g} s among {step:.6g} s")
    nominal = float(f"{step:.2e}")
    return nominal if abs(nominal - step) < 1e-3 * step else step


def _window(arrays: dict[str, NDArray[np.float64]]) -> tuple[int, int, str]:
    """First and last sample of the experiment, and what they are."""
    whole = (0, len(arrays["time"]) - 1)
    for key in ("trigger", "ref"):
        if key not in arrays:
            return *whole, f"the whole file (it has no {key})"
    triggered = np.flatnonzero(arrays["trigger"])
    moving = np.flatnonzero(np.abs(arrays["ref"]) > REFERENCE_THRESHOLD)
    if not len(triggered):
        return *whole, "the whole file (its trigger is zero)"
    if not len(moving) or moving[-1] - triggered[0] < 2:
        return *whole, "the whole file (its reference is zero after the trigger)"
    first, last = int(triggered[0]), int(moving[-1])
    return first, last, f"samples {first} to {last} of the file (trigger to the end of the reference)"
