"""Compiled functions for loops that are not yet written by addresses: to go with its last user."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.compiled import compiled
from hybrid_sysid_ros.core.system import System


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """step(x, u, p, w, h, following): one step; ``following`` (states,) receives the new state."""

    step: Callable[..., None]


_KERNELS: dict[Any, Kernels] = {}


def kernels(system: System) -> Kernels:
    """The step of a system's form."""
    if system.form not in _KERNELS:
        address = compiled(system).step

        @inner
        def step(x: Any, u: Any, p: Any, w: Any, h: float, following: Any) -> None:
            call_value(address, x, u, p, w, h, 0.0, following)

        _KERNELS[system.form] = Kernels(step=step)
    return _KERNELS[system.form]
