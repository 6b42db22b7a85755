"""The command that does the demo on the author's records."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Overwrite
from hybrid_sysid_ros.extensions.demo.commands.demo import OUT, Out, Train, demo
from hybrid_sysid_ros.extensions.shared.demo_recipe import RecordSplit
from studies.beam_lecture.lecture import RIG, arrange, read_folder, table_name


def command(
    folder: Annotated[Path, typer.Argument(help="Folder with the author's .mat files, or with the folder bab.")],
    out: Out = None,
    train: Train = False,
    overwrite: Overwrite = False,
) -> None:
    """The demo on the author's records: protocol 2, then the loop."""
    protocol = arrange(read_folder(folder), 2)
    names = {record.name: table_name(record.name) for record, _ in protocol.tests}
    records = RecordSplit(
        training=protocol.training, part=protocol.part, tests=protocol.tests, names=names, source="real"
    )
    demo(out or OUT, records, rig=RIG, train=train, overwrite=overwrite)
