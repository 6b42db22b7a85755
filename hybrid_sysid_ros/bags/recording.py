"""Recording: a bag that grows under its own name and outlives a full disk, a killed process and a power loss."""

from __future__ import annotations

import errno
import os
import shutil
from contextlib import suppress
from copy import copy
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any

from hybrid_sysid_ros.bags.bag import METADATA, markers
from hybrid_sysid_ros.bags.writing import BagWriter
from hybrid_sysid_ros.support.files import beside, check_folder, room_beside, take_place

RESERVE = ".reserve"  # file that makes room for the end of the bag when the disk is full
RESERVE_BYTES = 1 << 16  # of it, beside what definitions and the index of the chunks need
INDEX_BYTES = (96, 10)  # of a chunk, and of a channel in it
WRITER = ("connections", "counts", "min_timestamp", "max_timestamp")  # what rosbags notes of messages before they are
STORAGE = ("schemas", "channels", "chunks", "channel_stats", "message_start_time", "message_end_time")  # on the disk


class Recording(BagWriter):
    """Write a bag that nobody can write again, message by message, as a context.

    The folder takes its place with the first message, and each flush() puts all so far on the disk. However the context
    ends, the bag is closed as well as the disk permits; without its end (after a kill or a power loss) it is read with
    `recover`. A bag that was there before is moved beside it (NAME.old), and removed when the new one has ended well.

    kept: messages that are on the disk. whole: the bag has its end. old: where the bag before is, if it was kept.

    Raises UserError when the place cannot be written or is taken, OSError when the disk fails later.
    """

    def __init__(self, path: Path | str, *, replace: bool = False) -> None:
        super().__init__(path, replace=replace)
        check_folder(path, marker=markers(path), replace=replace)
        self.kept = 0
        self.whole = False
        self.old: Path | None = None
        self._folder = self._place = beside(path, "")
        self._file: DurableFile | None = None
        self._reserved = 0
        self._good: list[tuple[object, str, Any]] = []

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._end(well=kind is None)
        elif kind is None:  # no message came
            with BagWriter(self.path, replace=self._replace):
                self.whole = True

    def write_raw(self, topic: str, message_type: str, stamp: int, data: bytes | memoryview) -> None:
        """Write one serialised message; see :meth:`BagWriter.write_raw`. The first is on the disk at once."""
        if self._file is not None:
            return super().write_raw(topic, message_type, stamp, data)
        with room_beside(self._place) as self._folder:
            self._begin(self._folder)
            storage: Any = self._storage
            storage.bio.close()
            self._file = storage.bio = DurableFile(storage.path)
            try:
                super().write_raw(topic, message_type, stamp, data)
                self.flush()
                self._take_place()
            except BaseException:
                self._file.abandon()
                self._file = None
                raise

    def flush(self) -> None:
        """Put all that was written so far on the disk. Raises OSError where that fails; it may be tried again."""
        if self._file is not None:
            self._sync(self._file)
            self._reserve()

    def _take_place(self) -> None:
        old = next(place for n in count(1) if not (place := beside(self.path, f".old{n if n > 1 else ''}")).exists())
        self.old = old if take_place(self._folder, self._place, old=old) else None
        self._folder = self._writer.path = self._place
        self._writer.metapath = self._place / METADATA
        sync(self._place.parent)

    def _sync(self, file: DurableFile) -> None:
        super().flush()
        file.sync()
        self.kept = self.messages
        owners = ((self._writer, WRITER), (self._storage, STORAGE))
        self._good = [(owner, name, copy(getattr(owner, name))) for owner, names in owners for name in names]

    def _forget(self, file: DurableFile) -> None:
        """Go back to what is on the disk."""
        file.forget()
        for owner, name, value in self._good:
            setattr(owner, name, value)
        self.messages = self.kept

    def _reserve(self) -> None:
        """Let the reserve grow with what the end needs: it repeats all definitions and has a line for each chunk."""
        storage = self._storage
        definitions = sum(len(schema.data) for schema in storage.schemas)
        index = len(storage.chunks) * (INDEX_BYTES[0] + INDEX_BYTES[1] * len(storage.channels))
        while self._reserved < RESERVE_BYTES + definitions + index:
            with (self._folder / RESERVE).open("ab", buffering=0) as file:
                self._reserved += file.write(os.urandom(RESERVE_BYTES))  # which no file system packs

    def _end(self, *, well: bool) -> None:
        """Close the bag. Raises OSError where that fails, unless something failed before."""
        assert self._file is not None
        trouble: OSError | None = None
        with suppress(OSError):
            (self._folder / RESERVE).unlink(missing_ok=True)
        try:
            self._sync(self._file)
        except OSError as error:
            trouble = error
            self._forget(self._file)
        try:
            self._writer.close()
            sync(self._writer.metapath)
            sync(self._folder)
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


class DurableFile:
    """A file that grows by blocks: each is on the disk whole or not at all, whatever fails meanwhile.

    It has what a library needs that writes to a file: write(), tell(), close(), and seek() within the newest block.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        self._size = os.fstat(self._descriptor).st_size
        self._pending = bytearray()
        self._place = 0  # in it

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Write into the block that sync() puts on the disk."""
        self._pending[self._place : self._place + len(data)] = data
        self._place += len(data)
        return len(data)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._size + self._place

    def seek(self, place: int) -> int:
        """Go to a place in what is not on the disk yet."""
        self._place = place - self._size
        return place

    def sync(self) -> None:
        """Put the block on the disk. Raises OSError where that fails; it may be tried again."""
        written = 0
        if not os.fstat(self._descriptor).st_nlink:
            raise OSError(errno.ENOENT, "somebody has removed it")
        try:
            while written < len(self._pending):
                written += os.write(self._descriptor, self._pending[written:])
            os.fsync(self._descriptor)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._size)
            raise
        self._size += written
        self.forget()

    def forget(self) -> None:
        """Give up what is not on the disk yet."""
        self._pending.clear()
        self._place = 0

    def abandon(self) -> None:
        """Close the file without that."""
        os.close(self._descriptor)

    def close(self) -> None:
        """Put the rest on the disk, and close the file in any case. Raises OSError where that fails."""
        try:
            self.sync()
        finally:
            self.abandon()


def sync(path: Path) -> None:
    """Put a file, or the names in a folder, on the disk. Raises OSError where that fails."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
