"""Recovery: the messages of an MCAP file that was cut, up to the cut (specification: mcap.dev/spec)."""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor
else:
    from backports.zstd import ZstdDecompressor

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F


@dataclass(frozen=True, kw_only=True)
class Schema:
    """Name and definition of a message type; encoding is ros2msg or ros2idl."""

    name: str
    encoding: str
    text: str


@dataclass(kw_only=True)
class Channel:
    """A topic as found: its type and its messages with the time at which they were logged [ns]."""

    topic: str
    schema: Schema
    stamps: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def recovered_channels(path: Path) -> list[Channel]:
    """Read what can be read of an MCAP file: every whole message before the first damage.

    A chunk that is cut is unpacked as far as it goes. The result is empty where nothing can be read.
    """
    content = path.read_bytes()
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    if not content.startswith(MAGIC):
        return []
    try:
        for code, record in _data_records(memoryview(content)[len(MAGIC) :]):
            if code == SCHEMA:
                number, schema = _schema(record)
                schemas[number] = schema
            elif code == CHANNEL:
                number, schema_number, topic = _channel(record)
                if number not in channels and schema_number in schemas:
                    channels[number] = Channel(topic=topic, schema=schemas[schema_number])
            elif code == MESSAGE:
                number, _, stamp, _ = struct.unpack_from("<HIQQ", record)
                if number in channels:
                    channels[number].stamps.append(stamp)
                    channels[number].data.append(bytes(record[22:]))
    except (struct.error, UnicodeDecodeError):
        pass  # damaged here: what came before is good
    return list(channels.values())


def _data_records(content: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Records of the data section, those inside chunks included, up to the first that is damaged."""
    for code, record, whole in _records(content):
        if code == DATA_END:
            return
        if code == CHUNK:
            inside, good = _unpacked(record)
            for inner_code, inner, inner_whole in _records(memoryview(inside)):
                if inner_whole:
                    yield inner_code, inner
            if not good:
                return
        elif whole:
            yield code, record


def _records(content: memoryview) -> Iterator[tuple[int, memoryview, bool]]:
    """Code and content of each record, and whether it is whole: the last may be cut."""
    position = 0
    while position + 9 <= len(content):
        code, size = struct.unpack_from("<BQ", content, position)
        record = content[position + 9 : position + 9 + size]
        yield code, record, len(record) == size
        position += 9 + size


def _unpacked(chunk: memoryview) -> tuple[bytes, bool]:
    """Records inside a chunk, as far as they can be unpacked, and whether that is all of them, undamaged."""
    if len(chunk) < 32:
        return b"", False
    size, checksum, length = struct.unpack_from("<QII", chunk, 16)
    compression = bytes(chunk[32 : 32 + length]).decode("ascii", "replace")
    packed = chunk[32 + length + 8 :]
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


def _schema(record: memoryview) -> tuple[int, Schema]:
    (number,) = struct.unpack_from("<H", record)
    name, position = _text(record, 2)
    encoding, position = _text(record, position)
    text, _ = _text(record, position)
    return number, Schema(name=name, encoding=encoding, text=text)


def _channel(record: memoryview) -> tuple[int, int, str]:
    number, schema_number = struct.unpack_from("<HH", record)
    topic, _ = _text(record, 4)
    return number, schema_number, topic


def _text(record: memoryview, position: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", record, position)
    start = position + 4
    return bytes(record[start : start + length]).decode(), start + length
