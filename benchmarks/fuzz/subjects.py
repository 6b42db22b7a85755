"""Subjects: good files of each kind, how they are read, and what was read in a few characters."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from benchmarks.fuzz import records
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.layout import jazzy_types
from hybrid_sysid_ros.bags.mcap import CHUNK, DATA_END
from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.core import System, simulate
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.parameters import declarations, parameters, shipped
from hybrid_sysid_ros.support.structured import read_mapping

Files = dict[str, bytes]
"""By path."""
ROOT = Path(__file__).parents[2]
RIG = "flexible_joint"
SAMPLES = 300
START, STEP = 1_700_000_000_000_000_000, 5_000_000  # ns
Read = Callable[[Path, bool], Any]


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A kind of file. read: gives what is in a folder of such files, where it can be recovered if the second argument
    says so. targets: the files that are mutated. sealed: whether every change of what is read can be noticed; where it
    can't, in a bag without checksums, a lost message can. A rig's or a user's own YAML is true whatever it says.
    """

    name: str
    files: Files
    targets: tuple[str, ...]
    read: Read
    sealed: bool = True


def reported(value: Any) -> tuple[int, str]:
    """Whatever was read in a few characters, the same for the same; and of a bag its number of samples."""
    digest = hashlib.sha256()
    _add(digest, value)
    first = value[0]
    return (len(first) if isinstance(first, np.ndarray) else 0), digest.hexdigest()[:16]


def _add(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(str((value.shape, value.dtype)).encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, dict):
        for key in sorted(value, key=repr):
            digest.update(repr(key).encode())
            _add(digest, value[key])
    elif isinstance(value, list | tuple):
        digest.update(str(len(value)).encode())
        for item in value:
            _add(digest, item)
    else:
        digest.update(repr(value).encode())


def _bag(path: Path, recover: bool, place: str = "bag") -> Any:
    record = bags.read(path / place, _signals(), recover=recover)
    return [record.time, record.input, record.output, dict(record.channels)]


def _file(path: Path, recover: bool) -> Any:
    return _bag(path, recover, "bag.mcap")


def _model(path: Path, recover: bool) -> Any:
    model = load_model(path / "model")
    arrays = [model.system.values, model.system.weights, model.covariance]
    assert np.isfinite(model.system.values).all()
    if model.system.form == _shipped(model.rig).form:  # another would have to be compiled
        inputs = np.zeros((3, len(model.system.inputs)))
        simulate(model.system, np.zeros(len(model.system.states)), inputs, step=model.sampling.step)
    rest = [model.rig, model.structure, model.names, model.training_range, model.sampling, model.standard_errors]
    return [*arrays, *rest]


@cache
def _shipped(rig: str) -> System:
    return load_model(shipped(rig, "model")).system


def _policy(path: Path, recover: bool) -> Any:
    policy = policies.load(path / "policy")
    rest, preview = np.zeros(policy.inputs), np.zeros((policy.horizon, policy.outputs))
    answer = policy.control(np.zeros(policy.states), rest, rest, preview)
    assert np.isfinite(answer.input).all()
    made = policy.certificate
    certified = None if made is None else [made.rates, made.bounds, made.loops, made.mu("network")]
    return [answer.input, policy.problem, policy.layers, policy.output_map, policy.scale, certified]


def _rig(path: Path, recover: bool) -> Any:
    folder = path / "fuzzed_rig"
    rigs._LOADED.pop(folder.resolve(), None)
    rig = rigs.load(folder)
    for node in declarations():
        parameters(rig, node)
    assert np.isfinite(rig.limits).all()
    return [rig.content, rig.bias, rig.limits, repr(rig.experiments), repr(rig.references), repr(rig.signals)]


@lru_cache(maxsize=1)
def _signals() -> Signals:
    return rigs.load(RIG).signals


def _written(write: Callable[[Path], object]) -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "bag")
        return _folder(Path(folder) / "bag", "bag")


def _folder(path: Path, name: str) -> Files:
    return {f"{name}/{file.name}": file.read_bytes() for file in sorted(path.iterdir()) if file.is_file()}


