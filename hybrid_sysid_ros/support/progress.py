"""Progress of long work: bars on a terminal, lines in a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TaskID

Report = Callable[[str], object]
"""Receives a line of text."""
StageProgress = Callable[[str, int, int], None]
"""progress(stage, done, of)"""


@contextmanager
def progress_bars(console: Console) -> Iterator[StageProgress]:
    """Yield update(stage, done, of): a bar for each stage, or, without a terminal, a line for each quarter of it."""
    if not console.is_terminal:
        quarters: dict[str, int] = {}

        def write(stage: str, done: int, of: int) -> None:
            quarter = 4 * done // of if of else 0
            if quarters.get(stage, -1) < quarter:
                quarters[stage] = quarter
                console.print(f"  {stage}: {done} of {of}")

        yield write
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("  {task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bars:
        tasks: dict[str, TaskID] = {}

        def update(stage: str, done: int, of: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=of)
            bars.update(tasks[stage], completed=done)

        yield update
