"""hybrid-sysid trim: where a rig stays as it is, and the modes in which it moves about there."""

from __future__ import annotations

import json
import math
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.commands.options import RigPlace
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.trim.equilibrium import Eigenmode, Equilibrium, equilibrium
from hybrid_sysid_ros.extensions.trim.modes import mode_name, named_modes
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.rigs.validity import check_reached, check_valid
from hybrid_sysid_ros.support.errors import UserError

SOLVED = 1e-12
"""Below which a solved value is shown as 0."""
INVOLVED = 0.1
"""Share in a mode from which on a state is named."""


def command(
    rig: RigPlace,
    at: Annotated[
        list[str] | None,
        typer.Option("--at", metavar="NAME=VALUE", help="Fixed value of a state or input; the others are computed."),
    ] = None,
    structure: Annotated[str, typer.Option(help="Use one of the rig's own gray-box models in place of the rig.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, including the linear system.")] = False,
) -> None:
    """Find an equilibrium of a rig, linearise it there, and name its poles."""
    described = load(rig)
    if structure and structure not in described.structures:
        known = ", ".join(described.structures) or "none"
        raise UserError(f"{described.name} has no gray box {structure} of its own; it has {known}")
    system = described.structures[structure] if structure else described.system
    given = _values(at or [])
    wanted = np.array([[given.get(item.name, np.nan) for item in system.states]])
    check_valid(described, wanted, "--at", system=system)  # the search finds nothing far outside and can't say why
    found = equilibrium(system, given)
    check_valid(described, found.states[None], "the equilibrium", system=system)
    check_reached(described, found.inputs, "the equilibrium")
    known_modes = named_modes(described)
    named = [(mode, mode_name(mode, system, known_modes)) for mode in found.modes]
    if as_json:
        console.print_json(json.dumps(_content(system, found, named)))
        return
    print_table(_point(system, found, f"{described.name}: {type(system).__name__} stays at"))
    print_table(_modes(system, named))


def _values(texts: list[str]) -> dict[str, float]:
    """NAME=VALUE by name. Raises UserError for anything else."""
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name.strip() in found:
            raise UserError(f"--at {text!r}: {name.strip()} is given twice; leave one out")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            raise UserError(f"--at {text!r}: write NAME=VALUE, as in {name.strip() or 'angle'}=0.1") from None
        if not math.isfinite(found[name.strip()]):
            raise UserError(f"--at {text!r}: needs a finite number")
    return found


def _point(system: System, found: Equilibrium, title: str) -> Table:
    """States and inputs; where these are deviations also as whole values, and angles also in degrees."""
    whole = bool(system.operating_point)
    table = Table("", "value", "unit", *(["whole value"] if whole else []), "", title=title)
    pairs = [*zip(system.declared_states, found.states.tolist(), strict=False)]
    for item, solved in (*pairs, *zip(system.inputs, found.inputs.tolist(), strict=True)):
        value = solved if abs(solved) > SOLVED else 0.0
        total = value + system.operating_point.get(item.name, 0.0)
        degrees = f"{math.degrees(total):.4f} {item.unit.replace('rad', 'deg')}" if "rad" in item.unit else ""
        table.add_row(item.name, f"{value:.6g}", item.unit, *([f"{total:.6g}"] if whole else []), degrees)
    return table


def _modes(system: System, named: list[tuple[Eigenmode, str]]) -> Table:
    table = Table("mode", "poles [1/s]", "", "moves", title="modes of the linear system there")
    for mode, name in named:
        involved = [
            f"{item.name} {share:.2f}"
            for item, share in sorted(zip(system.declared_states, mode.shares, strict=True), key=lambda pair: -pair[1])
            if share >= INVOLVED
        ]
        table.add_row(name, _poles(mode), _character(mode), ", ".join(involved))
    return table


def _poles(mode: Eigenmode) -> str:
    real = f"{mode.pole.real:+.5g}"
    return f"{real} +- {mode.pole.imag:.5g}j" if mode.oscillates else real


def _character(mode: Eigenmode) -> str:
    """What a pole does, in words."""
    real, size = mode.pole.real, abs(mode.pole)
    if size < 1e-9:
        return "integrates"
    if mode.oscillates:
        return f"{size:.4g} rad/s, damping {mode.damping:.3g}"
    return f"{'doubles' if real > 0.0 else 'halves'} in {math.log(2.0) / abs(real):.4g} s"


def _content(system: System, found: Equilibrium, named: list[tuple[Eigenmode, str]]) -> dict[str, Any]:
    states = [item.name for item in system.declared_states]
    point = np.concatenate([found.states[: len(states)], found.inputs]).tolist()
    names = [*states, *(item.name for item in system.inputs)]
    modes = [
        {"name": name, "pole": [mode.pole.real, mode.pole.imag], "shares": dict(zip(states, mode.shares, strict=True))}
        for mode, name in named
    ]
    values = dict(zip(names, point, strict=True))
    return {
        "at": values,
        "whole": {name: value + system.operating_point.get(name, 0.0) for name, value in values.items()},
        "A": found.transition.tolist(),
        "B": found.gain.tolist(),
        "modes": modes,
    }
