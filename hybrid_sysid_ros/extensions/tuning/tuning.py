"""A tuning: trials on some loops, the best by an aim, and its gain on loops that were never tuned on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.extensions.shared.workers import count as count_of
from hybrid_sysid_ros.extensions.tuning.front import Trials, TuningTrial, best_of, front_of
from hybrid_sysid_ros.extensions.tuning.loops import Loops, Measures
from hybrid_sysid_ros.models import Options
from hybrid_sysid_ros.runtime.node_commands import parameter_text
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_folder

RESULT, PARAMETERS = "tuning.yaml", "params.yaml"
SURE = 2.0
"""Standard errors by which a gain must be above 0."""


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """What came out."""

    aim: str
    trials: list[TuningTrial]
    best: TuningTrial
    shipped: Measures
    """Of what ships, on unseen loops."""
    unseen: Measures
    """Of the best, on the same ones."""
    gain: float
    """Share by which the best is lower there in what the aim counts."""
    error: float
    """Standard error of the gain, from the pairs of loops."""

    @property
    def better(self) -> bool:
        """Whether the gain is certain, and as many loops stay inside."""
        return self.gain > SURE * self.error and self.unseen.inside >= self.shipped.inside

    @property
    def sentence(self) -> str:
        """What was found, in words."""
        what = "effort" if self.aim == "effort" else "settling"
        of = f"{what} on unseen loops is {100 * self.gain:.1f} % (+- {100 * self.error:.1f} %) lower than what ships"
        if self.best.number == 0:
            return f"no trial was better than what ships by the aim {self.aim}: it stays"
        return of if self.better else f"{of}: that is not certain, so what ships stays"


def tune(
    loops: Loops, trials: Trials, aim: str, count: int, *, workers: int, progress: Callable[[int, int], None]
) -> Tuned:
    """Make trials until there are ``count``, and measure the best one on unseen loops."""
    progress(len(trials.finished), count)
    while (missing := count - len(trials.finished)) > 0:
        asked = [trials.ask() for _ in range(min(missing, count_of(workers)))]
        found = parallel.run(partial(_tried, loops), [trial.params for trial in asked], workers=workers)
        for trial, tried in zip(asked, found, strict=True):
            trials.tell(trial, None if isinstance(tried, UserError) else tried)
        if all(isinstance(tried, UserError) for tried in found):
            raise UserError(f"no trial of these can be simulated: {found[0]}")
        progress(len(trials.finished), count)
    finished = trials.finished
    best = best_of(finished, aim)
    pairs = [finished[0].options, best.options]
    (shipped, of_shipped), (unseen, of_best) = parallel.run(partial(_unseen, loops), pairs, workers=workers)
    column = 1 if aim == "effort" else 0
    before, after = of_shipped[:, column], of_best[:, column]
    saved = (before - after) / before.mean()
    return Tuned(
        aim=aim,
        trials=finished,
        best=best,
        shipped=shipped,
        unseen=unseen,
        gain=float(saved.mean()),
        error=float(saved.std(ddof=1) / math.sqrt(len(saved))),
    )


def _tried(loops: Loops, options: Options) -> Measures | UserError:
    """What loops say, or why they can't be simulated."""
    try:
        return loops.measures(options)[0]
    except UserError as error:
        return error


def _unseen(loops: Loops, options: Options) -> tuple[Measures, Any]:
    return loops.measures(options, unseen=True)


def content(loops: Loops, tuned: Tuned) -> dict[str, Any]:
    """The result as plain data."""
    found = {
        "rig": loops.rig.name,
        "model": loops.model.seal,
        "aim": tuned.aim,
        "seed": loops.seed,
        "loops": loops.count,
        "horizons": loops.horizons,
        "result": tuned.sentence,
        "gain": tuned.gain,
        "error": tuned.error,
        "better": tuned.better,
        "shipped_unseen": asdict(tuned.shipped),
        "tuned_unseen": asdict(tuned.unseen),
        "best": _plain(tuned.best),
        "nodes": loops.values(tuned.best.options) if tuned.better else {},
        "front": [_plain(trial) for trial in front_of(tuned.trials)],
        "trials": len(tuned.trials),
    }
    return {name: _numbers(item) for name, item in found.items()}


def save(folder: Path, loops: Loops, tuned: Tuned, page: Callable[[Path], Any] | None) -> None:
    """Write the result, a parameter file if it is better than what ships, and a page. The section ``nodes`` is one of
    a rig's file. Raises UserError where the folder can't be written.
    """
    plain = content(loops, tuned)
    with written_folder(folder, marker=RESULT) as partial_folder:
        (partial_folder / RESULT).write_text(yaml.safe_dump(plain, sort_keys=False), encoding="utf-8")
        if tuned.better:
            (partial_folder / PARAMETERS).write_text(parameter_text(plain["nodes"]), encoding="utf-8")
        if page is not None:
            page(partial_folder / "front.html")


def _plain(trial: TuningTrial) -> dict[str, Any]:
    return {"number": trial.number, "options": dict(trial.options), **asdict(trial.measures)}


def _numbers(value: Any) -> Any:
    """Without tuples and numbers of numpy."""
    if isinstance(value, dict):
        return {key: _numbers(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_numbers(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
