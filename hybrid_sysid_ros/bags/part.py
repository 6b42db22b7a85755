"""Parts: the files of a bag, MCAP or SQLite, perhaps packed, each compared with what it says of itself."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from pathlib import Path

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

from hybrid_sysid_ros.bags import mcap, sqlite
from hybrid_sysid_ros.bags.mcap import LARGEST_CHUNK, LONGEST_MESSAGE, Batch, DamagedError, McapFile, Stated

PIECE = 1 << 23  # bytes of unpacked messages that are handed out together
MOST_TIMES = 1000  # what a file packed as a whole may be larger when it is unpacked, beside LARGEST_CHUNK


def stated(file: Path) -> Stated:
    """What a file says it holds; of one that does not say it, what it holds."""
    if file.suffix == ".db3":
        return sqlite.stated(file)
    said = mcap.stated(file)
    if said.counts is not None and (said.schemas or not said.messages):
        return said
    scan = McapFile(file, None)
    for _ in scan.batches():
        pass
    if reason := scan.damage or mcap.differences(said, scan.found):
        raise DamagedError(f"{file.name} {reason}")
    return scan.found


def batches(file: Path, said: Stated, wanted: Collection[str]) -> Iterator[dict[str, Batch]]:
    """Messages of a file; in the end whether they are what it says."""
    if file.suffix == ".db3":
        yield from sqlite.batches(file, wanted)
        return
    found = McapFile(file, wanted)
    yield from found.batches()
    if reason := found.damage or mcap.differences(said, found.found):
        raise DamagedError(f"{file.name} {reason}")


def unpacked(packed: Path, place: Path) -> Path:
    """Unpack a file, within what can be the content of one so large."""
    limit = LARGEST_CHUNK + MOST_TIMES * packed.stat().st_size
    with zstd.open(packed, "rb") as source, place.open("wb") as target:
        while part := source.read(1 << 20):
            if target.tell() + len(part) > limit:
                raise DamagedError(f"{packed.name} unpacks to more than {limit} bytes")
            target.write(part)
    return place


def without_packing(batches: dict[str, Batch]) -> Iterator[dict[str, Batch]]:
    """Messages that were packed one by one, piece by piece."""
    for name, batch in batches.items():
        held, size = Batch(), 0
        for stamp, packed in zip(batch.logged, batch.data, strict=True):
            held.logged.append(stamp)
            held.data.append(mcap.unpacked(packed, LONGEST_MESSAGE))
            size += len(held.data[-1])
            if size > PIECE:
                yield {name: held}
                held, size = Batch(), 0
        yield {name: held}
