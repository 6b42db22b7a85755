"""Storage: MCAP files that are written block by block, and the quality of service of their topics."""

from __future__ import annotations

import errno
import os
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import yaml
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, DataEnd, Footer, Message
from mcap.writer import CompressionType, Writer

from hybrid_sysid_ros.bags.layout import jazzy_types
from hybrid_sysid_ros.bags.mcap import MAGIC
from hybrid_sysid_ros.bags.quality_of_service import QualityOfService


class DurableFile:
    """A file that grows by blocks: each block is on the disk as a whole or not at all, whatever fails.

    While it grows it has a provisional end, which the next block replaces: so it is whole between two blocks, even if
    it is never closed. It has write(), flush() and tell(), as a library needs that writes to a file.
    """

    def __init__(self, path: Path, *, end: bytes) -> None:
        """path: the file, which is made with its first block. end: its provisional end."""
        self._path, self._end = path, end
        self._descriptor: int | None = None
        self._size = 0  # without the end
        self._pending = bytearray()

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Write into the block that sync() puts on the disk."""
        self._pending += data
        return len(data)

    def flush(self) -> None:
        """Do nothing: blocks are put on the disk by sync()."""

    def tell(self) -> int:
        """The position of the next byte."""
        return self._size + len(self._pending)

    def sync(self, *, whole: bool = False) -> None:
        """Write the block to the disk. whole: it contains the file's real end. Raises OSError where that fails; then
        the file stays as it was, and the call may be repeated.
        """
        if self._descriptor is None:
            self._descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        if not os.fstat(self._descriptor).st_nlink:
            raise OSError(errno.ENOENT, "somebody has removed it")
        try:
            self._put(self._descriptor, bytes(self._pending) + (b"" if whole else self._end))
            os.fsync(self._descriptor)
        except OSError:
            with suppress(OSError):  # the end goes where it was, so it needs no room
                self._put(self._descriptor, self._end if self._size else b"")
            raise
        self._size += len(self._pending)
        self._pending.clear()

    def close(self) -> None:
        """Close the file as it is on the disk; a file without a block is removed."""
        if self._descriptor is None:
            return
        os.close(self._descriptor)
        if not self._size:
            with suppress(OSError):
                self._path.unlink()

    def _put(self, descriptor: int, data: bytes) -> None:
        """Replace everything behind the blocks on the disk."""
        written = 0
        while written < len(data):
            written += os.pwrite(descriptor, data[written:], self._size + written)
        os.ftruncate(descriptor, self._size + len(data))


def sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk. Raises OSError where that fails."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


CHUNK = 1 << 20  # bytes of messages that are compressed together, unless flush() is called before
DISTRIBUTION = "jazzy"
Compression = Literal["zstd", "lz4", ""]
"""Compression of chunks; "": none."""
PLACE, PART = "_Writer__chunk_indices", "_Writer__chunk_builder"
"""Attributes in which the mcap library collects the index of a file, and the messages of a chunk."""
MESSAGE, ENTRY = struct.Struct("<BQHIQQ"), struct.Struct("<QQ")
"""Head of a message, and its entry in a chunk's index, as the format has them."""
HEAD = 22
"""Bytes of a message's head behind its length."""


@dataclass(frozen=True, kw_only=True)
class OfferedTopic:
    """A topic as its publishers offer it: its message type of ROS 2 Jazzy, and the quality of service of each."""

    topic: str
    type: str
    qualities: Sequence[QualityOfService] = ()

    @cached_property
    def definition(self) -> str:
        """The definition of the message type, with all types in it."""
        text, _ = jazzy_types().generate_msgdef(self.type, ros_version=2)
        return text

    @cached_property
    def hash(self) -> str:
        """The message type's hash (REP 2016)."""
        return jazzy_types().hash_rihs01(self.type)

    @property
    def profiles(self) -> list[dict[str, Any]]:
        """The qualities of service in rosbag2's terms."""
        return [quality.description for quality in self.qualities]


@dataclass(frozen=True, kw_only=True)
class Extent:
    """Content of a file: number of messages by topic, and the times of logging of the first and the last [ns]."""

    name: str
    counts: Counter[str]
    first: int
    last: int


class ChunkIndices:
    """Indices of a file's chunks in the form in which they are stored, 150 bytes each. The library's own objects take a
    kilobyte each: 15 MB an hour for a recording that is flushed four times a second.
    """

    def __init__(self) -> None:
        self._records = bytearray()

    def append(self, index: ChunkIndex) -> None:
        builder = RecordBuilder()
        index.write(builder)
        self._records += builder.end()

    def __iter__(self) -> Iterator[ChunkIndices]:
        yield self

    def write(self, builder: RecordBuilder) -> None:
        """Write all indices at once."""
        builder.write(self._records)


