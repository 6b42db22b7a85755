"""python -m studies.beam_lecture import | protocol | demo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.program import new_app, run_app
from hybrid_sysid_ros.commands.terminal import console, status
from hybrid_sysid_ros.support import interruption
from studies.beam_lecture.protocol import protocol_command

app = new_app()
app.command("protocol")(protocol_command)


@app.command("import")
def import_command(
    folder: Annotated[Path, typer.Argument(help="Folder with the author's .mat files.")],
    out: Annotated[Path, typer.Argument(help="Folder for the bags.")],
) -> None:
    """Turn the author's records of the cam-driven beam into bags, at their full rate."""
    from studies.beam_lecture.records import import_folder

    for path in import_folder(folder, out, progress=status.print):
        console.print(str(path))


@app.command("demo")
def demo_command(
    folder: Annotated[Path, typer.Argument(help="Folder with the author's .mat files, or with the folder bab.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("out/demo"),
    train: Annotated[bool, typer.Option("--train", help="Train model and policy afresh.")] = False,
) -> None:
    """The demo on the author's records: protocol 2, then the loop."""
    from hybrid_sysid_ros.commands.demo import Records, demo
    from studies.beam_lecture.lecture import arrange, read_folder, table_name

    protocol = arrange(read_folder(folder), 2)
    names = {record.name: table_name(record.name) for record, _ in protocol.tests}
    records = Records(training=protocol.training, part=protocol.part, tests=protocol.tests, names=names, source="real")
    demo(out, records, train=train)


if __name__ == "__main__":
    interruption.install()
    run_app(app, "python -m studies.beam_lecture")
