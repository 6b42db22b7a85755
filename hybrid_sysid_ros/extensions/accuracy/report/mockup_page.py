"""The page of a mock-up: its verdict, and what that rests on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.extensions.accuracy.mockup import Found
from hybrid_sysid_ros.extensions.accuracy.report.accuracy_page import accuracy_rows
from hybrid_sysid_ros.report.rendering import check_available, drawn, write_page
from hybrid_sysid_ros.report.sections import Provenance


def write_mockup(path: Path | str, found: Found, provenance: Provenance) -> Path:
    """Write the page.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    from hybrid_sysid_ros.extensions.accuracy.report import mockup_figures

    kept = all(line.kept for line in found.verdict)
    content = {
        "title": f"{found.setup.rig.name}: {'fit for use' if kept else 'not fit for use'}",
        "found": found,
        "errors": list(_errors(found)),
        "parameters": list(parameter_rows(found)),
        "rows": list(accuracy_rows(found.accuracy)),
        "misses": drawn(mockup_figures.tracking_errors(found), "misses"),
        "tracking": drawn(mockup_figures.tracking(found), "tracking"),
        "tracked": list(_tracked(found)),
        "provenance": provenance,
        "hashes": provenance.hashes,
    }
    return write_page(path, Path(__file__).parent / "mockup.html", content)


def _errors(found: Found) -> Iterator[dict[str, Any]]:
    units = {
        item.name: display.unit
        for item, display in zip(found.setup.rig.system.outputs, found.setup.rig.display, strict=True)
    }
    first = next(iter(found.errors.values()))
    for record, outputs in first.items():
        for name in outputs:
            values = [found.errors[model][record][name] for model in found.models]
            yield {"record": record, "output": name, "unit": units[name], "numbers": values}


def parameter_rows(found: Found) -> Iterator[dict[str, Any]]:
    """Each identified parameter beside what was known before and what the rig really is, None where that has none."""
    model, prior = found.models[found.setup.plan.structure], found.models["prior"].system.named
    errors, values, real = model.standard_errors, model.system.named, found.setup.reality.named
    for item in model.system.parameters:
        if item.name in errors and item.name in prior:
            yield {
                "name": item.name,
                "unit": item.unit,
                "prior": prior[item.name],
                "value": values[item.name],
                "real": real.get(item.name),
                "error": errors[item.name],
            }


def _tracked(found: Found) -> Iterator[dict[str, Any]]:
    windows = next(iter(found.runs.values())).windows
    for k, (window, unit) in enumerate(windows.items()):
        values = [runs.rmse[:, k] for runs in found.runs.values()]
        rows = [{"mean": float(v.mean()), "low": float(v.min()), "high": float(v.max())} for v in values]
        yield {"window": window, "unit": unit, "numbers": rows}
