"""The command line: which commands there are. Each is imported when it is called."""

from __future__ import annotations

from hybrid_sysid_ros.commands.program import Commands, LateCommand, run_program
from hybrid_sysid_ros.support import extensions

GROUPS = {"model": "Models elsewhere.", "policy": "Approximate MPC.", "rig": "Rigs: a folder each."}
"""First words of commands of two words, and what those are about."""


def program() -> Commands:
    """All commands, the trunk's first, then those of the extensions."""
    single, groups = list[LateCommand](), {name: list[LateCommand]() for name in GROUPS}
    for words, (module, summary) in extensions.commands().items():
        group, _, name = words.rpartition(" ")
        place = groups.setdefault(group, []) if group else single
        place.append(LateCommand(name, module, summary))
    made = [Commands(name, commands, help=GROUPS.get(name, "")) for name, commands in groups.items()]
    return Commands("hybrid-sysid", [*single, *made])


def main() -> None:
    """Run a command of the command line."""
    run_program(program)
