"""What of the observer is chosen and not identified, and the search for it on the first half of the record."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from scipy.optimize import differential_evolution

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.estimation import Tuning
from hybrid_sysid_ros.support.arrays import Array
from studies.drill_string import stops
from studies.drill_string.observer import SlidingBit, aligned, estimated, identified
from studies.drill_string.records import LEARNT, SAMPLING, load


@dataclass(frozen=True)
class FilterNoises:
    """By ``python -m studies.drill_string choose FOLDER``, on the first half of the public record."""

    torque_noise: float = 0.052
    """[N m]"""
    twist_noise: float = 0.00826
    """[rad/sqrt(s)]"""
    speed_noise: float = 1.03
    """[rad/s/sqrt(s)]"""
    brake_noise: float = 1.09
    """[N m/sqrt(s)]"""
    top_noise: float = 0.00283
    """[rad/s sqrt(s)]"""
    fade: float = 21.9
    """Rate at which the brake returns to 0 [1/s]."""
    stuck_below: float = 0.373
    """Estimated speed below which the bit counts as stuck [rad/s]."""

    @property
    def tuning(self) -> Tuning:
        """Of the filter, whose sensors are believed: nothing is gated."""
        return Tuning(
            measurement_noise=(self.torque_noise,),
            process_noise=(self.twist_noise, self.speed_noise, self.brake_noise),
            input_noise=(self.top_noise,),
            disturbance_noise=(0.0,),
            disturbance_limit=(0.0,),
            gate=1e9,
        )

    def estimated(self, system: SlidingBit, record: Record) -> tuple[Array, Array]:
        """See :func:`~.observer.estimated`."""
        return estimated(replace(system, fade=self.fade), record, self.tuning)


SEARCHED = ((0.01, 0.5), (0.001, 0.1), (0.2, 10.0), (0.2, 10.0), (0.001, 0.1), (0.3, 50.0), (0.15, 0.8))
"""Of each field of a choice."""
POPULATION, GENERATIONS = 8, 30
"""Of differential evolution, the first for each field."""


def chosen(system: SlidingBit, record: Record, *, seed: int = 0) -> FilterNoises:
    """By differential evolution: the choice with the largest of the smaller of precision and recall in a record."""

    def loss(logarithms: Array) -> float:
        choice = FilterNoises(*np.exp(logarithms).tolist())
        measured, speed = choice.estimated(system, record)
        judged = stops.found(np.abs(measured) < stops.STUCK, np.abs(speed) < choice.stuck_below)
        return -min(judged["precision"], judged["recall"])

    found = differential_evolution(
        loss,
        np.log(SEARCHED),
        popsize=POPULATION,
        maxiter=GENERATIONS,
        rng=seed,
        polish=False,
    )
    return FilterNoises(*np.exp(found.x).tolist())


Folder = Annotated[Path, typer.Argument(help="Folder that holds drillstring/175_completo_1.mat, or that file.")]


def command(folder: Folder, seed: Annotated[int, typer.Option(help="Random seed of the search.", min=0)] = 0) -> None:
    """Search the observer's choice on the first half of the public record, in some minutes."""
    record, _ = load(folder)
    learnt = LEARNT.of(record, SAMPLING)
    system, balance = identified(learnt)
    for name, value in asdict(chosen(system, aligned(learnt, balance.delay), seed=seed)).items():
        console.print(f"{name} {value:.3g}")
