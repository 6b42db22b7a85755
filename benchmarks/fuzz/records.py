"""Records of an MCAP file, taken apart and put together again with lengths, offsets and checksums that fit."""

from __future__ import annotations

import struct
import sys
import zlib
from collections import Counter

import lz4.frame  # type: ignore[import-untyped]

from hybrid_sysid_ros.bags.mcap import CHANNEL, CHUNK, DATA_END, FOOTER, MAGIC, MESSAGE, SCHEMA, STATISTICS

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Record = tuple[int, bytes]
"""Code and content."""


def split(content: bytes, start: int = len(MAGIC)) -> list[Record]:
    """Records of a file, or with start=0 of a chunk's content."""
    found, position, end = [], start, len(content) - start
    while position < end:
        code, size = struct.unpack_from("<BQ", content, position)
        found.append((code, content[position + 9 : position + 9 + size]))
        position += 9 + size
    return found


def joined(records: list[Record]) -> bytes:
    """Records one after the other."""
    return b"".join(struct.pack("<BQ", code, len(content)) + content for code, content in records)


def file_of(records: list[Record]) -> bytes:
    """A file of these records; the footer points to the summary behind the end of the data, if there is one."""
    codes = [code for code, _ in records]
    kept = [record for record in records if record[0] != FOOTER]
    data = kept[: codes.index(DATA_END) + 1] if DATA_END in codes else kept
    start = len(MAGIC) + len(joined(data)) if len(kept) > len(data) else 0
    return MAGIC + joined([*kept, (FOOTER, struct.pack("<QQI", start, 0, 0))]) + MAGIC


def inside(chunk: bytes) -> tuple[str, list[Record]]:
    """Compression and records of a chunk."""
    (name,) = struct.unpack_from("<I", chunk, 28)
    compression, packed = chunk[32 : 32 + name].decode(), chunk[40 + name :]
    unpack = {"zstd": zstd.decompress, "lz4": lz4.frame.decompress, "": bytes}[compression]
    return compression, split(unpack(packed), 0)


def chunk_of(compression: str, content: bytes, *, size: int | None = None, checksum: int | None = None) -> bytes:
    """A chunk's record. size, checksum: what it says it holds; None for the truth."""
    pack = {"zstd": zstd.compress, "lz4": lz4.frame.compress, "": bytes}[compression]
    return chunk_around(
        compression,
        pack(content),
        size=len(content) if size is None else size,
        checksum=zlib.crc32(content) if checksum is None else checksum,
    )


def chunk_around(compression: str, packed: bytes, *, size: int, checksum: int = 0) -> bytes:
    """A chunk's record of bytes that are packed already."""
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 1 << 62, size & (1 << 64) - 1, checksum, len(name))
    return head + name + struct.pack("<Q", len(packed)) + packed


def counted(records: list[Record]) -> list[Record]:
    """The same with statistics and a summary of what they hold."""
    data = [record for record in records if record[0] not in (SCHEMA, CHANNEL, STATISTICS, FOOTER, DATA_END)]
    data = [record for record in data if record[0] in (0x01, CHUNK, MESSAGE)]
    loose = [record for record in records if record[0] == CHUNK]
    inner = [one for code, content in loose for one in inside(content)[1]]
    named = list(dict.fromkeys(record for record in inner if record[0] in (SCHEMA, CHANNEL)))
    counts = Counter(content[:2] for code, content in inner if code == MESSAGE)
    table = b"".join(channel + struct.pack("<Q", count) for channel, count in sorted(counts.items()))
    channels = len({content[:2] for code, content in named if code == CHANNEL})
    head = struct.pack("<QHIIIIQQI", sum(counts.values()), 0, channels, 0, 0, len(loose), 0, 0, len(table))
    return [*data, (DATA_END, bytes(4)), *named, (STATISTICS, head + table)]


def text(content: str) -> bytes:
    """A text as records hold it."""
    return struct.pack("<I", len(content.encode())) + content.encode()


def schema(number: int, name: str, definition: str, encoding: str = "ros2msg") -> Record:
    """The record of a type."""
    return SCHEMA, struct.pack("<H", number) + text(name) + text(encoding) + text(definition)


def channel(number: int, schema_number: int, topic: str) -> Record:
    """The record of a topic."""
    return CHANNEL, struct.pack("<HH", number, schema_number) + text(topic) + text("cdr") + struct.pack("<I", 0)


def message(number: int, stamp: int, data: bytes) -> Record:
    """The record of a message."""
    return MESSAGE, struct.pack("<HIQQ", number, 0, stamp, stamp) + data
