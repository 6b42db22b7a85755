"""Other packages' private parts that are used here: the versions known to work, and the cost of the fall-back."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from hybrid_sysid_ros.support.errors import UserError, warn

FALL_BACK = "HYBRID_SYSID_FALL_BACK"
"""Environment variable with names of guarded parts, separated by commas, for which the fall-back is used."""
WARNED = "HYBRID_SYSID_FALL_BACK_WARNED"
"""Environment variable with the parts of which this process, or the one that started it, has warned already."""


@cache
def installed(package: str) -> str:
    """Version of an installed package."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "of unknown version"


@dataclass(frozen=True, kw_only=True)
class Guarded:
    """A private part of another package, which a release may change."""

    package: str
    part: str
    """Name of the part."""
    known: tuple[str, ...]
    """Tested releases, such as 0.68; empty where only missing names decide."""
    cost: str
    """Cost of the fall-back; empty where there is none."""

    @property
    def name(self) -> str:
        """The name for FALL_BACK."""
        return f"{self.package}.{self.part}"

    def usable(self, missing: Sequence[str] = ()) -> bool:
        """Whether it may be used. Where it may not, the first call in a process, and in those that it starts, warns of
        the cost.

        missing: private names that the installed package lacks. Raises UserError where there is no fall-back.
        """
        trouble = self._trouble(missing)
        if not trouble:
            return True
        if not self.cost:
            raise UserError(f"{trouble}: install {self.package} {' or '.join(self.known)}")
        warned = os.environ.get(WARNED, "").split(",")
        if self.name not in warned:
            os.environ[WARNED] = ",".join([*warned, self.name])
            warn(f"{trouble}: {self.cost}")
        return False

    def _trouble(self, missing: Sequence[str]) -> str:
        """Why it may not be used."""
        if self.name in os.environ.get(FALL_BACK, "").split(","):
            return f"{FALL_BACK} names {self.name}"
        found = installed(self.package)
        if self.known and not any(f"{found}.".startswith(f"{release}.") for release in self.known):
            return f"{self.package} {found} is not known to work (known: {', '.join(self.known)})"
        return f"{self.package} {found} has no {', '.join(missing)}" if missing else ""


NUMBA_COMPILER = Guarded(
    package="numba",
    part="compiler",
    known=("0.68",),
    cost="every function is compiled at every level of calls, so that the first compilation takes four times as long",
)
NUMBA_CACHE = Guarded(
    package="numba",
    part="cache",
    known=(),
    cost="compiled code is not kept on disk, so that every process compiles anew",
)
RCLPY_EXECUTOR = Guarded(
    package="rclpy",
    part="executor",
    known=("7.1",),
    cost="its own executor is used, which takes about half as much processor time again for a loop",
)
DAQP_STRUCTURES = Guarded(package="daqp", part="structures", known=("0.11",), cost="")
