"""SQLite: the messages of a file in the order of logging, as rosbag2's plugin sqlite3 writes it."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

from hybrid_sysid_ros.bags.mcap import LARGEST_RECORD, LONGEST_MESSAGE, Batch, DamagedError, Schema, Stated

ROWS = 1000  # messages taken at once
COLUMNS = {"messages": {"topic_id", "timestamp", "data"}, "topics": {"id", "name", "type"}}


def stated(path: Path) -> Stated:
    """Topics and their numbers of messages.

    Raises:
        DamagedError, sqlite3.Error: it is no such file, or damaged.
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
            raise DamagedError(f"{sum(counts.values())} messages are of no topic")
        return found


def batches(path: Path, wanted: Collection[str]) -> Iterator[dict[str, Batch]]:
    """Messages of the topics in `wanted`, in the order of logging.

    Raises:
        DamagedError, sqlite3.Error: it is damaged.
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
                    raise DamagedError(f"a message of {topics[number]} has no stamp, or no data")
                batch = found.setdefault(topics[number], Batch())
                batch.logged.append(stamp)
                batch.data.append(data)
            yield found


def _connected(path: Path) -> sqlite3.Connection:
    base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    for table, needed in COLUMNS.items():
        if not needed <= _columns(base, table):  # views and computed columns are not among them
            base.close()
            raise DamagedError(f"no table {table} with {', '.join(sorted(needed))}")
    return base


def _columns(base: sqlite3.Connection, table: str) -> set[str]:
    """Stored columns of a table; none where it is no table."""
    kind = base.execute("SELECT type FROM sqlite_master WHERE name = ?", [table]).fetchone()
    return {row[1] for row in base.execute(f"PRAGMA table_info({table})")} if kind == ("table",) else set()
