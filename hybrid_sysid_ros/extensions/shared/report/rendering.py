"""Rendering: the report as one self-contained HTML page with figures and numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.shared.report.loop_views import zooms
from hybrid_sysid_ros.extensions.shared.report.residual_patterns import patterns
from hybrid_sysid_ros.extensions.shared.report.sections import FREE, FreeRunSection, IdentificationSection, Provenance
from hybrid_sysid_ros.extensions.shared.report.verdict import verdict
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.validation.identifiability import at_bound
from hybrid_sysid_ros.report.inspection import FurtherSection, Inspection
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection
from hybrid_sysid_ros.report.run_summary import RunSummary
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.files import write_text

TEMPLATES = Path(__file__).parent
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
CONFIG = {
    "displaylogo": False,
    "showSendToCloud": False,  # plotly would offer to upload measurements
    "plotlyServerURL": "",
    "responsive": True,
    "modeBarButtonsToRemove": ["select2d", "lasso2d", "autoScale2d"],
    "toImageButtonOptions": {"format": "svg"},
}


def check_available() -> None:
    """Raise UserError where the libraries of reports are not installed."""
    with extra("report"):
        import jinja2  # noqa: F401
        import plotly  # noqa: F401


def write_report(
    path: Path | str,
    identification: IdentificationSection,
    closed_loop: ClosedLoopSection | None,
    provenance: Provenance,
    summary: RunSummary | None = None,
    driver: str = "",
    inspections: Sequence[Inspection] = (),
) -> Path:
    """Write the report; an older one is replaced once the new one is whole. summary: of the run that made the loop.
    driver: a sentence on who drove it. inspections: what extensions found of the model.

    Raises UserError where plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    content = {
        "title": f"{identification.model.rig}: {identification.model.structure} model",
        "part": identification_content(identification),
        "closed": None if closed_loop is None else closed_content(closed_loop),
        "summary": summary,
        "verdict": verdict(identification, summary, driver),
        "drawing": _drawing(identification.model.rig),
        "further": [
            {
                "name": name,
                "section": made,
                "figures": [drawn(item, f"{name}-{k}") for k, item in enumerate(made.figures)],
            }
            for name, made in [
                *((item.name, item.section) for item in inspections),
                *_further_sections(identification, closed_loop),
            ]
        ],
        "provenance": provenance,
        "hashes": _hashes(identification, closed_loop, provenance),
    }
    return write_page(path, TEMPLATES / "page.html", content)


def _further_sections(
    identification: IdentificationSection, closed_loop: ClosedLoopSection | None
) -> Iterator[tuple[str, FurtherSection]]:
    """Name and section of each extension that has one for this model and loop. A section that fails is replaced by the
    reason, so that the rest of a report does not depend on it.
    """
    for name, make in extensions.provided("report").items():
        try:
            made = make(identification, closed_loop)
        except Exception as error:  # another package's code can raise anything
            made = FurtherSection(title=name, text=f"This section could not be made: {type(error).__name__}: {error}")
        if made is not None:
            yield name, made


def _drawing(rig: str) -> str:
    """The rig's drawing from the first extension that has one, "" without any."""
    makers = extensions.provided("drawings").values()
    return next(filter(None, (make(rigs.load(rig)) for make in makers)), "")


def write_page(path: Path | str, template: Path, content: Mapping[str, Any], **filters: Callable[..., str]) -> Path:
    """Write a page; an older one is replaced once the new one is whole. A template may use those of this package.

    filters: further filters of the template.

    Raises UserError where the place cannot be written.
    """
    from plotly.offline import get_plotlyjs

    environment = _environment(template.parent)
    environment.filters.update(
        filters, significant=significant, probability=probability, part=part_text, sentence=sentence, seconds=seconds
    )
    text = environment.get_template(template.name).render(plotly=get_plotlyjs(), **content)
    write_text(path, text)
    return Path(path)


@cache
def _environment(folder: Path) -> Any:
    """The templates of a folder and of this package, which are compiled once."""
    import jinja2

    loader = jinja2.FileSystemLoader([folder, TEMPLATES])
    return jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)


def drawn(figure: Any, name: str) -> str:
    """A figure as HTML; name: unique among the page's figures and headings."""
    import plotly.io

    html = plotly.io.to_html(figure, config=CONFIG, include_plotlyjs=False, full_html=False, div_id=f"figure-{name}")
    return str(html)


