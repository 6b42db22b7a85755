"""hybrid-sysid frequency-response: gains and phases of a model and of bags."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.commands import options
from hybrid_sysid_ros.commands.records import read_records
from hybrid_sysid_ros.commands.terminal import console, print_table, status, typed
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.frequency_response import comparison
from hybrid_sysid_ros.extensions.frequency_response.report.page import write_page_of
from hybrid_sysid_ros.extensions.shared import report as reports
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.support.files import check_file

ROWS = 12
"""Most frequencies of a printed table."""


def command(
    model: options.ModelFolder,
    bag: Annotated[list[Path], typer.Argument(help="Bags whose inputs are used, and whose outputs are compared.")],
    as_json: options.Json = False,
    part: options.PartText = "0:1",
    report: Annotated[Path | None, typer.Option(help="Write an HTML page with gain, phase and coherence.")] = None,
    signals: options.SignalsFile = None,
    recover: options.Recover = False,
    read_period: options.ReadPeriod = 0.0,
    rig: options.OwnRig = "",
) -> None:
    """Compare the frequency response of a model's free run with that of bags, from the same inputs; the model's bands
    are what its parameters leave open.
    """
    if report is not None:
        reports.check_available()
        check_file(report, suffix=".html")
    loaded = load_model(model, rig=rig)
    records = read_records(bag, loaded.rig, signals, recover, read_period, loaded.sampling.input, model=loaded)
    found = [comparison.compared(loaded, experiment_of(loaded, record, part=Part.parse(part))) for record in records]
    if report is not None:
        status.print(str(write_page_of(report, loaded, found, reports.provenance(loaded, typed()))))
    if as_json:
        records_of = {item.name: comparison.response_content(item, loaded.system) for item in found}
        console.print_json(json.dumps({"model": str(model), "part": part, "records": records_of}))
        return
    for item in found:
        for k, _ in enumerate(loaded.system.outputs):
            for j, _ in enumerate(loaded.system.inputs):
                console.print(comparison.response_sentence(item, loaded.system, k, j))
                print_table(_table(item, loaded.system, k, j))


def _table(found: comparison.ResponseComparison, system: System, output: int, channel: int) -> Table:
    """Gains and phases at some frequencies from the lowest to the highest."""
    unit = f"{system.outputs[output].unit or '1'} per {system.inputs[channel].unit or '1'}"
    title = f"{found.name}: {system.outputs[output].name} by {system.inputs[channel].name} [{unit}]"
    heads = "frequency", "coherence", "measured", "model, 90 %", "measured", "model, 90 %"
    table, bands = Table(*heads, title=title), len(found.measured.frequencies)
    gains, phases = [
        [part(item) for item in (found.measured, found.simulated)] for part in (comparison.gain, comparison.phase)
    ]
    open_gain = comparison.WIDTHS[0.9] * found.gain_deviations
    open_phase = np.degrees(comparison.WIDTHS[0.9] * found.phase_deviations)
    for k in np.unique(np.linspace(0, bands - 1, min(ROWS, bands)).round().astype(int)):
        at = k, output, channel
        table.add_row(
            f"{found.measured.frequencies[k]:.3g} Hz", f"{found.measured.coherence[k, output]:.2f}",
            f"{gains[0][at]:.1f} dB", f"{gains[1][at]:.1f} ± {open_gain[at]:.2g} dB",
            f"{phases[0][at]:.0f} deg", f"{phases[1][at]:.0f} ± {open_phase[at]:.2g} deg",
        )  # fmt: skip
    return table
