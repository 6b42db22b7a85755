"""Recording: a bag that grows under its own name and outlives a full disk, a killed process and a power loss."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any

from hybrid_sysid_ros.bags.bag import METADATA, markers
from hybrid_sysid_ros.bags.durable import DurableFile, sync
from hybrid_sysid_ros.bags.storage import Extent, provisional_end
from hybrid_sysid_ros.bags.writing import BagWriter, Split
from hybrid_sysid_ros.support.files import beside, check_folder, room_beside, take_place

RESERVE = ".reserve"  # file that makes room for the end of the bag when the disk is full
RESERVE_BYTES = 1 << 18  # of it


class Recording(BagWriter):
    """Write a bag that nobody can write again, message by message, as a context.

    The folder takes its place with the first message, and each flush() puts all so far on the disk, where the files are
    whole from then on. However the context ends, the bag gets its index and its metadata.yaml as far as the disk
    permits. A bag that was there before is moved beside it (NAME.old), and removed when the new one has ended well.

    kept: messages that are on the disk. whole: the bag has its metadata.yaml. old: where the bag before is, if it was
    kept.

    Raises UserError when the place cannot be written or is taken, OSError when the disk fails later.
    """

    def __init__(self, path: Path | str, *, replace: bool = False, split: Split | None = None) -> None:
        super().__init__(path, replace=replace, split=split)
        check_folder(path, marker=markers(path), replace=replace)
        self.kept = 0
        self.whole = False
        self.old: Path | None = None
        self._folder = self._place = beside(path, "")
        self._kept: dict[str, Extent] = {}  # what is on the disk, by file
        self._ended = 0  # files that are closed

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._files:
            self._finish(well=kind is None)
        elif kind is None:  # no message came
            with BagWriter(self.path, replace=self._replace):
                self.whole = True

    def write_raw(
        self, topic: str, message_type: str, stamp: int, data: bytes | memoryview, *, published: int = 0
    ) -> None:
        """Write one serialised message; see :meth:`BagWriter.write_raw`. The first is on the disk at once."""
        if self._files:
            return super().write_raw(topic, message_type, stamp, data, published=published)
        self.offer(topic, message_type)
        with room_beside(self._place) as self._folder:
            try:
                self._folder.mkdir()
                (self._folder / RESERVE).write_bytes(os.urandom(RESERVE_BYTES))  # which no file system packs
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
        """Put all that was written so far on the disk. Raises OSError where that fails; it may be tried again."""
        if self._files:
            super().flush()
            self._sync()

    def _sync(self, *, whole: bool = False) -> None:
        """whole: the newest file has its end, as those before it have."""
        for number in range(self._ended, len(self._files)):
            file, ended = self._files[number], number + 1 < len(self._files)
            file.stream.sync(whole=ended or whole)
            self._kept[file.name] = file.extent
            self.kept = sum(extent.counts.total() for extent in self._kept.values())
            if ended:
                file.stream.close()
                self._ended += 1

    def _opened(self, path: Path) -> Any:
        return DurableFile(path, end=provisional_end())

    def _put(self, path: Path, data: bytes) -> None:
        file = DurableFile(path, end=b"")
        try:
            file.write(data)
            file.sync()
        finally:
            file.close()

    def _extents(self) -> list[Extent]:
        return list(self._kept.values())

    def _take_place(self) -> None:
        old = next(place for n in count(1) if not (place := beside(self.path, f".old{n if n > 1 else ''}")).exists())
        self.old = old if take_place(self._folder, self._place, old=old) else None
        self._folder = self._place
        sync(self._place.parent)

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

    def _close(self) -> None:
        for file in self._files[self._ended :]:
            file.stream.close()