def identification_content(section: IdentificationSection, prefix: str = "") -> dict[str, Any]:
    """Content of a page's blocks on a model and its free runs; prefix: that of the figures' ids."""
    from hybrid_sysid_ros.extensions.shared.report import figures

    runs, kind, system = section.runs, section.model.kind, section.model.system
    curves: dict[str, list[FreeRunSection]] = {}  # by output, since each has its own unit
    for run in runs:
        if np.isfinite(run.horizons.rmse).any():
            curves.setdefault(run.output.name, []).append(run)
    return {
        "prefix": prefix,
        "model": section.model,
        "runs": [_run(run, section) for run in runs],
        "kind": runs[0].kind if runs else FREE,
        "free": not runs or runs[0].kind == FREE,
        "free_runs": [drawn(figures.free_run(run), f"{prefix}free-run-{number}") for number, run in enumerate(runs)],
        "tests": section.tests,
        "patterns": list(patterns(section)),
        "residual_tests": drawn(figures.residual_tests(section), f"{prefix}residual-tests") if section.tests else "",
        "horizons": [
            drawn(
                figures.horizons([run.horizons for run in found], found[0].display),
                f"{prefix}horizon-curves" + (f"-{number}" if number else ""),
            )
            for number, found in enumerate(curves.values())
        ],
        "parameters": list(_parameters(section)),
        "lines": kind.lines(system),
        "figures": [drawn(figure, f"{prefix}{name}") for name, figure in kind.figures(system).items()],
        "correlated": section.correlated,
        "doubts": section.doubts,
    }


def significant(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits, without an exponent where it is readable."""
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    if value != 0.0 and not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPT)}"
    else:
        places = digits - 1 - (math.floor(math.log10(abs(value))) if value else 0)
        text = f"{value:.{max(places, 0)}f}"
    return text.replace("-", "\N{MINUS SIGN}")


def seconds(value: float) -> str:
    """A time [s] to a tenth, or to two significant digits below one second."""
    return f"{value:.1f}" if value >= 1.0 else f"{value:.2g}"


def probability(value: float) -> str:
    """A p-value, down to the smallest meaningful one."""
    return "< 0.0001" if value < 1e-4 else f"{value:.4f}"


def sentence(text: str) -> str:
    """A text with a capital at its beginning; names in it are not changed."""
    return text[:1].upper() + text[1:]


def part_text(part: Part) -> str:
    """A part of a record in words."""
    return "whole" if (part.start, part.stop) == (0.0, 1.0) else f"{part.start:g} to {part.stop:g}"


def amount(value: float, unit: str) -> str:
    """A number with its unit."""
    text = f"{value:.3f}" if abs(value) >= 0.01 or value == 0.0 else f"{value:.3g}"
    return f"{text}{'' if unit.startswith('°') else ' '}{unit}".replace("-", "\N{MINUS SIGN}")


def _run(run: FreeRunSection, section: IdentificationSection) -> dict[str, Any]:
    """A row of the tables of free runs."""
    from hybrid_sysid_ros.extensions.shared.report.charts import second_scale

    display, actuated = run.display, section.model.system.inputs[0]
    shown = float(display.shown(run.scores.rmse))
    second = second_scale(run.output, display)
    return {
        "run": run,
        "rmse": amount(shown, display.unit),
        "second": "" if second is None else amount(second[1] * shown, second[0]),
        "tests": [run.tests.get(key) for key in section.tests],
        "again_rmse": "" if run.again is None else amount(float(display.shown(run.again.output.rmse)), display.unit),
        "again_input": "" if run.again is None else amount(run.again.input.rmse, actuated.unit),
    }


def _parameters(section: IdentificationSection) -> Iterator[dict[str, Any]]:
    """Rows of the table of parameters."""
    errors = section.model.standard_errors
    for item, value in zip(section.model.system.parameters, section.model.system.values, strict=True):
        if item.learned:
            continue
        yield {
            "item": item,
            "value": float(value),
            "error": errors.get(item.name),
            "share": 100.0 * (float(value) - item.low) / (item.high - item.low),
            "at_bound": at_bound(item, float(value), errors.get(item.name, np.inf)),
        }


def closed_content(section: ClosedLoopSection) -> dict[str, Any]:
    """Content of a page's blocks on a recorded loop."""
    from hybrid_sysid_ros.extensions.shared.report import loop_figures

    loop = section.loop
    return {
        "section": section,
        "rmse": section.rmse,
        "units": section.units,
        "tracking": drawn(loop_figures.tracking(section), "tracking"),
        "zooms": [
            (name, window, drawn(loop_figures.zoom(section, window), f"zoom-{number}"))
            for number, (name, window) in enumerate(zooms(section).items())
        ],
        "delays": drawn(loop_figures.delays(section), "delays"),
        "timing": loop.delays() if loop.is_real_time else loop.turnarounds(),
    }


def _hashes(
    identification: IdentificationSection, closed_loop: ClosedLoopSection | None, provenance: Provenance
) -> dict[str, str]:
    """SHA-256 of all data behind the report, by name."""
    found = dict(provenance.hashes)
    found.update({f"record, {run.record}": run.digest for run in identification.runs})
    if closed_loop is not None:
        found[f"loop, {closed_loop.loop.name}"] = closed_loop.loop.digest
    return {name: digest for name, digest in found.items() if digest}
