"""Writing bags: as a whole, or growing so that they survive a full disk, a kill and a power loss."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags import metadata, storage
from hybrid_sysid_ros.bags.bag import METADATA, markers
from hybrid_sysid_ros.bags.layout import jazzy_types
from hybrid_sysid_ros.bags.series import SECOND, Series
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import beside, check_folder, room_beside, take_place, written_folder


@dataclass(frozen=True, kw_only=True)
class Split:
    """Limits at which a bag continues in a new file: bytes on the disk, and seconds of log time; 0: no limit."""

    size: int = 0
    seconds: float = 0.0

    def is_due(self, file: storage.Storage, logged: int) -> bool:
        """Whether a message that was logged at a time [ns] belongs into the next file."""
        if not file.counts:
            return False
        long = 0.0 < self.seconds * SECOND <= logged - file.first
        return long or 0 < self.size <= file.stream.tell()


class BagWriter:
    """Write a bag, message by message, as a context.

    It grows in a temporary folder beside `path`, which is renamed to `path` when the context ends without an error: a
    bag is whole or does not exist. For data that cannot be produced again, use :class:`Recording`.

    compression: that of the chunks: zstd or lz4, which every MCAP reader knows; "": none.
    replace: replace a bag that exists there.
    notes: text by key for the metadata (custom_data), such as where the data came from.
    split: when it continues in a new file.

    Raises UserError when the place cannot be written or is taken.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        compression: storage.Compression = "zstd",
        replace: bool = False,
        notes: Mapping[str, str] | None = None,
        split: Split | None = None,
    ) -> None:
        self.path = Path(path)
        self.messages = 0
        self._compression = compression
        self._replace = replace
        self._notes = dict(notes or {})
        self._split = split or Split()
        self._stack = ExitStack()
        self._offers: dict[str, storage.OfferedTopic] = {}
        self._files: list[storage.Storage] = []
        self._folder = self.path

    def __enter__(self) -> BagWriter:
        with ExitStack() as stack:
            place = written_folder(self.path, marker=markers(self.path), replace=self._replace)
            self._folder = stack.enter_context(place)
            stack.push(self._end)
            self._next_file()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _end(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if kind is None:
                self._finish_file()
                self._describe()
        finally:
            for file in self._files:
                file.stream.close()

    def offer(
        self, topic: str, message_type: str, qualities: Sequence[storage.QualityOfService] = ()
    ) -> storage.OfferedTopic:
        """Declare how a topic is offered, before its first message is written.

        Raises UserError where ROS 2 Jazzy has no such message type, or the topic had another type before.
        """
        package, _, name = message_type.rpartition("/")
        full = message_type if package.endswith("/msg") else f"{package}/msg/{name}"
        known = self._offers.get(topic)
        if known is None:
            if full not in jazzy_types().fielddefs:
                raise UserError(f"{self.path}: topic {topic}: message type {message_type!r} is not one of ROS 2 Jazzy")
            known = self._offers[topic] = storage.OfferedTopic(topic=topic, type=full, qualities=tuple(qualities))
        if known.type != full:
            raise UserError(f"{self.path}: topic {topic} has type {known.type}, not {full} as well")
        return known

    def write_raw(
        self, topic: str, message_type: str, stamp: int, data: bytes | memoryview, *, published: int = 0
    ) -> None:
        """Write one serialised message (CDR, as a raw subscription of rclpy gives it).

        stamp: time of logging [ns]. published: time of sending [ns]; 0: the time of logging. Raises UserError as
        :meth:`offer` does.
        """
        offer = self._offers.get(topic)
        if offer is None or offer.type != message_type:
            offer = self.offer(topic, message_type)
        if self._split.is_due(self._files[-1], stamp):
            self._next_file()
        self._files[-1].write(offer, stamp, published or stamp, data)
        self.messages += 1

    def attach(self, name: str, data: bytes, logged: int) -> None:
        """Attach a file to the bag, with the time [ns] at which it was read; see :mod:`.attachments`."""
        self._files[-1].attach(name, data, logged)

    def flush(self) -> None:
        """End a chunk of the file here."""
        self._files[-1].flush()

    def _next_file(self) -> None:
        """End the current file and begin the next."""
        name = f"{self.path.resolve().name}_{len(self._files)}.mcap"
        stream = self._opened(self._folder / name)
        if self._files:
            self._finish_file()
        self._files.append(storage.Storage(name, stream, compression=self._compression))

    def _finish_file(self) -> None:
        offers = tuple(self._offers.values())
        self._files[-1].finish(lambda file: metadata.inner_text(file, offers, self._notes))

    def _opened(self, path: Path) -> Any:
        """A new file, opened for writing."""
        return path.open("xb")

    def _describe(self) -> None:
        """Write metadata.yaml, beside its place, then rename."""
        partial = self._folder / f"{METADATA}.tmp"
        content = metadata.text(self._extents(), tuple(self._offers.values()), self._notes)
        self._put(partial, content.encode())
        partial.replace(self._folder / METADATA)

    def _put(self, path: Path, data: bytes) -> None:
        path.write_bytes(data)

    def _extents(self) -> list[storage.Extent]:
        """The contents of the files."""
        return [file.extent for file in self._files]


def write_bag(
    path: Path | str,
    topics: Sequence[Series],
    *,
    compression: storage.Compression = "zstd",
    replace: bool = False,
    notes: Mapping[str, str] | None = None,
) -> Path:
    """Write a bag of whole series, in the order of their stamps.

    Raises UserError where the place cannot be written, or holds something that may not be replaced.
    """
    with BagWriter(path, compression=compression, replace=replace, notes=notes) as writer:
        stamps = np.concatenate([one.stamps for one in topics])
        owner = np.repeat(np.arange(len(topics)), [len(one.stamps) for one in topics])
        following = [one.messages() for one in topics]
        order = np.argsort(stamps, kind="stable")
        for stamp, number in zip(stamps[order].tolist(), owner[order].tolist(), strict=True):
            writer.write_raw(topics[number].topic, topics[number].type, stamp, next(following[number]))
    return Path(path)


RESERVE = ".reserve"  # a file that is removed to make room for the end of the bag when the disk is full
RESERVE_BYTES = 1 << 18  # of it


class Recording(BagWriter):
    """Write a bag of data that cannot be produced again, message by message, as a context.

    The folder appears with the first message, and each flush() writes all messages so far to the disk; the files are
    whole after each flush. However the context ends, the bag gets its index and its metadata.yaml if the disk permits.
    An older bag of the name is moved beside it (NAME.old), and removed after the new one has ended without an error.

    kept: number of messages on the disk. whole: whether the bag has its metadata.yaml. old: path of the older bag, if
    it was kept.

    Raises UserError when the place cannot be written or is taken, OSError when the disk fails later.
    """

    def __init__(self, path: Path | str, *, replace: bool = False, split: Split | None = None) -> None:
        super().__init__(path, replace=replace, split=split)
        check_folder(path, marker=markers(path), replace=replace)
        self.kept = 0
        self.whole = False
        self.old: Path | None = None
        self._folder = self._place = beside(path, "")
        self._kept: dict[str, storage.Extent] = {}  # content on the disk, by file
        self._ended = 0  # files that are closed

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._files:
            self._finish(well=kind is None)
        elif kind is None:  # there was no message
            with BagWriter(self.path, replace=self._replace):
                self.whole = True

    def write_raw(
        self, topic: str, message_type: str, stamp: int, data: bytes | memoryview, *, published: int = 0
    ) -> None:
        """Write one serialised message; see :meth:`BagWriter.write_raw`. The first is flushed to the disk at once."""
        if self._files:
            return super().write_raw(topic, message_type, stamp, data, published=published)
        self.offer(topic, message_type)
        with room_beside(self._place) as self._folder:
            try:
                self._folder.mkdir()
                (self._folder / RESERVE).write_bytes(os.urandom(RESERVE_BYTES))  # which no file system compresses
                self._next_file()
                super().write_raw(topic, message_type, stamp, data, published=published)
                self.flush()
                self._take_place()
            except BaseException:
                self._close()
                self._files.clear()
                self._kept.clear()
                self.messages = self.kept = 0
                raise

    def flush(self) -> None:
        """Flush everything written so far to the disk. Raises OSError where that fails; it may be tried again."""
        if self._files:
            super().flush()
            self._sync()

    def _sync(self, *, whole: bool = False) -> None:
        """Flush the newest file. whole: it has its end, as those before it have."""
        for number in range(self._ended, len(self._files)):
            file, ended = self._files[number], number + 1 < len(self._files)
            file.stream.sync(whole=ended or whole)
            self._kept[file.name] = file.extent
            self.kept = sum(extent.counts.total() for extent in self._kept.values())
            if ended:
                file.stream.close()
                self._ended += 1

    def _opened(self, path: Path) -> Any:
        return storage.DurableFile(path, end=storage.provisional_end())

    def _put(self, path: Path, data: bytes) -> None:
        file = storage.DurableFile(path, end=b"")
        try:
            file.write(data)
            file.sync()
        finally:
            file.close()

    def _extents(self) -> list[storage.Extent]:
        return list(self._kept.values())

    def _take_place(self) -> None:
        old = next(place for n in count(1) if not (place := beside(self.path, f".old{n if n > 1 else ''}")).exists())
        self.old = old if take_place(self._folder, self._place, old=old) else None
        self._folder = self._place
        storage.sync(self._place.parent)

    def _finish(self, *, well: bool) -> None:
        """Close the bag. Raises OSError where that fails, unless something failed before."""
        trouble: OSError | None = None
        with suppress(OSError):
            (self._folder / RESERVE).unlink(missing_ok=True)
        try:
            self._finish_file()
            self._sync(whole=True)
        except OSError as error:
            trouble = error
        self._close()
        try:
            self._describe()
            storage.sync(self._folder)
            self.whole = True
        except OSError as error:
            trouble = trouble or error
            with suppress(OSError):
                (self._folder / f"{METADATA}.tmp").unlink(missing_ok=True)
        if trouble is not None and well:
            raise trouble
        if well and self.old is not None:
            shutil.rmtree(self.old, ignore_errors=True)
            self.old = None

    def _close(self) -> None:
        for file in self._files[self._ended :]:
            file.stream.close()
