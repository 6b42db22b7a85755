"""Libraries of the package's extras, which are imported where they are used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hybrid_sysid_ros.support.errors import UserError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Around imports of an extra's libraries: raises UserError, saying what to install, where one is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise UserError(
            f"{error.name} is missing; install the extra: pip install 'hybrid_sysid_ros[{name}]'"
        ) from error
