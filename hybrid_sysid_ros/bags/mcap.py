"""MCAP: the messages of a file, chunk by chunk, even of a cut or damaged one (specification: mcap.dev/spec)."""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor
else:
    from backports.zstd import ZstdDecompressor

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, STATISTICS, DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0B, 0x0F
BATCH = 1 << 20  # bytes of messages outside chunks that are read at once
PIECE = 1 << 21  # bytes of a chunk whose messages are handed out together
LARGEST_CHUNK = 1 << 26  # bytes that a packed chunk may unpack to; recorders make chunks of some 1 MB
LONGEST_MESSAGE = 1 << 22  # bytes of a message that signals are read from
LARGEST_RECORD = 1 << 20  # bytes of a record that is no message: definitions of types, names
_RECORD = struct.Struct("<BQ")  # code and size
_START = struct.Struct("<BQH4xQ8x")  # the same, and of a message its channel and time of logging
_CHUNK = struct.Struct("<16xQII")  # unpacked size, checksum, length of the compression's name
_FOOTER = struct.Struct("<BQQQI")  # code, size, where the summary begins and its second part, checksum
_STATISTICS = struct.Struct("<QHIIIIQQI")  # messages, schemas, channels, -, -, chunks, -, -, bytes of the table behind
_COUNT = struct.Struct("<HQ")  # channel and its messages


class DamagedError(ValueError):
    """The file violates the specification; the text says where."""


@dataclass(frozen=True, kw_only=True)
class Schema:
    """Name and definition of a message type; encoding is ros2msg or ros2idl, "" where there is no definition."""

    name: str
    encoding: str = ""
    text: str = ""


@dataclass(kw_only=True)
class Batch:
    """Messages of one topic that follow one another, with the time at which each was logged [ns]."""

    logged: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


@dataclass(kw_only=True)
class Stated:
    """Content that a file states, or that was found in it: schemas and numbers of messages by topic, and the numbers of
    all messages and chunks; None where they are not stated.
    """

    schemas: dict[str, Schema] = field(default_factory=dict)
    counts: dict[str, int] | None = None
    messages: int | None = None
    chunks: int | None = None


class _Channels:
    """Schemas and channels of a file, by their numbers in the file."""

    def __init__(self) -> None:
        self.known: dict[int, Schema] = {}
        self.topics: dict[int, str] = {}
        self.schemas: dict[str, Schema] = {}

    def add_schema(self, record: bytes) -> None:
        (number,) = struct.unpack_from("<H", record)
        name, position = _text(record, 2)
        encoding, position = _text(record, position)
        text, _ = _text(record, position)
        self.known[number] = Schema(name=name, encoding=encoding, text=text)

    def add_channel(self, record: bytes) -> int | None:
        """The channel's number if it is a new one."""
        number, schema_number = struct.unpack_from("<HH", record)
        if number in self.topics:
            return None
        topic, _ = _text(record, 4)
        if schema_number and schema_number not in self.known:
            raise DamagedError(f"topic {topic} has no type")
        self.topics[number] = topic
        self.schemas[topic] = self.known.get(schema_number, Schema(name="unknown"))
        return int(number)