@dataclass(eq=False)
class PackedIndex:
    """Index of a channel's messages in a chunk, in the form in which it is stored."""

    channel: int
    entries: bytearray = field(default_factory=bytearray)

    def write(self, builder: RecordBuilder) -> None:
        builder.start_record(Opcode.MESSAGE_INDEX)
        builder.write2(self.channel)
        builder.write4(len(self.entries))
        builder.write(self.entries)
        builder.finish_record()


class PackedChunk:
    """Adds messages to a chunk of the library, each packed at once: field by field it takes twice as long."""

    def __init__(self, chunk: Any) -> None:
        self._chunk = chunk

    def __call__(self, message: Message) -> None:
        chunk, logged = self._chunk, message.log_time
        chunk.message_start_time = min(chunk.message_start_time, logged) if chunk.num_messages else logged
        chunk.message_end_time = max(chunk.message_end_time, logged)
        index = chunk.message_indices.get(message.channel_id)
        if index is None:
            index = chunk.message_indices[message.channel_id] = PackedIndex(message.channel_id)
        index.entries += ENTRY.pack(logged, chunk.record_writer.count)
        numbers = message.channel_id, message.sequence, logged, message.publish_time
        chunk.record_writer.write(MESSAGE.pack(Opcode.MESSAGE, HEAD + len(message.data), *numbers))
        chunk.record_writer.write(message.data)
        chunk.num_messages += 1


class Storage:
    """An MCAP file that is being written; its name is relative to the bag's folder."""

    def __init__(self, name: str, stream: Any, *, compression: Compression) -> None:
        """stream: the file, with write(), flush() and tell(). compression: that of the chunks."""
        self.name = name
        self.counts: Counter[str] = Counter()
        self.first = self.last = 0
        self.stream = stream
        self._writer = Writer(stream, chunk_size=CHUNK, compression=CompressionType[compression.upper() or "NONE"])
        if hasattr(self._writer, PLACE):
            setattr(self._writer, PLACE, ChunkIndices())
        if (chunk := getattr(self._writer, PART, None)) is not None:
            chunk.add_message = PackedChunk(chunk)
        self._writer.start(profile="ros2")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    @property
    def extent(self) -> Extent:
        """The content so far."""
        return Extent(name=self.name, counts=self.counts.copy(), first=self.first, last=self.last)

    def write(self, offer: OfferedTopic, logged: int, published: int, data: bytes | memoryview) -> None:
        """Write one serialised message (CDR) with the times at which it was logged and published [ns]."""
        channel = self._channels.get(offer.topic)
        if channel is None:
            channel = self._channel(offer)
        self._writer.add_message(channel, log_time=logged, data=data, publish_time=published)  # type: ignore[arg-type]
        self.first = min(self.first, logged) if self.counts else logged
        self.last = max(self.last, logged)
        self.counts[offer.topic] += 1

    def attach(self, name: str, data: bytes, logged: int) -> None:
        """Attach a file to the bag, with the time [ns] at which it was read."""
        self._writer.add_attachment(create_time=0, log_time=logged, name=name, media_type="", data=data)

    def flush(self) -> None:
        """End a chunk of the file here."""
        self._writer.flush()

    def finish(self, metadata: Callable[[Extent], str]) -> None:
        """Write the end of the file: its metadata, and the index of its chunks."""
        self.flush()
        entries = {"ROS_DISTRO": DISTRIBUTION, "serialized_metadata": metadata(self.extent)}
        self._writer.add_metadata("rosbag2", entries)
        self._writer.finish()

    def _channel(self, offer: OfferedTopic) -> int:
        if offer.type not in self._schemas:
            text = offer.definition.encode()
            self._schemas[offer.type] = self._writer.register_schema(offer.type, "ros2msg", text)
        profiles = yaml.safe_dump(offer.profiles, sort_keys=False).strip() if offer.qualities else ""
        entries = {"offered_qos_profiles": profiles, "topic_type_hash": offer.hash}
        number = self._writer.register_channel(offer.topic, "cdr", self._schemas[offer.type], entries)
        self._channels[offer.topic] = number
        return number


def provisional_end() -> bytes:
    """The shortest end of a file that the specification permits, without an index."""
    builder = RecordBuilder()
    DataEnd(data_section_crc=0).write(builder)
    Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
    return bytes(builder.end()) + MAGIC
