"""Code cache: numba's files of compiled code, each with a checksum, so that one that was damaged is never run."""

from __future__ import annotations

import fcntl
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO

from numba.core import config
from numba.core.caching import IndexDataCacheFile

from hybrid_sysid_ros.support.errors import warn

_SIZE = 16  # bytes of a checksum
_NEEDED = ("load", "save", "_index_path", "_load_index", "_data_path", "_load_data", "_open_for_write")


def missing_names() -> list[str]:
    """Private names that this module needs and numba does not have."""
    found = IndexDataCacheFile("", "", None)
    return [f"IndexDataCacheFile.{name}" for name in _NEEDED if not hasattr(found, name)]


class CheckedCacheFile(IndexDataCacheFile):  # type: ignore[misc]
    """The compiled code of a function: numba's index and data, and behind each a checksum of its name and content.

    What was cut or altered is removed with a warning before anything of it is unpacked, and made again. numba keeps the
    code of each place of a source apart; here every copy of a package shares it, as it is known by its content.
    """

    def __init__(self, cache_path: str, filename_base: str, source_stamp: object) -> None:
        parent = os.path.dirname(cache_path)
        super().__init__(parent if parent == config.CACHE_DIR else cache_path, filename_base, source_stamp)

    def load(self, key: Any) -> Any:
        """What was compiled for a key, or None. Raises nothing for what is on the disk."""
        with suppress(OSError):
            return super().load(key)
        return None

    def save(self, key: Any, data: Any) -> None:
        """Keep it, one process at a time: two that keep code for other arguments could give one the other's."""
        try:
            with Path(self._cache_path, "lock").open("w") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                super().save(key, data)
        except OSError as error:
            warn(f"compiled code can't be kept, so that the next process compiles anew: {error}")

    def _load_index(self) -> Any:
        return super()._load_index() if _is_whole(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)
        return super()._load_data(name) if _is_whole(path) else None

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BinaryIO]:
        with super()._open_for_write(filepath) as file:
            content = io.BytesIO()
            yield content
            file.write(content.getvalue() + _checksum(filepath, content.getbuffer()))


def _checksum(path: str, content: memoryview) -> bytes:
    """Of a file's content without the checksum: another file's content has another one."""
    return blake2b(content, digest_size=_SIZE, key=os.path.basename(path).encode()[-64:]).digest()


def _is_whole(path: str) -> bool:
    """Whether a file is as it was written; one that is not is removed, with a warning."""
    try:
        content = memoryview(Path(path).read_bytes())
    except FileNotFoundError:
        return False
    if content[-_SIZE:] == _checksum(path, content[:-_SIZE]):
        return True
    warn(f"{path} is damaged: its compiled code is made again")
    with suppress(OSError):
        os.remove(path)
    return False
