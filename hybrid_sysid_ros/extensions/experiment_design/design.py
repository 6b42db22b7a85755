"""A designed experiment: what drives the rig, and what it will tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.experiment_design.cells import Cells
from hybrid_sysid_ros.extensions.experiment_design.information import Fisher, Knowledge
from hybrid_sysid_ros.extensions.experiment_design.search import Bench, exchanged
from hybrid_sysid_ros.extensions.experiment_design.segments import PlanSegment
from hybrid_sysid_ros.extensions.experiment_design.trial_fits import are_needed, worst_error
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SEARCHES = 3
"""Of plans among which trial fits choose; each has half of the usual trials."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """An experiment for a model, and what it is worth."""

    bench: Bench
    plan: Sequence[Sequence[PlanSegment]]
    """Segments of each input."""
    driving: Array
    """What drives each input at each step, (steps, inputs) in SI."""
    inputs: Array
    """What the inputs do by the model, (steps, inputs)."""
    outputs: Array
    """What the outputs do by the model, (steps + 1, outputs)."""
    names: tuple[str, ...]
    before: Array
    """Standard deviations of the free numbers now, in their units, (free,)."""
    after: Array
    """What is expected after the experiment, (free,)."""
    visits: tuple[int, int, int] | None = None
    """Cells that records have visited, new ones of the experiment, and all, where it is for these."""


def targets_of(model: Model, parameters: Sequence[str]) -> list[int]:
    """Places of parameters among a model's free numbers; all with a meaning where none is named.

    Raises UserError for a parameter that is unknown or was not fitted.
    """
    physical = {item.name for item in model.system.parameters if not item.learned}
    known = [name for name in model.names if name in physical]
    for name in parameters:
        if name not in known:
            raise UserError(f"parameter {name!r} is no fitted one of this model; it has {', '.join(known) or 'none'}")
    return [model.names.index(name) for name in parameters or known]


def designed(
    model: Model, rig: Rig, *, seconds: float, period: float, amplitude: float = 0.9, parameters: Sequence[str] = (),
    records: Sequence[Record] = (), seed: int = 0, progress: Callable[[int, int], None] = lambda done, most: None,
) -> Design:  # fmt: skip
    """The experiment that makes the largest relative deviation of parameters small (of all, or the named ones).

    seconds: its length. period: from one sample of the drive to the next [s]. amplitude: share of the limits that is
    used. records: those that the model is from; if some are given, the experiment visits as many cells of states and
    inputs as it can which they have not, whatever it says of parameters. Raises UserError where the model does not
    fit this, see :class:`~.search.Bench`.
    """
    bench = Bench(
        model=model, rig=rig, seconds=seconds, period=period, amplitude=amplitude, known=not records
    )  # fmt: skip
    knowledge, wanted = Knowledge.of(model), targets_of(model, parameters)
    fisher = Fisher.of(model, rig, knowledge.sizes)

    cells = Cells.of(model, rig, [experiment_of(model, record) for record in records]) if records else None

    def criterion(system: System, inputs: Array) -> float:
        if cells is not None:
            return -float(cells.new(system, inputs))
        return worst_of(knowledge, fisher.information(system, inputs), wanted)

    chosen = cells is None and are_needed(model.system, rig) and len(bench.systems) > 1
    count, trials = (SEARCHES, bench.trials // 2) if chosen else (1, bench.trials)
    plans = [
        exchanged(
            bench, criterion, seed=count * seed + number, trials=trials,
            progress=partial(_progressed, progress, number * trials, count * trials),
        )
        for number in range(count)
    ]  # fmt: skip
    plan = plans[0]
    if chosen:
        plans.append(exchanged(bench, criterion, seed=seed, trials=0))
        plan = min(plans, key=lambda item: worst_error(bench, bench.driving(item), wanted))
    driving = bench.driving(plan)
    inputs, outputs = bench.run(bench.systems[0], driving)
    return Design(
        bench=bench, plan=plan, driving=driving, inputs=inputs, outputs=outputs, names=model.names,
        before=knowledge.deviations(), after=expected(bench, fisher, knowledge, driving),
        visits=None if cells is None else (len(cells.visited), cells.new(bench.systems[0], inputs), cells.total),
    )  # fmt: skip


def _progressed(progress: Callable[[int, int], None], before: int, most: int, done: int) -> None:
    """Report a search's trials as part of those of all searches."""
    progress(before + done, most)


def worst_of(knowledge: Knowledge, information: Array, wanted: Sequence[int]) -> float:
    """The criterion: the logarithm of the largest relative variance of the wanted numbers after an experiment with some
    information. What the integration step moves is not in it: a finer step takes that away, and no experiment need.
    """
    return float(np.log(np.max(np.square((knowledge.deviations(information) / knowledge.sizes)[list(wanted)]))))


def expected(bench: Bench, fisher: Fisher, knowledge: Knowledge, driving: Array) -> Array:
    """Deviations after an experiment, (free,): the root of the mean variance over the points."""
    runs = [(system, bench.run(system, driving)[0]) for system in bench.systems[: bench.points]]
    found = [knowledge.deviations(*fisher.shown(system, inputs)) for system, inputs in runs]
    return np.asarray(np.sqrt(np.mean(np.square(found), axis=0)))
