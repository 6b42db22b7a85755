"""Files of measurement systems: MF4 (dSPACE, Vector, ETAS), TDMS (LabVIEW), ULog (PX4)."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.importing.log_file import LARGEST, LogColumn, LogFile
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

MASTERS = (2, 3)
"""Types of channels with times."""
ULOG_SHARE = 8
"""Numbers in memory per byte of a ULog file, at most."""


class Mf4File(LogFile):
    """An ASAM MDF file; each group of channels has its own times, which are called GROUP.time."""

    def __init__(self, path: Path) -> None:
        self._places: dict[str, tuple[int, int]] = {}
        super().__init__(path, self._listed(path))

    def _listed(self, path: Path) -> Iterator[LogColumn]:
        with _mdf(path) as file:
            for number, group in enumerate(file.groups):
                samples, master = int(group.channel_group.cycles_nr), file.masters_db.get(number)
                times = f"group_{number}.time" if master is not None else ""
                if master is not None:
                    self._places[times] = number, master
                    yield LogColumn(name=times, samples=samples, unit="s")
                for index, channel in enumerate(group.channels):
                    if index == master or channel.channel_type in MASTERS:
                        continue
                    name = channel.name if channel.name not in self._places else f"group_{number}.{channel.name}"
                    self._places[name] = number, index
                    yield LogColumn(name=name, samples=samples, unit=str(channel.unit or ""), time=times)

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        found = {}
        with _mdf(self.path) as file:
            for name in names:
                group, index = self._places[name]
                if index == file.masters_db.get(group):
                    found[name] = file.get_master(group)
                    continue
                values = file.get(group=group, index=index).samples
                if values.dtype.kind not in "fiub" or values.ndim != 1:
                    raise UserError(f"{self.path}: {name} holds no single numbers; name another channel")
                found[name] = values
        return found


def _mdf(path: Path) -> Any:
    """An open file. What is left of a damaged one fails once more where it is removed, which nobody need read."""
    from asammdf import MDF

    usual, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        return MDF(path)
    except Exception as error:
        problem = str(error) or type(error).__name__
    finally:
        gc.collect()
        sys.unraisablehook = usual
    raise ValueError(problem)


class TdmsFile(LogFile):
    """A LabVIEW file; a channel of a waveform has times of its own, which are called GROUP.CHANNEL.time."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, self._listed(path))

    def _listed(self, path: Path) -> Iterator[LogColumn]:
        from nptdms import TdmsFile as Reader
        from nptdms.log import log_manager

        log_manager.set_level(logging.ERROR)  # a recording that was cut is read up to its end

        with Reader.open(path) as file:
            several = len(file.groups()) > 1
            tracks = dict[tuple[float, float, int], str]()
            for group in file.groups():
                for channel in group.channels():
                    if channel.dtype is None or np.dtype(channel.dtype).kind not in "fiubM":
                        continue
                    name = f"{group.name}.{channel.name}" if several else channel.name
                    unit = str(channel.properties.get("unit_string", ""))
                    step = channel.properties.get("wf_increment", 0.0)
                    track = (float(step), float(channel.properties.get("wf_start_offset", 0.0)), len(channel))
                    if step and track not in tracks:
                        tracks[track] = f"{name}.time"
                        yield LogColumn(name=tracks[track], samples=len(channel), unit="s")
                    unit = "s" if np.dtype(channel.dtype).kind == "M" else unit
                    yield LogColumn(name=name, samples=len(channel), unit=unit, time=tracks.get(track, ""))

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        from nptdms import TdmsFile as Reader

        found = {}
        with Reader.open(self.path) as file:
            several = len(file.groups()) > 1
            for group in file.groups():
                for channel in group.channels():
                    name = f"{group.name}.{channel.name}" if several else channel.name
                    if f"{name}.time" in names:
                        found[f"{name}.time"] = channel.time_track()
                    if name in names:
                        values = channel[:]
                        if values.dtype.kind == "M":
                            values = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
                        found[name] = values
        return found


class UlogFile(LogFile):
    """A PX4 log; columns are called TOPIC.FIELD, those of a second instance TOPIC_1.FIELD."""

    def __init__(self, path: Path) -> None:
        from pyulog import ULog

        if path.stat().st_size * ULOG_SHARE > 8 * LARGEST:
            raise UserError(
                f"{path}: is larger than what is read at once; turn the topics that you need into CSV by ulog2csv -m"
            )
        self._data: dict[str, Array] = {}
        columns = []
        for topic in ULog(str(path)).data_list:
            prefix = topic.name if not topic.multi_id else f"{topic.name}_{topic.multi_id}"
            for field, values in topic.data.items():
                if values.dtype.kind not in "fiub":
                    continue
                times = "" if field == "timestamp" else f"{prefix}.timestamp"
                unit = "us" if field.startswith("timestamp") else ""
                columns.append(LogColumn(name=f"{prefix}.{field}", samples=len(values), unit=unit, time=times))
                self._data[f"{prefix}.{field}"] = values
        super().__init__(path, columns)

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        return {name: self._data[name] for name in names}
