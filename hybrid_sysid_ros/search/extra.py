"""The libraries of the extra [search], which are imported where they are used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hybrid_sysid_ros.errors import UserError


@contextmanager
def extra() -> Iterator[None]:
    """Around imports of Optuna, joblib and Dask: raises UserError, saying what to install, where one is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise UserError(
            f"{error.name} is missing; install the extra: pip install 'hybrid_sysid_ros[search]'"
        ) from error
