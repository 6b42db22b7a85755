"""Durable files: they grow by blocks, and whatever ends that, what was put on the disk can be read."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path


class DurableFile:
    """A file that grows by blocks: each is on the disk whole or not at all, whatever fails meanwhile.

    As long as it grows it has a provisional end, which the next block takes the place of: so it is whole between two
    blocks, also where nobody comes to close it.

    It has what a library needs that writes to a file: write(), flush() and tell().
    """

    def __init__(self, path: Path, *, end: bytes) -> None:
        """path: of a file that is made with its first block. end: the provisional one."""
        self._path, self._end = path, end
        self._descriptor: int | None = None
        self._size = 0  # without the end
        self._pending = bytearray()

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Write into the block that sync() puts on the disk."""
        self._pending += data
        return len(data)

    def flush(self) -> None:
        """Do nothing: blocks are put on the disk by sync()."""

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._size + len(self._pending)

    def sync(self, *, whole: bool = False) -> None:
        """Put the block on the disk. whole: it has the file's real end. Raises OSError where that fails, and leaves
        the file as it was before; it may be tried again.
        """
        if self._descriptor is None:
            self._descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        if not os.fstat(self._descriptor).st_nlink:
            raise OSError(errno.ENOENT, "somebody has removed it")
        try:
            self._put(self._descriptor, bytes(self._pending) + (b"" if whole else self._end))
            os.fsync(self._descriptor)
        except OSError:
            with suppress(OSError):  # the end goes where it was, so it needs no room
                self._put(self._descriptor, self._end if self._size else b"")
            raise
        self._size += len(self._pending)
        self._pending.clear()

    def close(self) -> None:
        """Close the file as it is on the disk; one without a block is removed."""
        if self._descriptor is None:
            return
        os.close(self._descriptor)
        if not self._size:
            with suppress(OSError):
                self._path.unlink()

    def _put(self, descriptor: int, data: bytes) -> None:
        """Let this be all that follows the blocks on the disk."""
        written = 0
        while written < len(data):
            written += os.pwrite(descriptor, data[written:], self._size + written)
        os.ftruncate(descriptor, self._size + len(data))


def sync(path: Path) -> None:
    """Put a file, or the names in a folder, on the disk. Raises OSError where that fails."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
