"""MCAP: the messages of a file, chunk by chunk, also of one that was cut or damaged (specification: mcap.dev/spec)."""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor
else:
    from backports.zstd import ZstdDecompressor

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F
BATCH = 1 << 20  # bytes of messages that lie outside chunks and are taken at once
_RECORD = struct.Struct("<BQ")  # code and size
_START = struct.Struct("<BQH4xQ8x")  # the same, and of a message its channel and time of logging
_CHUNK = struct.Struct("<16xQII")  # unpacked size, checksum, length of the compression's name


class DamagedError(ValueError):
    """The file is not what the specification says; the text says where."""


@dataclass(frozen=True, kw_only=True)
class Schema:
    """Name and definition of a message type; encoding is ros2msg or ros2idl."""

    name: str
    encoding: str
    text: str


@dataclass(kw_only=True)
class Batch:
    """Messages of one topic that follow one another, with the time at which each was logged [ns]."""

    logged: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


class McapFile:
    """One pass over an MCAP file. It holds one chunk at a time, whatever the size of the file.

    schemas: by topic, of the topics met so far.
    damage: what is wrong with the file, "" if nothing was met.
    """

    def __init__(self, path: Path, wanted: Collection[str] | None) -> None:
        """wanted: topics whose messages are taken; None for all."""
        self.path = path
        self.schemas: dict[str, Schema] = {}
        self.damage = ""
        self._wanted = wanted
        self._known: dict[int, Schema] = {}  # by the file's own numbers
        self._topics: dict[int, str] = {}
        self._batches: dict[int, Batch] = {}  # by channel; channels of one topic share theirs

    def batches(self) -> Iterator[dict[str, Batch]]:
        """Messages by topic, in the order of the file, up to its end or the first damage.

        A chunk that is cut is unpacked as far as it goes.
        """
        try:
            for content in self._contents():
                self._walk(content)
                yield self._taken()
        except (DamagedError, struct.error, UnicodeDecodeError) as error:
            self.damage = self.damage or str(error)
            yield self._taken()  # what came before is good

    def _contents(self) -> Iterator[bytes]:
        """Records outside of chunks, in runs, and those inside of each chunk."""
        end = self.path.stat().st_size
        loose = bytearray()
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
                    return
                if code == 0 or place + _RECORD.size + size > end:
                    self.damage = f"cut or damaged at byte {place}"
                if code == CHUNK:
                    inside, whole = _unpacked(stream.read(min(size, end)))
                    if not whole:
                        self.damage = f"chunk at byte {place} cut or damaged"
                    yield inside
                elif code in (SCHEMA, CHANNEL, MESSAGE) and not self.damage:
                    loose += head + stream.read(size)
                elif not self.damage:
                    stream.seek(size, 1)
                if self.damage:
                    break
        yield bytes(loose)
        self.damage = self.damage or "no end of the data"

    def _walk(self, content: bytes) -> None:
        """Take the records of a chunk."""
        position, end = 0, len(content)
        batches, unpack = self._batches, _START.unpack_from
        content += bytes(_START.size)  # the last record may be shorter
        while position + 9 <= end:
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
            elif code == SCHEMA:
                number, schema = _schema(content[start:position])
                self._known[number] = schema
            elif code == CHANNEL:
                self._add_channel(content[start:position])
        if position != end:
            raise DamagedError("cut record")

    def _add_channel(self, record: bytes) -> None:
        number, schema_number = struct.unpack_from("<HH", record)
        topic, _ = _text(record, 4)
        if number in self._topics or schema_number not in self._known:
            return
        self.schemas[topic] = self._known[schema_number]
        same = next((known for known, name in self._topics.items() if name == topic), None)
        self._topics[number] = topic
        if self._wanted is None or topic in self._wanted:
            self._batches[number] = Batch() if same is None else self._batches[same]

    def _taken(self) -> dict[str, Batch]:
        """Hand out the messages taken, and start anew."""
        taken = {self._topics[number]: batch for number, batch in self._batches.items()}
        fresh = {topic: Batch() for topic in taken}
        self._batches = {number: fresh[self._topics[number]] for number in self._batches}
        return {topic: batch for topic, batch in taken.items() if batch.data}


def _unpacked(chunk: bytes) -> tuple[bytes, bool]:
    """Records inside a chunk, as far as they can be unpacked, and whether that is all of them, undamaged."""
    if len(chunk) < 32:
        return b"", False
    size, checksum, length = _CHUNK.unpack_from(chunk)
    compression = chunk[32 : 32 + length].decode("ascii", "replace")
    packed = memoryview(chunk)[32 + length + 8 :]
    try:
        if compression == "zstd":
            inside = ZstdDecompressor().decompress(packed)
        elif compression == "lz4":
            inside = LZ4FrameDecompressor().decompress(packed)
        else:
            inside = bytes(packed)
    except Exception:  # zstd and lz4 each have an error of their own for damaged data
        return b"", False
    whole = len(inside) == size
    if whole and checksum and zlib.crc32(inside) != checksum:
        return b"", False
    return inside, whole


def _schema(record: bytes) -> tuple[int, Schema]:
    (number,) = struct.unpack_from("<H", record)
    name, position = _text(record, 2)
    encoding, position = _text(record, position)
    text, _ = _text(record, position)
    return number, Schema(name=name, encoding=encoding, text=text)


def _text(record: bytes, position: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", record, position)
    start = position + 4
    return record[start : start + length].decode(), start + length
