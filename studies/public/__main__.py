"""python -m studies.public [run [FOLDER] | identibench NAME]."""

from __future__ import annotations

import sys

from hybrid_sysid_ros.commands.app import Commands, LateCommand, run_program
from hybrid_sysid_ros.support import interruption

HERE = "studies.public"
COMMANDS = [
    LateCommand("run", f"{HERE}.study", "Fit and score every kind of structure on the public sets."),
    LateCommand("identibench", f"{HERE}.identibench", "Run a specification of identibench with a state space."),
]


def main() -> None:
    """Run a command of the study; without one, all of it."""
    if len(sys.argv) == 1:
        sys.argv.append("run")
    run_program(lambda: Commands(f"python -m {HERE}", COMMANDS))


if __name__ == "__main__":
    interruption.install()
    main()
