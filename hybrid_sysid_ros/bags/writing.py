"""Writing: rosbag2 folders of ROS 2 Jazzy's default kind (metadata.yaml and one MCAP file), without ROS."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

from hybrid_sysid_ros.bags.bag import markers
from hybrid_sysid_ros.bags.mcap import CHECKSUM_PLACE
from hybrid_sysid_ros.bags.series import Series, jazzy_types
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_folder


class BagWriter:
    """Write a bag, message by message, as a context.

    It grows in a temporary folder beside `path`, which takes its place when the context ends well: a bag is whole or
    not there. What cannot be had again is written by a :class:`Recording`.

    compressed: pack the chunks of the MCAP file with zstd, which every MCAP reader unpacks.
    replace: replace a bag that exists there.
    notes: text by key for the metadata (custom_data), such as where the data came from.

    Raises UserError when the place cannot be written or is taken.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        compressed: bool = True,
        replace: bool = False,
        notes: Mapping[str, str] | None = None,
    ) -> None:
        self.path = Path(path)
        self.messages = 0
        self._compressed = compressed
        self._replace = replace
        self._notes = dict(notes or {})
        self._stack = ExitStack()
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> BagWriter:
        with ExitStack() as stack:
            place = written_folder(self.path, marker=markers(self.path), replace=self._replace)
            folder = stack.enter_context(place)
            folder.rmdir()  # the writer makes it
            stack.push(self._begin(folder))
            self._stack = stack.pop_all()
        return self

    def _begin(self, folder: Path) -> Writer:
        """Make the folder and begin to write in it."""
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        if self._compressed:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, text in self._notes.items():
            self._writer.set_custom_data(key, text)
        self._writer.open()
        self._storage.__class__ = _CheckedWriter
        if self._compressed:
            self._storage.compressor = _packed
        return self._writer

    @property
    def _storage(self) -> McapWriter:
        assert isinstance(self._writer.storage, McapWriter)
        return self._writer.storage

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def write_raw(self, topic: str, message_type: str, stamp: int, data: bytes | memoryview) -> None:
        """Write one serialised message (CDR, as a raw subscription of rclpy gives it).

        stamp: time of logging [ns].

        Raises:
            UserError: ROS 2 Jazzy has no such message type, or the topic had another type before.
        """
        connection = self._connections.get(topic)
        if connection is None or connection.msgtype != message_type:
            connection = self._connection(topic, message_type)
        self._writer.write(connection, stamp, data)
        self.messages += 1

    def flush(self) -> None:
        """End a chunk of the file here."""
        if self._storage.chunk.msgs:
            self._storage.close_chunk()

    def _connection(self, topic: str, message_type: str) -> Connection:
        package, _, name = message_type.rpartition("/")
        full = message_type if package.endswith("/msg") else f"{package}/msg/{name}"
        if topic in self._connections:
            if self._connections[topic].msgtype == full:
                return self._connections[topic]
            raise UserError(
                f"{self.path}: topic {topic} has type {self._connections[topic].msgtype}, not {full} as well"
            )
        if full not in jazzy_types().fielddefs:
            raise UserError(f"{self.path}: topic {topic}: message type {message_type!r} is not one of ROS 2 Jazzy")
        self._connections[topic] = self._writer.add_connection(topic, full, typestore=jazzy_types())
        return self._connections[topic]


class _CheckedWriter(McapWriter):
    """Gives each chunk its checksum, which rosbags leaves out."""

    def close_chunk(self) -> None:
        checksum, start = zlib.crc32(self.chunk.bio.getbuffer()), self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + CHECKSUM_PLACE)
        self.bio.write(checksum.to_bytes(4, "little"))
        self.bio.seek(end)


def _packed(chunk: bytes) -> bytes:
    """Pack a chunk with zstd and a checksum, so that no reader takes damaged bytes for measurements."""
    return zstd.compress(chunk, options={zstd.CompressionParameter.checksum_flag: 1})


def write(
    path: Path | str,
    topics: Sequence[Series],
    *,
    compressed: bool = True,
    replace: bool = False,
    notes: Mapping[str, str] | None = None,
) -> Path:
    """Write a bag of whole series, in the order of their stamps.

    Raises:
        UserError: the place cannot be written, or holds something that may not be replaced.
    """
    with BagWriter(path, compressed=compressed, replace=replace, notes=notes) as writer:
        stamps = np.concatenate([one.stamps for one in topics])
        owner = np.repeat(np.arange(len(topics)), [len(one.stamps) for one in topics])
        following = [one.messages() for one in topics]
        order = np.argsort(stamps, kind="stable")
        for stamp, number in zip(stamps[order].tolist(), owner[order].tolist(), strict=True):
            writer.write_raw(topics[number].topic, topics[number].type, stamp, next(following[number]))
    return Path(path)
