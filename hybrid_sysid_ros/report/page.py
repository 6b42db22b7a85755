"""The page: sections and figures in one HTML file with everything in it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.files import written_file
from hybrid_sysid_ros.identification import Scores
from hybrid_sysid_ros.report.sections import ClosedLoopSection, FreeRun, IdentificationSection, Provenance
from hybrid_sysid_ros.rigs.sensor import Sensor

TEMPLATE = Path(__file__).with_name("page.html")
NEEDED = ("jinja2", "plotly")
AT_BOUND = 0.01  # of the distance between a parameter's bounds
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
CONFIG = {
    "displaylogo": False,
    "showSendToCloud": False,  # measurements stay where they are: plotly would offer to upload them
    "plotlyServerURL": "",
    "responsive": True,
    "modeBarButtonsToRemove": ["select2d", "lasso2d", "autoScale2d"],
    "toImageButtonOptions": {"format": "svg"},
}


def check_available() -> None:
    """Raise UserError if what draws a report is not installed."""
    for name in NEEDED:
        try:
            import_module(name)
        except ModuleNotFoundError as error:
            if error.name != name:
                raise
            raise UserError(f"a report needs {name}: install it with pip install 'hybrid_sysid_ros[report]'") from error


def write(
    path: Path | str,
    identification: IdentificationSection,
    closed_loop: ClosedLoopSection | None,
    provenance: Provenance,
) -> Path:
    """Write the report; an older one is replaced once the new one is whole.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    text = page(identification, closed_loop, provenance)
    with written_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return Path(path)


def page(identification: IdentificationSection, closed_loop: ClosedLoopSection | None, provenance: Provenance) -> str:
    """The report as text."""
    import jinja2
    import plotly.io
    from plotly.offline import get_plotlyjs

    from hybrid_sysid_ros.report import figures

    def drawn(figure: Any, name: str) -> str:
        html = plotly.io.to_html(figure, config=CONFIG, include_plotlyjs=False, full_html=False, div_id=name)
        return str(html)

    sensor = identification.sensor
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters.update(significant=significant, probability=probability)
    closed: dict[str, Any] | None = None
    if closed_loop is not None:
        closed = {
            "section": closed_loop,
            "rmse": {name: closed_loop.loop.tracking_rmse(*window) for name, window in closed_loop.windows.items()},
            "tracking": drawn(figures.tracking(closed_loop), "tracking"),
            "zooms": {
                name: drawn(figures.zoom(closed_loop, name), f"zoom-{number}")
                for number, name in enumerate(closed_loop.zooms)
            },
            "delays": drawn(figures.delays(closed_loop), "delays"),
            "timing": closed_loop.loop.delays() if closed_loop.loop.is_real_time else closed_loop.loop.turnarounds(),
        }
    tested = any(run.white for run in identification.runs)
    content = {
        "title": f"{identification.model.rig}: {identification.model.structure} model",
        "model": identification.model,
        "runs": [_run(run, sensor) for run in identification.runs],
        "free_runs": [
            drawn(figures.free_run(run, sensor), f"free-run-{number}") for number, run in enumerate(identification.runs)
        ],
        "residual_tests": drawn(figures.residual_tests(identification), "residual-tests") if tested else "",
        "parameters": list(_parameters(identification)),
        "correlated": identification.correlated,
        "closed": closed,
        "provenance": provenance,
        "hashes": _hashes(identification, closed_loop, provenance),
        "plotly": get_plotlyjs(),
    }
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(content)


def significant(value: float | None, digits: int = 4) -> str:
    """A number with so many digits that count, without an exponent where it can be read."""
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    if value != 0.0 and not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPT)}"
    else:
        places = digits - 1 - (math.floor(math.log10(abs(value))) if value else 0)
        text = f"{value:.{max(places, 0)}f}"
    return text.replace("-", "\N{MINUS SIGN}")


def probability(value: float) -> str:
    """A p-value, as far down as it says anything."""
    return "< 0.0001" if value < 1e-4 else f"{value:.4f}"


def _run(run: FreeRun, sensor: Sensor) -> dict[str, Any]:
    """A row of the table of free runs."""
    scores: Scores = run.scores
    return {
        "run": run,
        "part": "whole"
        if (run.part.start, run.part.stop) == (0.0, 1.0)
        else f"{run.part.start:g} to {run.part.stop:g}",
        "seconds": float(run.time[-1]),
        "r2": scores.r2,
        "fit": scores.fit_percent,
        "volts": float(sensor.volts(np.float64(scores.rmse))),
        "degrees": math.degrees(scores.rmse),
        "tests": (run.white, run.against_input, run.against_reference),
    }


def _parameters(section: IdentificationSection) -> Iterator[dict[str, Any]]:
    """Rows of the table of parameters."""
    errors = section.model.standard_errors
    for item, value in zip(section.model.equation.parameters, section.model.equation.values, strict=True):
        share = (float(value) - item.low) / (item.high - item.low)
        yield {
            "item": item,
            "value": float(value),
            "error": errors.get(item.name),
            "share": 100.0 * share,
            "at_bound": not item.fixed and not AT_BOUND < share < 1.0 - AT_BOUND,
        }


def _hashes(
    identification: IdentificationSection, closed_loop: ClosedLoopSection | None, provenance: Provenance
) -> dict[str, str]:
    """SHA-256 of everything that the report rests on, by name."""
    found = dict(provenance.hashes)
    found.update({f"record, {run.name}": run.digest for run in identification.runs})
    if closed_loop is not None:
        found[f"loop, {closed_loop.loop.name}"] = closed_loop.loop.digest
    return {name: digest for name, digest in found.items() if digest}
