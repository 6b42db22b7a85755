"""The page of a mock-up: its verdict, and what that rests on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.extensions.accuracy.report.accuracy_page import accuracy_rows
from hybrid_sysid_ros.extensions.accuracy.verdict import Found
from hybrid_sysid_ros.extensions.shared.report.rendering import check_available, drawn, write_page
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord


def write_mockup(path: Path | str, found: Found, provenance: Provenance) -> Path:
    """Write the page.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    from hybrid_sysid_ros.extensions.accuracy.report import mockup_figures

    content = {
        "title": f"{found.setup.rig.name}: {found.conclusion}",
        "found": found,
        "compared": list(_compared(found)),
        "recorded": isinstance(found.loop, LoopRecord),
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
    first = next(iter(found.errors.values()), {})
    for record, outputs in first.items():
        for name in outputs:
            values = [found.errors[model][record][name] for model in found.models]
            yield {"record": record, "output": name, "unit": units[name], "numbers": values}


def parameter_rows(found: Found) -> Iterator[dict[str, Any]]:
    """Each identified parameter beside what was known before and what the rig really is, None where that has none."""
    model, prior = found.model, found.models["prior"].system.named
    errors, values = model.standard_errors, model.system.named
    real = {} if isinstance(found.loop, LoopRecord) else found.setup.reality.named
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


def _compared(found: Found) -> Iterator[dict[str, Any]]:
    """Each quantity, with what the prior and the model say of it and the rig does."""
    before = found.compared["prior"]
    for of, items in found.compared["simulated"].items():
        for item, prior in zip(items, before[of], strict=True):
            yield {"of": of, "item": item, "prior": prior, "share": 100.0 / max(item.size, 1e-300)}


def _tracked(found: Found) -> Iterator[dict[str, Any]]:
    windows = next(iter(found.runs.values())).windows
    for k, (window, unit) in enumerate(windows.items()):
        values = [runs.rmse[:, k] for runs in found.runs.values()]
        rows = [{"mean": float(v.mean()), "low": float(v.min()), "high": float(v.max())} for v in values]
        yield {"window": window, "unit": unit, "numbers": rows}
