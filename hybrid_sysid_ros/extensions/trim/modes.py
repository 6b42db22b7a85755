"""Modes: by what names the ways are known in which a rig moves about an equilibrium."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.trim.equilibrium import Eigenmode
from hybrid_sysid_ros.rigs.drivers import index_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import refuse_unknown, section

LEAST = 0.5
"""Share of a name's states in a mode that goes by it."""


@dataclass(frozen=True, kw_only=True)
class NamedMode:
    """What a mode of motion is known by."""

    states: tuple[str, ...]
    """Those that it moves."""
    oscillates: bool | None = None
    """Whether it does; None: it may."""


def named_modes(rig: Rig) -> dict[str, NamedMode]:
    """From the section of its rig.yaml, by their names. Raises UserError for what is wrong in it."""
    found: dict[str, NamedMode] = {}
    given, where = section(rig.content, "modes", str(rig.file)), f"{rig.file}: modes"
    for name, value in given.items():
        here, content = f"{where}.{name}", section(given, name, where)
        refuse_unknown(content, ("states", "oscillates"), here)
        states, oscillates = content.get("states"), content.get("oscillates")
        if not isinstance(states, list) or not isinstance(oscillates, bool | None):
            raise UserError(f"{here} is {value!r}: it needs a list of states, and whether it oscillates, true or false")
        for state in states:
            index_of(state, rig.system.declared_states, f"{here}.states", "state")
        found[name] = NamedMode(states=tuple(states), oscillates=oscillates)
    return found


def mode_name(mode: Eigenmode, system: System, known: Mapping[str, NamedMode]) -> str:
    """The name of which the states have the largest share in a mode of a system, "" where none fits."""
    names = [item.name for item in system.declared_states]
    shares = dict(zip(names, mode.shares.tolist(), strict=True))
    fitting = {
        name: sum(shares.get(state, 0.0) for state in item.states)
        for name, item in known.items()
        if item.oscillates in (None, mode.oscillates)
    }
    best = max(fitting, key=lambda name: fitting[name], default="")
    return best if fitting.get(best, 0.0) >= LEAST else ""
