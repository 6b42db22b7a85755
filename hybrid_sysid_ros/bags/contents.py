"""Contents: the topics of a bag and their serialised messages, from a rosbag2 folder or one MCAP or SQLite file."""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from hybrid_sysid_ros.bags.recovery import MAGIC, Schema, recovered_channels
from hybrid_sysid_ros.errors import UserError

logger = logging.getLogger(__name__)

METADATA = "metadata.yaml"  # what makes a folder a bag
STORAGE = (".mcap", ".db3")
LONGEST = 150  # characters of a library's message that are passed on


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A topic of a bag: its message type and how many messages there are."""

    name: str
    type: str
    messages: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Messages:
    """Serialised messages of one topic, in the order of the bag, and when each was logged (messages,) [ns]."""

    topic: str
    type: str
    logged: NDArray[np.int64]
    data: list[bytes]


@dataclass(frozen=True, kw_only=True, eq=False)
class Contents:
    """What was read from a bag: all its topics, the messages of those asked for, and the definitions of their types."""

    topics: dict[str, Topic]
    messages: dict[str, Messages]
    typestore: Typestore

    @cached_property
    def listing(self) -> str:
        """Topics and types in a line, for messages to the user."""
        return ", ".join(f"{topic.name} ({topic.type})" for topic in self.topics.values()) or "no topic at all"


def topics(path: Path | str) -> dict[str, Topic]:
    """Topics of a bag by name.

    Raises:
        UserError: see contents().
    """
    return contents(path, wanted=()).topics


def contents(path: Path | str, wanted: Collection[str], *, recover: bool = False) -> Contents:
    """Read a bag: its list of topics, and the messages of the topics in `wanted`.

    recover: where the bag is cut or damaged, return what can be read before the damage and log how much that is.

    Raises:
        UserError: there is no bag, or it is empty, cut, damaged or of another kind.
    """
    path = Path(path)
    try:
        damage = _damage(path)
        if damage is None:
            return _read(path, wanted)
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # the libraries raise whatever a damaged file leads them to
        damage = f"{path}: is damaged ({_in_a_line(error)})"
    if not any(file.suffix == ".mcap" for file in _storage_files(path)):
        raise UserError(f"{damage}: only MCAP files can be recovered")
    if not recover:
        raise UserError(f"{damage}: read the part before it with --recover")
    try:
        return _recovered(path, wanted)
    except (TypesysError, AssertionError, LookupError, ValueError) as error:
        raise UserError(f"{path}: cannot be recovered ({_in_a_line(error)})") from error


def _storage_files(path: Path) -> list[Path]:
    """Files that hold a bag's messages, in the order in which they were written."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix in STORAGE and file.is_file()]
        return sorted(files, key=lambda file: (len(file.name), file.name))
    return [path]


def _damage(path: Path) -> str | None:
    """What keeps a bag from being read but might leave a part of it, None if nothing is seen at its ends.

    Raises:
        UserError: this is no bag.
    """
    if not path.exists():
        raise UserError(f"{path}: no such file or folder")
    files = _storage_files(path)
    if path.is_dir() and not files and not (path / METADATA).exists():
        if not any(path.iterdir()):
            raise UserError(f"{path}: is an empty folder: a bag has {METADATA} and an .mcap file")
        raise UserError(f"{path}: is no bag: there is no {METADATA} and no .mcap file in it")
    if not path.is_dir() and path.suffix not in STORAGE:
        hint = ": convert it with rosbags-convert" if path.suffix == ".bag" else ": give a rosbag2 folder or .mcap file"
        raise UserError(f"{path}: is no ROS 2 bag{hint}")
    damage = None
    for file in files:
        size = file.stat().st_size
        if size == 0:
            raise UserError(f"{file}: is an empty file: nothing was recorded, or the copy failed")
        if file.suffix != ".mcap":
            continue
        with file.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise UserError(f"{file}: is no MCAP file, whatever its name says")
            stream.seek(max(0, size - len(MAGIC)))
            if size < 2 * len(MAGIC) or stream.read() != MAGIC:
                damage = f"{file}: is cut short (recording interrupted, or still running)"
    if damage is None and path.is_dir() and not (path / METADATA).exists() and files[0].suffix != ".mcap":
        raise UserError(f"{path}: there is no {METADATA}: give the file {files[0].name} itself")
    return damage


def _read(path: Path, wanted: Collection[str]) -> Contents:
    """Read an undamaged bag. A folder whose metadata.yaml was lost is read as its MCAP files."""
    sources = _storage_files(path) if path.is_dir() and not (path / METADATA).exists() else [path]
    with AnyReader(sources, default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        found: dict[str, Topic] = {}
        for connection in reader.connections:
            before = found[connection.topic].messages if connection.topic in found else 0
            found[connection.topic] = Topic(
                name=connection.topic, type=connection.msgtype, messages=before + connection.msgcount
            )
        stamps: dict[str, list[int]] = {name: [] for name in found if name in wanted}
        data: dict[str, list[bytes]] = {name: [] for name in stamps}
        chosen = [connection for connection in reader.connections if connection.topic in stamps]
        for connection, stamp, raw in reader.messages(connections=chosen) if chosen else ():
            stamps[connection.topic].append(stamp)
            data[connection.topic].append(raw)
        return Contents(
            topics=found,
            messages={name: _messages(found[name], stamps[name], data[name]) for name in stamps},
            typestore=reader.typestore,
        )


def _recovered(path: Path, wanted: Collection[str]) -> Contents:
    found: dict[str, Topic] = {}
    schemas: dict[str, Schema] = {}
    stamps: dict[str, list[int]] = {}
    data: dict[str, list[bytes]] = {}
    for file in _storage_files(path):
        for channel in recovered_channels(file):
            schemas[channel.schema.name] = channel.schema
            stamps.setdefault(channel.topic, []).extend(channel.stamps)
            data.setdefault(channel.topic, []).extend(channel.data)
            found[channel.topic] = Topic(
                name=channel.topic, type=channel.schema.name, messages=len(stamps[channel.topic])
            )
    count = sum(len(entries) for entries in stamps.values())
    if not count:
        raise UserError(f"{path}: not one message can be recovered")
    logged = np.concatenate([np.asarray(entries, dtype=np.int64) for entries in stamps.values()])
    logger.warning("%s: recovered %d messages of %.1f s", path, count, (logged.max() - logged.min()) * 1e-9)
    return Contents(
        topics=found,
        messages={name: _messages(found[name], stamps[name], data[name]) for name in found if name in wanted},
        typestore=_typestore(schemas),
    )


def _messages(topic: Topic, stamps: list[int], data: list[bytes]) -> Messages:
    return Messages(topic=topic.name, type=topic.type, logged=np.asarray(stamps, dtype=np.int64), data=data)


def _typestore(schemas: dict[str, Schema]) -> Typestore:
    """Types by the definitions in the bag."""
    store = get_typestore(Stores.EMPTY)
    for schema in schemas.values():
        if schema.encoding == "ros2msg":
            store.register(get_types_from_msg(schema.text, schema.name))
            continue
        separator = "=" * 80 + "\n"
        for part in schema.text.split(separator):
            text = part.split("\n", 1)[1] if part.startswith("IDL: ") else part
            if text.strip():
                store.register(get_types_from_idl(text))
    return store


def _in_a_line(error: Exception) -> str:
    line = " ".join(str(error).split()) or type(error).__name__
    return line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."
