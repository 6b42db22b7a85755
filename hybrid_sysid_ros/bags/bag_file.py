"""One file of a bag, MCAP or SQLite, perhaps compressed, checked against its own summary."""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

from hybrid_sysid_ros.bags import mcap
from hybrid_sysid_ros.bags.mcap import (
    LARGEST_CHUNK,
    LARGEST_RECORD,
    LONGEST_MESSAGE,
    Batch,
    DamagedError,
    McapFile,
    Schema,
    Stated,
)

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd


PIECE = 1 << 23  # bytes of unpacked messages that are yielded together
MOST_TIMES = 1000  # largest ratio of an unpacked file to the packed one, beside LARGEST_CHUNK


def stated(file: Path) -> Stated:
    """The content that a file states in its summary; without a summary, the content that it has."""
    if file.suffix == ".db3":
        return _sqlite_stated(file)
    said = mcap.stated(file)
    if said.counts is not None and (said.schemas or not said.messages):
        return said
    scan = McapFile(file, None)
    for _ in scan.batches():
        pass
    if reason := scan.damage or differences(said, scan.found):
        raise DamagedError(f"{file.name} {reason}")
    return scan.found


def differences(said: Stated, found: Stated) -> str:
    """How the content found in a whole pass differs from the stated one; "" where they agree."""
    for what, one, other in (("chunks", said.chunks, found.chunks), ("messages", said.messages, found.messages)):
        if one is not None and one != other:
            return f"has {other} {what}, but its summary says {one}"
    for topic, count in (found.counts or {}).items():
        expected = count if said.counts is None else said.counts.get(topic, 0)
        if expected != count:
            return f"has {count} messages of {topic}, but its summary says {expected}"
    for topic in found.schemas if said.schemas else ():
        if topic not in said.schemas:
            return f"has topic {topic}, which its summary does not name"
        if said.schemas[topic] != found.schemas[topic]:
            return f"defines the type of {topic} in two ways"
    return ""


def batches(file: Path, said: Stated, wanted: Collection[str]) -> Iterator[dict[str, Batch]]:
    """Messages of a file; after the last one, the content is compared with the stated one."""
    if file.suffix == ".db3":
        yield from _sqlite_batches(file, wanted)
        return
    found = McapFile(file, wanted)
    yield from found.batches()
    if reason := found.damage or differences(said, found.found):
        raise DamagedError(f"{file.name} {reason}")


def unpacked(packed: Path, place: Path) -> Path:
    """Unpack a file, up to a limit that depends on its size."""
    limit = LARGEST_CHUNK + MOST_TIMES * packed.stat().st_size
    with zstd.open(packed, "rb") as source, place.open("wb") as target:
        while part := source.read(1 << 20):
            if target.tell() + len(part) > limit:
                raise DamagedError(f"{packed.name} unpacks to more than {limit} bytes")
            target.write(part)
    return place


def without_packing(batches: dict[str, Batch]) -> Iterator[dict[str, Batch]]:
    """Messages that were compressed one by one, unpacked in pieces."""
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


ROWS = 1000  # messages taken at once
_TABLES = {"messages": {"topic_id", "timestamp", "data"}, "topics": {"id", "name", "type"}}


def _sqlite_stated(path: Path) -> Stated:
    """Topics and their numbers of messages.

    Raises DamagedError or sqlite3.Error for a file that is damaged or of another kind.
    """
    with closing(_connected(path)) as base:
        definitions = dict[str, Schema]()
        if _columns(base, "message_definitions"):
            shortened = f"substr(encoded_message_definition, 1, {LARGEST_RECORD})"
            query = f"SELECT topic_type, encoding, {shortened} FROM message_definitions ORDER BY id DESC"
            for name, encoding, text in base.execute(query):
                definitions[str(name)] = Schema(name=str(name), encoding=str(encoding), text=str(text))
        found = Stated(counts={})
        counts = dict(base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        for number, topic, name in base.execute("SELECT id, name, type FROM topics ORDER BY id"):
            found.schemas[str(topic)] = definitions.get(str(name), Schema(name=str(name)))
            assert found.counts is not None
            found.counts[str(topic)] = found.counts.get(str(topic), 0) + counts.pop(number, 0)
        if counts:
            raise DamagedError(f"{sum(counts.values())} messages belong to no topic")
        return found


def _sqlite_batches(path: Path, wanted: Collection[str]) -> Iterator[dict[str, Batch]]:
    """Messages of the topics in `wanted`, in the order of logging.

    Raises DamagedError or sqlite3.Error for a damaged file.
    """
    with closing(_connected(path)) as base:
        topics = {number: str(name) for number, name in base.execute("SELECT id, name FROM topics") if name in wanted}
        numbers = ",".join("?" for _ in topics)
        rows = base.execute(
            f"SELECT topic_id, timestamp, CASE WHEN length(data) <= {LONGEST_MESSAGE} THEN data END FROM messages "
            f"WHERE topic_id IN ({numbers}) ORDER BY timestamp",
            [*topics],
        )
        while run := rows.fetchmany(ROWS):
            found: dict[str, Batch] = {}
            for number, stamp, data in run:
                if not isinstance(stamp, int) or not isinstance(data, bytes):
                    raise DamagedError(f"a message of {topics[number]} has no time stamp or no data")
                batch = found.setdefault(topics[number], Batch())
                batch.logged.append(stamp)
                batch.data.append(data)
            yield found


def _connected(path: Path) -> sqlite3.Connection:
    base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    for table, needed in _TABLES.items():
        if not needed <= _columns(base, table):  # views and computed columns are not among them
            base.close()
            raise DamagedError(f"no table {table} with {', '.join(sorted(needed))}")
    return base


def _columns(base: sqlite3.Connection, table: str) -> set[str]:
    """Stored columns of a table; none where it is no table."""
    kind = base.execute("SELECT type FROM sqlite_master WHERE name = ?", [table]).fetchone()
    return {row[1] for row in base.execute(f"PRAGMA table_info({table})")} if kind == ("table",) else set()
