"""Diagnostics: the status of each task of a node, its level, and the reason in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

OK, WARN, ERROR, STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE


@dataclass(frozen=True, kw_only=True)
class Task:
    """One task of a node, which has a status of its own in the diagnostics."""

    name: str
    """loop, sensor, model, policy or recorder, by which an aggregator groups."""
    level: bytes = OK
    message: str = "running"
    values: Mapping[str, object] = field(default_factory=dict)

    def status(self, node: str, rig: str) -> DiagnosticStatus:
        """The status as it is published."""
        return DiagnosticStatus(
            level=self.level,
            name=f"{node}: {self.name}",
            message=self.message,
            hardware_id=rig,
            values=[KeyValue(key=key, value=_text(value)) for key, value in self.values.items()],
        )


class Troubles:
    """Judges a task by the growth of its fault counters since the last report."""

    def __init__(self) -> None:
        self._before: dict[str, int] = {}

    def judge(self, counted: Mapping[str, int], total: int, *, warn: float, error: float) -> tuple[bytes, str]:
        """The level and a sentence. counted: faults since the start by name; total: tries since the start. warn, error:
        least shares of faults among the tries since the last report for these levels.
        """
        before, self._before = self._before, {**counted, "": total}
        grown = {name: count - before.get(name, 0) for name, count in counted.items()}
        troubles = sorted(((count, name) for name, count in grown.items() if count > 0), reverse=True)
        if not troubles:
            return OK, "running"
        tries = max(total - before.get("", 0), troubles[0][0])
        share = sum(count for count, _ in troubles) / tries
        words = ", ".join(f"{count} {name}" for count, name in troubles)
        level = ERROR if share >= error else WARN if share >= warn else OK
        return level, f"{words}, of {tries}"


def doubted(task: Task, doubt: str) -> Task:
    """A task that warns of a doubt, unless something worse is known."""
    return task if not doubt or task.level != OK else replace(task, level=WARN, message=doubt)


def named_counts(prefix: str, counts: Mapping[str, int]) -> dict[str, int]:
    """Counts by keys of the diagnostics, which begin with the prefix."""
    return {f"{prefix}_{name.replace(' ', '_')}": count for name, count in sorted(counts.items())}


def _text(value: object) -> str:
    if isinstance(value, float):
        return "nan" if math.isnan(value) else f"{value:.6g}"
    return str(value)