class McapFile:
    """One pass over an MCAP file. It keeps one chunk at a time in memory, whatever the size of the file.

    schemas: schemas by topic, as far as the pass has come.
    damage: what is wrong with the file, "" if nothing was found.
    """

    def __init__(self, path: Path, wanted: Collection[str] | None) -> None:
        """wanted: topics whose messages are taken; None for all."""
        self.path = path
        self.damage = ""
        self._wanted = wanted
        self._channels = _Channels()
        self._held: dict[str, Batch] = {}
        self._batches: dict[int, Batch] = {}  # the same by channel; channels of one topic share theirs
        self._counts: dict[str, int] = {}
        self._others = self._chunks = 0

    @property
    def schemas(self) -> dict[str, Schema]:
        return self._channels.schemas

    @property
    def found(self) -> Stated:
        """The content found so far, with counts of the wanted topics."""
        return Stated(
            schemas=self.schemas,
            counts={**dict.fromkeys(self._wanted or (), 0), **self._counts},
            messages=sum(self._counts.values()) + self._others,
            chunks=self._chunks,
        )

    def batches(self) -> Iterator[dict[str, Batch]]:
        """Messages by topic, in the order of the file, up to its end or the first damage.

        A cut chunk is unpacked up to the cut.
        """
        try:
            for content in self._contents():
                yield from self._walk(content)
        except (DamagedError, struct.error, UnicodeDecodeError) as error:
            self.damage = self.damage or str(error)
            yield self._taken()  # what came before is good

    def _contents(self) -> Iterator[bytes]:
        """Records outside chunks, several at once, and the records of each chunk."""
        end = self.path.stat().st_size
        loose, any_loose = bytearray(), False
        with self.path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise DamagedError("no MCAP file")
            while True:
                place = stream.tell()
                head = stream.read(_RECORD.size)
                if len(head) < _RECORD.size:
                    break
                code, size = _RECORD.unpack(head)
                if code in (CHUNK, DATA_END) or len(loose) > BATCH:
                    yield bytes(loose)
                    loose.clear()
                if code == DATA_END:
                    if any_loose:  # records in chunks have their chunk's checksum
                        _check_sum(stream, 0, place, struct.unpack("<I", stream.read(4))[0], "data")
                    return
                if code == 0 or place + _RECORD.size + size > end:
                    self.damage = f"cut or damaged at byte {place}"
                if code == CHUNK:
                    inside, self.damage = _unpacked(stream, min(size, end - place - _RECORD.size), place)
                    self._chunks += 1
                    yield inside
                elif code in (SCHEMA, CHANNEL, MESSAGE) and not self.damage:
                    loose += head + stream.read(size)
                    any_loose = True
                elif not self.damage:
                    stream.seek(size, 1)
                if self.damage:
                    break
        yield bytes(loose)
        self.damage = self.damage or "no end of the data"

    def _walk(self, content: bytes) -> Iterator[dict[str, Batch]]:
        """Messages of a chunk, in pieces, since they take more memory as objects."""
        position, last = 0, len(content) - _START.size
        while position <= last:
            position = self._records(content, position, len(content), min(last, position + PIECE))
            yield self._taken()
        rest = content[position:]  # the last record may be shorter than the start of a message
        if self._records(rest + bytes(_START.size), 0, len(rest), len(rest) - _RECORD.size) != len(rest):
            raise DamagedError("cut record")
        yield self._taken()

    def _records(self, content: bytes, position: int, end: int, last: int) -> int:
        """Take the records from a position on that begin at `last` or before, and return where the next one begins."""
        others = 0
        batches, unpack = self._batches, _START.unpack_from
        while position <= last:
            code, size, number, stamp = unpack(content, position)
            start = position + 9
            position = start + size
            if position > end:
                raise DamagedError("cut record")
            if code == MESSAGE:
                if number in batches:
                    batch = batches[number]
                    batch.logged.append(stamp)
                    batch.data.append(content[start + 22 : position])
                else:
                    others += 1
            elif code == SCHEMA:
                self._channels.add_schema(_small(content, start, size))
            elif code == CHANNEL:
                self._add_channel(_small(content, start, size))
        self._others += others
        return position

    def _add_channel(self, record: bytes) -> None:
        number = self._channels.add_channel(record)
        if number is None:
            return
        topic = self._channels.topics[number]
        if self._wanted is None or topic in self._wanted:
            self._batches[number] = self._held.setdefault(topic, Batch())

    def _taken(self) -> dict[str, Batch]:
        """Return the messages collected so far, and start a new collection."""
        taken = {}
        for topic, batch in self._held.items():
            if batch.data:
                taken[topic] = Batch(logged=batch.logged, data=batch.data)
                self._counts[topic] = self._counts.get(topic, 0) + len(batch.data)
                batch.logged, batch.data = [], []
        return taken


