"""Bag: a rosbag2 folder, or one MCAP or SQLite file, read in blocks of messages."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import repeat
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags import bag_file, mcap, metadata
from hybrid_sysid_ros.bags.layout import Types, types_of
from hybrid_sysid_ros.bags.mcap import LONGEST_MESSAGE, MAGIC, Batch, DamagedError, McapFile, Schema
from hybrid_sysid_ros.bags.quality_of_service import QualityOfService
from hybrid_sysid_ros.support.errors import UserError

logger = logging.getLogger(__name__)

METADATA = metadata.FILE
STORAGE = (".mcap", ".db3")
LONGEST = 150  # characters of a library's message that are passed on
BLOCK = 1 << 15  # messages of a topic that are handed out together, and
BLOCK_BYTES = 1 << 23  # bytes; a block may exceed them by what one chunk of the file holds
SMALLEST_BLOCK = 16  # messages, however large, so that a sampling time can be seen in them

MessageSource = Callable[[Collection[str]], Iterable[dict[str, Batch]]]


class DamagedBagError(UserError):
    """The bag is cut or damaged, and `recover` might read a part of it."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A topic of a bag, with its message type and number of messages."""

    name: str
    type: str
    messages: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Messages:
    """Serialised messages of one topic, in the order of the bag, and their times of logging (messages,) [ns].

    types: fields of the message type and of the types in it. first: number of the first message in the topic.
    """

    topic: str
    type: str
    types: Types
    logged: NDArray[np.int64]
    data: list[bytes]
    first: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Bag:
    """An open bag: its topics, the definitions of their types, and the source of its messages."""

    path: Path
    topics: dict[str, Topic]
    schemas: dict[str, Schema]
    source: MessageSource
    qualities: dict[str, list[QualityOfService]] = field(default_factory=dict)
    """Qualities of service of the publishers of each topic, where the bag has them."""

    @property
    def listing(self) -> str:
        """Topics and types in a line, for messages to the user."""
        return ", ".join(f"{topic.name} ({topic.type})" for topic in self.topics.values()) or "no topic at all"

    def blocks(self, wanted: Collection[str]) -> Iterator[Messages]:
        """Messages of the topics in `wanted`, in one pass that keeps one block of each topic in memory.

        The blocks of a topic are in the order of the file; messages in a block are in the order of logging.

        Raises UserError where the bag is damaged.
        """
        pending: dict[str, Batch] = {}
        size: dict[str, int] = {}
        first: dict[str, int] = {}
        with clear_line(self.path):
            for batches in self.source(wanted) if wanted else ():
                for name, batch in batches.items():
                    held = pending.setdefault(name, Batch())
                    held.logged += batch.logged
                    held.data += batch.data
                    added = sum(map(len, batch.data))
                    if added > LONGEST_MESSAGE and max(map(len, batch.data)) > LONGEST_MESSAGE:
                        raise DamagedError(f"a message of {name} has more than {LONGEST_MESSAGE >> 20} MiB")
                    size[name] = size.get(name, 0) + added
                    count = len(held.data)
                    if count >= BLOCK or (size[name] >= BLOCK_BYTES and count >= SMALLEST_BLOCK):
                        yield self._block(name, pending.pop(name), first)
                        size[name] = 0
            for name, held in pending.items():
                yield self._block(name, held, first)

    def messages(self, wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of logging [ns] and data of each message of the topics in `wanted`, in the order of logging
        unless the file is out of order by more than one chunk.

        Raises UserError where the bag is damaged.
        """
        waiting: list[tuple[int, str, bytes]] = []
        with clear_line(self.path):
            for batches in self.source(wanted) if wanted else ():
                count = len(waiting)
                for name, batch in batches.items():
                    waiting += zip(batch.logged, repeat(name), batch.data, strict=False)
                waiting.sort(key=itemgetter(0))
                yield from ((name, logged, data) for logged, name, data in waiting[:count])
                del waiting[:count]
            yield from ((name, logged, data) for logged, name, data in waiting)

    def whole(self, wanted: Collection[str]) -> dict[str, Messages]:
        """All messages of the topics in `wanted`, for bags that are small compared with the memory.

        Raises UserError where the bag is damaged.
        """
        held = {name: Batch() for name in self.topics if name in wanted}
        for block in self.blocks(held):
            held[block.topic].logged += block.logged.tolist()
            held[block.topic].data += block.data
        return {name: self._block(name, batch, {}) for name, batch in held.items()}

    def _block(self, name: str, batch: Batch, first: dict[str, int]) -> Messages:
        logged, data = np.asarray(batch.logged, dtype=np.int64), batch.data
        if (np.diff(logged) < 0).any():
            order = np.argsort(logged, kind="stable")
            logged, data = logged[order], [data[k] for k in order]
        start = first.get(name, 0)
        first[name] = start + len(data)
        types = types_of(self.schemas[name])
        return Messages(topic=name, type=self.topics[name].type, types=types, logged=logged, data=data, first=start)


@contextmanager
def opened(path: Path | str, *, recover: bool = False) -> Iterator[Bag]:
    """Open a bag within this context.

    recover: where the bag is cut or damaged, open the part before the damage, and log how much that is. It takes one
        more pass to find out that a bag is whole.

    Raises UserError where there is no bag, or it is empty, cut, damaged or of another kind.
    """
    path = Path(path)
    with ExitStack() as stack:
        try:
            with clear_line(path):
                bag = _whole(path, stack)
                if recover:
                    for _ in bag.source(bag.topics):
                        pass
        except DamagedBagError:
            if not recover:
                raise
            bag = _cut(path)
        yield bag


def markers(path: Path | str) -> tuple[str, ...]:
    """Names of files by which a folder is known to be a bag, whole or cut, so that it may be replaced."""
    name = Path(path).resolve().name
    return METADATA, f"{name}_0.mcap", f"{name}.mcap"


def name_of(path: Path | str) -> str:
    """The name of a bag in results: the whole name of a folder ("run.2" is not "run"), a file's without suffix."""
    resolved = Path(path).resolve()
    return resolved.name if resolved.is_dir() else resolved.stem


def topics(path: Path | str) -> dict[str, Topic]:
    """Topics of a bag by name. Raises UserError as :func:`opened` does."""
    with opened(path) as bag:
        return bag.topics


def _whole(path: Path, stack: ExitStack) -> Bag:
    """An undamaged bag. A folder whose metadata.yaml was lost is read as its MCAP files."""
    _check_ends(path)
    stored = metadata.load(path) if path.is_dir() and (path / METADATA).exists() else None
    files = list(stored.files) if stored else storage_files(path)
    if stored and stored.packing == "file":
        folder = Path(stack.enter_context(TemporaryDirectory()))
        files = [bag_file.unpacked(file, folder / f"{number}_{file.stem}") for number, file in enumerate(files)]
    parts = [(file, bag_file.stated(file)) for file in files]
    schemas, counts = dict[str, Schema](), dict[str, int]()
    for _, said in parts:
        for topic, schema in said.schemas.items():
            if schemas.setdefault(topic, schema) != schema:
                raise DamagedError(f"its files define the type of {topic} in two ways")
            counts[topic] = counts.get(topic, 0) + (said.counts or {}).get(topic, 0)
    if stored:
        _check_alike(stored, schemas, counts)
    packed = stored is not None and stored.packing == "message"

    def source(wanted: Collection[str]) -> Iterator[dict[str, Batch]]:
        for file, said in parts:
            for batches in bag_file.batches(file, said, wanted):
                yield from bag_file.without_packing(batches) if packed else (batches,)

    qualities = stored.qualities if stored else {}
    return Bag(path=path, topics=_topics(schemas, counts), schemas=schemas, source=source, qualities=qualities)


def _check_alike(stored: metadata.Metadata, schemas: dict[str, Schema], counts: dict[str, int]) -> None:
    """Compare metadata.yaml with the files; a topic without messages need not be in them, and is added."""
    for topic in {**stored.counts, **counts}:
        said, found = stored.counts.get(topic, 0), counts.get(topic, 0)
        if said != found:
            raise DamagedError(f"has {found} messages of {topic}, but {METADATA} says {said}")
        if (
            topic in stored.types
            and schemas.setdefault(topic, Schema(name=stored.types[topic])).name != stored.types[topic]
        ):
            raise DamagedError(f"has {schemas[topic].name} in {topic}, but {METADATA} says {stored.types[topic]}")


def _topics(schemas: dict[str, Schema], counts: dict[str, int]) -> dict[str, Topic]:
    return {name: Topic(name=name, type=schema.name, messages=counts.get(name, 0)) for name, schema in schemas.items()}


def _cut(path: Path) -> Bag:
    """The readable part of a damaged bag."""
    files = storage_files(path)
    schemas, counts = dict[str, Schema](), dict[str, int]()
    ends: list[int] = []
    said = 0
    for file in files:
        found = McapFile(file, None)
        for batches in found.batches():
            for name, batch in batches.items():
                counts[name] = counts.get(name, 0) + len(batch.data)
                ends = [min([*ends, *batch.logged]), max([*ends, *batch.logged])]
        schemas.update(found.schemas)
        with suppress(DamagedError, struct.error, UnicodeDecodeError):
            said += mcap.stated(file).messages or 0
    if not counts:
        raise UserError(f"{path}: not one message can be recovered")
    lost = f", of {said} that its metadata states" if said else ""
    seconds = (ends[1] - ends[0]) * 1e-9
    logger.warning("%s: recovered %d messages of %.1f s%s", path, sum(counts.values()), seconds, lost)
    return Bag(
        path=path,
        topics=_topics(schemas, counts),
        schemas=schemas,
        source=lambda wanted: (batches for file in files for batches in McapFile(file, wanted).batches()),
    )


def storage_files(path: Path) -> list[Path]:
    """Files that hold a bag's messages, in the order in which they were written."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix in STORAGE and file.is_file()]
        return sorted(files, key=lambda file: (len(file.name), file.name))
    return [path]


def _check_ends(path: Path) -> None:
    """Check the kind of a bag and the ends of its files.

    Raises UserError for a path that is no bag, and DamagedBagError for a bag that is cut.
    """
    if not path.exists():
        raise UserError(f"{path}: no such file or folder")
    files = storage_files(path)
    packed = (path / METADATA).exists() and any({*STORAGE}.intersection(file.suffixes) for file in path.iterdir())
    if path.is_dir() and not (files or packed):
        there = "is no bag: " if any(path.iterdir()) else "is an empty folder: "
        raise UserError(f"{path}: {there}a bag has an .mcap or .db3 file beside {METADATA}; copy the whole folder")
    if not path.is_dir() and path.suffix not in STORAGE:
        hint = ": convert it with rosbags-convert" if path.suffix == ".bag" else ": give a rosbag2 folder or .mcap file"
        raise UserError(f"{path}: is no ROS 2 bag{hint}")
    cut = None
    for file in files:
        size = file.stat().st_size
        if size == 0:
            raise UserError(f"{file}: is an empty file: nothing was recorded, or the copy failed")
        if file.suffix != ".mcap":
            continue
        with file.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise UserError(f"{file}: is no MCAP file, although its name says so")
            stream.seek(max(0, size - len(MAGIC)))
            if size < 2 * len(MAGIC) or stream.read() != MAGIC:
                cut = file
    if cut is not None:
        raise _refusal(cut, "is cut short (recording interrupted, or still running)")
    if path.is_dir() and not (path / METADATA).exists() and files[0].suffix != ".mcap":
        raise UserError(f"{path}: has no {METADATA}: give the file {files[0].name} itself")


@contextmanager
def clear_line(path: Path) -> Iterator[None]:
    """Turn errors of the libraries into a UserError."""
    try:
        yield
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # the libraries may raise anything for a damaged file
        raise _refusal(path, f"is damaged ({_shortened(error)})") from error


def _refusal(path: Path, damage: str) -> UserError:
    if not any(file.suffix == ".mcap" for file in storage_files(path)):
        return UserError(f"{path}: {damage}: only MCAP files can be recovered")
    return DamagedBagError(f"{path}: {damage}: read the part before it with --recover")


def _shortened(error: Exception) -> str:
    line = " ".join(str(error).split()) or type(error).__name__
    return line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."
