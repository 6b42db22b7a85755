"""Disk: the recorder on a disk that fails as the file named by DISK_TROUBLE says: full, read-only, slow, or not."""

from __future__ import annotations

import errno
import os
import sys
import time
from pathlib import Path

from hybrid_sysid_ros.nodes import recorder

TROUBLE = "DISK_TROUBLE"
ERRORS = {"full": errno.ENOSPC, "read-only": errno.EROFS}
SLOW = 1.0
"""Time of a slow disk for a block [s]."""


def main() -> int:
    """Run the recorder node."""
    path, write, synchronise = Path(os.environ[TROUBLE]), os.pwrite, os.fsync

    def failing_write(descriptor: int, data: bytes, offset: int) -> int:
        if number := ERRORS.get(path.read_text()):
            raise OSError(number, os.strerror(number))
        return write(descriptor, data, offset)

    def slow_synchronise(descriptor: int) -> None:
        if path.read_text() == "slow":
            time.sleep(SLOW)
        synchronise(descriptor)

    os.pwrite, os.fsync = failing_write, slow_synchronise  # type: ignore[assignment]
    return recorder.main()


if __name__ == "__main__":
    sys.exit(main())
