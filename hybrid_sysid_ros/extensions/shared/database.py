"""The database in which Optuna keeps studies."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.files import beside

if TYPE_CHECKING:
    import optuna

SQLITE = b"SQLite format 3\0"


@contextmanager
def database(place: str) -> Iterator[optuna.storages.RDBStorage]:
    """An open database: an SQLite file, made where there is none, or by its URL another that Optuna takes.

    Raises UserError where it is something else, can't be read or written, or (a file) is open in another process.
    """
    with extra("search"):
        from optuna.exceptions import StorageInternalError
        from optuna.storages import RDBStorage
        from sqlalchemy.exc import SQLAlchemyError

    file = None if "://" in place else Path(place).absolute()
    with nullcontext() if file is None else _alone(file):
        try:
            storage = RDBStorage(place if file is None else f"sqlite:///{file}")
        except (SQLAlchemyError, ImportError, RuntimeError) as error:  # RuntimeError: tables of another Optuna
            raise _unusable(place, error) from error
        try:
            yield storage
        except (SQLAlchemyError, StorageInternalError) as error:
            raise _unusable(place, error) from error
        finally:
            storage.remove_session()
            storage.engine.dispose()


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold the lock of an SQLite file; it ends with the process, however that ends. The empty file PATH.lock stays."""
    if path.is_dir():
        raise UserError(f"{path}: is a folder, not a file: choose another --study")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            with path.open("rb") as content:
                if content.read(len(SQLITE)) not in (b"", SQLITE):
                    raise UserError(f"{path}: is no SQLite file: choose another --study")
        lock = beside(path, ".lock").open("w")
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}): choose another --study") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(f"{path}: another search works on it: wait for it, or choose another --study") from None
        yield


def _unusable(place: str, error: Exception) -> UserError:
    reason = str(error.__cause__ or error).splitlines()[0]
    return UserError(f"{place}: can't be read or written as a study ({reason}): choose another --study")