def stated(path: Path) -> Stated:
    """The content that the summary of a file states; None for what it does not state.

    Raises DamagedError where the summary or the file's end are damaged.
    """
    channels, found = _Channels(), Stated()
    by_number, count = dict[int, int](), 0  # the latter is that of channels
    with path.open("rb") as stream:
        end = path.stat().st_size - len(MAGIC) - _FOOTER.size
        if end < len(MAGIC):
            raise DamagedError("no footer")
        stream.seek(end)
        code, size, start, _, checksum = _FOOTER.unpack(stream.read(_FOOTER.size))
        if code != FOOTER or size != 20 or (start and not len(MAGIC) <= start <= end):
            raise DamagedError("no footer")
        if not start:
            return found
        _check_sum(stream, start, end + _FOOTER.size - 4, checksum, "summary")
        stream.seek(start)
        while stream.tell() < end:
            code, size = _RECORD.unpack(stream.read(_RECORD.size))
            if stream.tell() + size > end:
                raise DamagedError("cut summary")
            if code not in (SCHEMA, CHANNEL, STATISTICS):
                stream.seek(size, 1)
                continue
            record = _small(stream.read(min(size, LARGEST_RECORD + 1)), 0, size)
            if code == SCHEMA:
                channels.add_schema(record)
            elif code == CHANNEL:
                channels.add_channel(record)
            else:
                found.messages, _, count, _, _, found.chunks, _, _, table = _STATISTICS.unpack_from(record)
                by_number = dict(_COUNT.iter_unpack(record[_STATISTICS.size : _STATISTICS.size + table]))
    found.schemas = channels.schemas
    if found.messages is None:
        return found
    if len(channels.topics) not in (0, count):  # a file need not repeat them behind its data
        raise DamagedError(f"the summary counts {count} channels and lists {len(channels.topics)}")
    if sum(by_number.values()) == found.messages and set(by_number) <= set(channels.topics):
        found.counts = dict.fromkeys(channels.schemas, 0)
        for number, count in by_number.items():
            found.counts[channels.topics[number]] += count
    elif by_number and channels.topics:
        raise DamagedError("the numbers of messages in the summary contradict each other")
    return found


def unpacked(packed: bytes | memoryview, limit: int) -> bytes:
    """Bytes that zstd compressed, at most one more than the limit."""
    return ZstdDecompressor().decompress(packed, limit + 1)


def _unpacked(stream: BinaryIO, length: int, place: int) -> tuple[bytes, str]:
    """The records of the next chunk as far as they can be unpacked, and its damage, if any.

    At most the chunk's stated size is unpacked, and at most LARGEST_CHUNK.
    """
    damage = f"the chunk at byte {place} is cut or damaged"
    chunk = stream.read(length)
    if len(chunk) < 32:
        return b"", damage
    size, checksum, name = _CHUNK.unpack_from(chunk)
    compression = chunk[32 : 32 + name].decode("ascii", "replace")
    packed = memoryview(chunk)[32 + name + 8 :]
    if compression and size > LARGEST_CHUNK:
        return b"", f"chunk at byte {place} says it unpacks to {size} bytes, of at most {LARGEST_CHUNK}"
    try:
        if compression == "zstd":
            inside = unpacked(packed, size)
        elif compression == "lz4":
            inside = LZ4FrameDecompressor().decompress(packed, size + 1)
        elif not compression:
            inside = bytes(packed)
        else:
            return b"", f"chunk at byte {place} is packed by {compression[:20]!r}, not by zstd or lz4"
    except Exception:  # zstd and lz4 each have an error of their own for damaged data
        return b"", damage
    if len(inside) > size:
        return b"", f"chunk at byte {place} holds more than the {size} bytes that it says"
    if len(inside) == size and checksum and zlib.crc32(inside) != checksum:
        return b"", damage
    return inside, "" if len(inside) == size else damage


def _check_sum(stream: BinaryIO, start: int, end: int, checksum: int, what: str) -> None:
    """Raise DamagedError where the bytes from start to end have another CRC; a CRC of 0 means that none was stored."""
    stream.seek(start)
    found, left = 0, end - start
    while checksum and left > 0:
        part = stream.read(min(left, BATCH))
        found, left = zlib.crc32(part, found), left - max(len(part), 1)
    if checksum and found != checksum:
        raise DamagedError(f"{what} damaged: its checksum differs")


def _small(content: bytes, start: int, size: int) -> bytes:
    if size > LARGEST_RECORD:
        raise DamagedError(f"a definition of {size} bytes")
    return content[start : start + size]


def _text(record: bytes, position: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", record, position)
    start = position + 4
    if start + length > len(record):
        raise DamagedError("cut text")
    return record[start : start + length].decode(), start + length
