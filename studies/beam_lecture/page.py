"""The protocol's page: all structures in one table, the pick in full."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.shared.report.rendering import (
    check_available,
    drawn,
    identification_content,
    write_page,
)
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance
from studies.beam_lecture.criteria import ModelCriteria
from studies.beam_lecture.report import ProtocolSection, StructureResult


def write_protocol(path: Path | str, section: ProtocolSection, provenance: Provenance) -> Path:
    """Write a protocol's page; an older one is replaced once the new one is whole.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    from hybrid_sysid_ros.extensions.shared.report import figures
    from studies.beam_lecture import figures as protocol_figures

    parts = [
        {"name": name, **identification_content(item, prefix=f"structure-{number}-")}
        for number, (name, item) in enumerate(section.details.items())
    ]
    hashes = dict(provenance.hashes)
    hashes.update({f"record, {run.name}": run.digest for item in section.details.values() for run in item.runs})
    curves = [curve for curve in section.horizons if np.isfinite(curve.rmse).all()]
    content = {
        "title": section.title,
        "section": section,
        "rows": [_row(section, result) for result in section.results],
        "published": any(result.published for result in section.results),
        "scores": drawn(protocol_figures.scores(section), "scores-of-structures"),
        "curves": drawn(figures.horizons(curves, section.display), "horizons-of-structures") if len(curves) > 1 else "",
        "judged": list(_judged(section)),
        "parts": parts,
        "provenance": provenance,
        "hashes": {name: digest for name, digest in hashes.items() if digest},
    }
    return write_page(path, Path(__file__).parent / "protocol.html", content, r2=r2_text, difference=difference_text)


def _row(section: ProtocolSection, result: StructureResult) -> dict[str, Any]:
    """A row of the table of scores; ours is better where its mean over seeds is above what was published."""
    mean, published = result.mean, dict(result.published or {})
    known = [published[name] for name in section.records if name in published]
    return {
        "result": result,
        "cells": [
            {
                "mean": mean[name],
                "range": result.range[name] if len(result.r2) > 1 else None,
                "published": published.get(name),
                "better": name in published and mean[name] > published[name],
            }
            for name in section.records
        ],
        "mean": float(np.mean(list(mean.values()))),
        "published_mean": float(np.mean(known)) if len(known) == len(section.records) else None,
    }


def _judged(section: ProtocolSection) -> Iterator[dict[str, Any]]:
    """Rows of the table of criteria: differences from the lowest."""
    found = section.judgements
    for name, judgement in found.items():
        yield {
            "name": name,
            "chosen": section.pick is not None and section.pick.name == name,
            "judgement": judgement,
            "rmse": f"{float(section.display.shown(np.sqrt(judgement.plain.mean_square))):.3f}",
            "differences": [
                _criterion(judgement, number) - min(_criterion(other, number) for other in found.values())
                for number in range(4)
            ],
        }


def _criterion(judgement: ModelCriteria, number: int) -> float:
    """A column of the table of criteria."""
    found = judgement.plain, judgement.effective
    return found[number // 2].bic if number % 2 else found[number // 2].aicc


def r2_text(value: float) -> str:
    """An R2, without decimals where it says that a simulation is lost."""
    if not value > -1e6:
        return "diverges"
    text = f"{value:.3f}" if value > -10 else f"{value:.0f}"
    return text.replace("-", "\N{MINUS SIGN}")


def difference_text(value: float) -> str:
    """How far a criterion is above the lowest."""
    return f"{value:.1f}" if math.isfinite(value) else "\N{INFINITY}"
