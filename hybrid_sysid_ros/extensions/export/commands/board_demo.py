"""The demo on a board: a loop in C in the emulator drives the simulated rig over a serial line, and ROS watches."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands.terminal import print_lines, status
from hybrid_sysid_ros.extensions.export.board.companion import BoardLoop
from hybrid_sysid_ros.extensions.export.board.emulator import BoardEmulator
from hybrid_sysid_ros.extensions.export.board.folder import BOARDS, MANIFEST, export_board, missing_tools
from hybrid_sysid_ros.extensions.shared.demo_body import DemoBody, demo_folder
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.report.run_summary import RunSummary
from hybrid_sysid_ros.rigs.rig import default
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import processes
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import UserError, known
from hybrid_sysid_ros.support.files import check_folder, make_folder

SECONDS = 10.0
"""Of the loop, in simulated time."""
BODIES = ("native", *BOARDS)
"""The first is a demo of another extension."""


def instead(
    body: DemoBody = "",
    rig: str = "",
    out: Path | None = None,
    overwrite: bool = False,
    as_json: bool = False,
) -> Callable[[], dict[str, Any]] | None:
    """This demo instead of the usual one, where a board is the body."""
    if body and body not in BODIES:
        raise UserError(f"--body {body}: {known(body, BODIES)}")
    if body not in BOARDS:
        return None
    chosen = load_rig(rig or default())
    place = demo_folder(out, body, chosen)

    def run() -> dict[str, Any]:
        if lacking := missing_tools():
            raise UserError(f"--body {body}: {next(iter(lacking))} is not installed: {next(iter(lacking.values()))}")
        processes.check_ros()
        make_folder(place)
        check_folder(place / "board", marker=MANIFEST, replace=overwrite)
        check_folder(place / "loop", marker=bags.METADATA, replace=overwrite)
        folder = shipped(chosen.name, "model")
        model = load_model(folder, rig=chosen.source)
        status.print(f"1 exporting the loop of {chosen.name} for a Cortex-{BOARDS[body].core}")
        done, found = export_board(
            chosen, model, place / "board", board=body, settings={"real_time": True}, seal=model.seal,
            overwrite=overwrite,
        )  # fmt: skip
        assert found is not None
        status.print(f"2 {SECONDS:g} s of the loop, in simulated time: the board drives, ROS watches")
        with BoardEmulator(place / "board") as board:
            outcome = Run(
                rig=chosen.source, model=folder, policy="exact", duration=SECONDS, bag=place / "loop",
                overwrite=overwrite, lockstep=True, companions=[BoardLoop(port=board.port, baud=115200)],
                tell=status.print,
            ).go()  # fmt: skip
        summary = RunSummary.of(outcome.diagnostics, chosen, bag=outcome.bag, lockstep=True)
        if not as_json:
            print_lines(
                {
                    "board": f"{done.periods['recorded']} periods as in Python, inputs to {found.difference:.1e}; a "
                    f"period takes {found.median} instructions (median; most {found.most}), flash {found.flash} bytes",
                    **summary.lines,
                },
                summary.alarms,
            )
        return dict(summary.content)

    return run
