"""python -m studies.beam_lecture import | protocol | demo."""

from __future__ import annotations

from hybrid_sysid_ros.commands.app import Commands, LateCommand, run_program
from hybrid_sysid_ros.support import interruption

HERE = "studies.beam_lecture"
COMMANDS = [
    LateCommand("import", f"{HERE}.import_records", "Turn the author's .mat files into bags."),
    LateCommand("protocol", f"{HERE}.protocol", "Reproduce the lecture's table of free runs with every structure."),
    LateCommand("demo", f"{HERE}.demo", "The demo on the author's records: protocol 2, then the loop."),
]


def main() -> None:
    """Run a command of the study."""
    run_program(lambda: Commands(f"python -m {HERE}", COMMANDS))


if __name__ == "__main__":
    interruption.install()
    main()
