"""python -m studies.drill_string record|choose FOLDER."""

from __future__ import annotations

from hybrid_sysid_ros.commands.app import Commands, LateCommand, run_program
from hybrid_sysid_ros.support import interruption

HERE = "studies.drill_string"
COMMANDS = [
    LateCommand("record", f"{HERE}.study", "The public record: clean it, learn from one half, run the other."),
    LateCommand("choose", f"{HERE}.choice", "Search the observer's noises on the first half."),
]


def main() -> None:
    """Run a command of the study."""
    run_program(lambda: Commands(f"python -m {HERE}", COMMANDS))


if __name__ == "__main__":
    interruption.install()
    main()