def _series() -> list[bags.Series]:
    """Topics as the rig's signals want them."""
    rig, k = rigs.load(RIG), np.arange(SAMPLES)
    stamps = START + STEP * k
    joints = rig.joints
    names = list(joints.names)
    numbers = np.sin(0.01 * k[:, None] * (1 + np.arange(len(names))))
    topic = rig.signals.topic(rig.signals.output[0])
    series = [bags.joint_states(topic, stamps, names, position=numbers, velocity=numbers, effort=numbers)]
    reference = numbers[:, None, :]
    place = f"/{rig.namespace}/reference"
    return [*series, bags.joint_trajectories(place, stamps, names, positions=reference, times=[0.0])]


def _by_rosbags(plugin: StoragePlugin, mode: CompressionMode | None, path: Path) -> None:
    writer = Writer(path, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        for series in _series():
            connection = writer.add_connection(series.topic, series.type, typestore=jazzy_types())
            for stamp, data in zip(series.stamps.tolist(), series.messages(), strict=True):
                writer.write(connection, stamp, data)


def _changed(files: Files, change: Callable[[list[records.Record]], list[records.Record]]) -> Files:
    name = next(name for name in files if name.endswith(".mcap"))
    return {**files, name: records.file_of(change(records.split(files[name])))}


def _by_lz4(found: list[records.Record]) -> list[records.Record]:
    return [
        (code, records.chunk_of("lz4", records.joined(records.inside(content)[1])) if code == CHUNK else content)
        for code, content in found
    ]


def _loose(found: list[records.Record]) -> list[records.Record]:
    """Messages without chunks, checksums or summary."""
    kept = []
    for code, content in found:
        kept += records.inside(content)[1] if code == CHUNK else [(code, content)] * (code in (0x01, DATA_END))
    return kept


def subjects() -> list[Subject]:
    """All of them; the bags are made anew, the same ones each time."""
    series = _series()
    plain = _written(lambda path: bags.write_bag(path, series, compression=""))
    packed = _written(lambda path: bags.write_bag(path, series))
    by_rosbags = {
        "bag.sqlite": (StoragePlugin.SQLITE3, None),
        "bag.packed_file": (StoragePlugin.MCAP, CompressionMode.FILE),
        "bag.packed_messages": (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    }
    kinds = {
        "bag.zstd": (packed, True),
        "bag.plain": (plain, True),
        "bag.lz4": (_changed(packed, _by_lz4), True),
        "bag.loose": (_changed(plain, _loose), False),
        **{name: (_written(partial(_by_rosbags, *how)), False) for name, how in by_rosbags.items()},
    }
    found = [
        Subject(name=name, files=files, targets=tuple(files), read=_bag, sealed=sealed)
        for name, (files, sealed) in kinds.items()
    ]
    single = {"bag.mcap": next(content for name, content in packed.items() if name.endswith(".mcap"))}
    found.append(Subject(name="bag.file", files=single, targets=tuple(single), read=_file))
    trained = ROOT / "trained"
    for rig in sorted(path.name for path in trained.iterdir()):
        model, policy = _folder(trained / rig / "model", "model"), _folder(trained / rig / "policy", "policy")
        found.append(Subject(name=f"model.{rig}", files=model, targets=tuple(model), read=_model))
        found.append(Subject(name=f"policy.{rig}", files=policy, targets=tuple(policy), read=_policy))
    home = ROOT / "hybrid_sysid_ros" / "rigs" / RIG
    rig_files = {f"fuzzed_rig/{name}": (home / name).read_bytes() for name in ("rig.yaml", "system.py")}
    found.append(Subject(name="rig", files=rig_files, targets=("fuzzed_rig/rig.yaml",), read=_rig, sealed=False))
    signals = {"signals.yaml": SIGNALS.encode()}
    found.append(Subject(name="signals", files=signals, targets=("signals.yaml",), read=_load_signals, sealed=False))
    return found


def _load_signals(path: Path, recover: bool) -> Any:
    return [repr(Signals.load(path / "signals.yaml")), read_mapping(path / "signals.yaml")]


SIGNALS = """namespace: arm
signals:
  period: 0.005
  inputs:
    torque: {topic: joint_states, field: "effort[motor]", unit: N m, scale: 1.0, holds: preceding}
  outputs:
    motor: {topic: joint_states, field: "position[motor]", unit: rad, offset: 0.0}
    link: {topic: joint_states, field: "position[link]", unit: rad, scale: 1e-3}
  channels:
    reference: {topic: reference, field: "points[0].positions[link]"}
"""
