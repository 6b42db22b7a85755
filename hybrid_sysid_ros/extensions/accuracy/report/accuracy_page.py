"""The page of an accuracy: what simulated and live shots tell alone and together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hybrid_sysid_ros.extensions.accuracy.statistics import Accuracy, Bounded
from hybrid_sysid_ros.extensions.shared.report.rendering import check_available, drawn, write_page
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance


@dataclass(frozen=True, kw_only=True)
class Row:
    """A number as live shots alone, simulated ones alone, and both tell it."""

    name: str
    live: Bounded
    simulated: Bounded
    together: Bounded

    @property
    def narrower(self) -> float:
        """How much the simulation shortens the interval, in percent."""
        return 100.0 * (1.0 - self.together.width / self.live.width)


def accuracy_rows(found: Accuracy) -> Iterator[Row]:
    """Every number of an accuracy."""

    def row(name: str, bounds: Sequence[Bounded]) -> Row:
        return Row(name=name, live=bounds[0], simulated=bounds[1], together=bounds[2])

    live, estimates = found.live, (found.live_only, found.simulated_only, found.joint)
    labels = [f"{name} [{unit}]" if unit else name for name, unit in zip(live.names, live.units, strict=True)]
    for k, label in enumerate(labels):
        yield row(f"systematic error of {label}", [item.mean[k] for item in estimates])
    for k, label in enumerate(labels):
        yield row(f"standard deviation of {label}", [item.spread[k] for item in estimates])
    for i, j in found.joint.correlation:
        names = f"{live.names[i]} and {live.names[j]}"
        yield row(f"correlation of {names}", [item.correlation[i, j] for item in estimates])
    circles = [item.circular_error for item in estimates if item.circular_error]
    if circles:
        unit = f" [{live.units[0]}]" if live.units[0] else ""
        yield row(f"circular error probable about the mean{unit}", circles)


def write_accuracy(path: Path | str, found: Accuracy, provenance: Provenance, remarks: Sequence[str] = ()) -> Path:
    """Write the page. remarks: sentences of further shots and of strata.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    from hybrid_sysid_ros.extensions.accuracy.report import accuracy_figures

    names = found.live.names
    content = {
        "title": f"Accuracy by {len(found.live.values)} live and {len(found.simulated.values)} simulated shots",
        "found": found,
        "rows": list(accuracy_rows(found)),
        "impacts": drawn(accuracy_figures.impacts(found), "impacts") if len(names) > 1 else "",
        "sequences": [
            (name, drawn(accuracy_figures.sequence(found, k), f"sequence-{k}")) for k, name in enumerate(names)
        ],
        "assumed": [(name, drawn(accuracy_figures.assumed(found, k), f"assumed-{k}")) for k, name in enumerate(names)],
        "remarks": remarks,
        "provenance": provenance,
        "hashes": provenance.hashes,
    }
    return write_page(path, Path(__file__).parent / "accuracy.html", content)
