"""Functions of inputs alone: the series of Mackey and Glass, and the sum of sines by models of sixty numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import default_rng as rng
from rich.table import Table

import hybrid_sysid_ros
from benchmarks import result
from benchmarks.fuzzy.data import LEVEL, SEEDS, mackey_glass, named, of_inputs, predicted, sines
from hybrid_sysid_ros.core import Parameter
from hybrid_sysid_ros.core.mathematics import Scalar, tanh
from hybrid_sysid_ros.extensions.friction_atlas.line_plots import Plot, draw
from hybrid_sysid_ros.extensions.fuzzy.difnn import Difnn
from hybrid_sysid_ros.extensions.fuzzy.link_selection import select_links
from hybrid_sysid_ros.extensions.fuzzy.rule_selection import select_rules
from hybrid_sysid_ros.extensions.fuzzy.tuning import tuned
from hybrid_sysid_ros.extensions.shared.lagged import Lagged
from hybrid_sysid_ros.extensions.shared.regression import Regression
from hybrid_sysid_ros.identification import PreparedRecord
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

Chosen = Callable[[PreparedRecord, int], Lagged]

AHEAD, LAGS, FIRST, COUNT = 6, (18, 12, 6, 0), 118, 1000
"""x(t + 6) of x(t - 18), x(t - 12), x(t - 6), x(t), for t = 118 ... 1117; the first half teaches."""
POINTS = 201
SHOWN = 5
"""One of so many points is drawn."""
PICTURE = Path(hybrid_sysid_ros.__file__).parent / "extensions/fuzzy/docs/results/sines.svg"


@dataclass(frozen=True, kw_only=True)
class Network(Lagged):
    """y = c + sum_i a_i tanh(w_i r + b_i): a perceptron with one hidden layer, its numbers parameters."""

    KIND = "network"
    LEARNED = "nothing"

    units: int
    numbers: tuple[float, ...]
    """c, then of each unit w, b, a."""
    nothing: tuple[float, ...] = ()

    @property
    def form(self) -> tuple[Any, ...]:
        return (*super().form, self.units)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        own = (
            Parameter(name=f"number_{i}", unit="", low=-500.0, high=500.0, start=0.0, learned=True)
            for i in range(len(self.numbers))
        )
        return (*super().parameters, *own)

    @property
    def values(self) -> Array:
        return np.concatenate([super().values, self.numbers])

    def bound(self, values: Sequence[Scalar]) -> Lagged:
        first = 3 * len(self.scales)
        return replace(super().bound(values[:first]), numbers=tuple(values[first:]))  # type: ignore[call-arg]

    def following(self, r: Sequence[Scalar]) -> list[Scalar]:
        total, width = self.numbers[0], len(r) + 2
        for i in range(self.units):
            *slopes, bias, height = self.numbers[1 + i * width : 1 + (i + 1) * width]
            total = total + height * tanh(sum((w * value for w, value in zip(slopes, r, strict=True)), bias))
        return [total]


def network(units: int) -> Chosen:
    """Of so many units, spread over the inputs as Nguyen and Widrow (1990), IJCNN, have it."""

    def chosen(record: PreparedRecord, seed: int) -> Lagged:
        regression, random = Regression.of([record], output_lags=0, input_lags=1, kind=Network.KIND), rng(seed)
        width, reach = regression.lagged.shape[1], np.abs(regression.lagged).max()
        slopes = random.normal(size=(units, width))
        steep = 0.7 * units ** (1.0 / width)
        slopes *= steep / np.linalg.norm(slopes, axis=1, keepdims=True) / reach
        rest = np.column_stack([steep * random.uniform(-1.0, 1.0, units), 0.1 * random.normal(size=units)])
        numbers = np.concatenate([regression.targets.mean(axis=0), np.column_stack([slopes, rest]).ravel()])
        return Network(**regression.shape([LEVEL], named(width)), units=units, numbers=tuple(numbers.tolist()))

    return chosen


def takagi_sugeno(rules: int) -> Chosen:
    """Of so many rules by all inputs."""

    def chosen(record: PreparedRecord, seed: int) -> Lagged:
        count = record.inputs.shape[1]
        return select_rules(
            [record], outputs=[LEVEL], inputs=named(count), output_lags=0, input_lags=1, rules=rules,
            premises=range(count), seed=seed,
        )  # fmt: skip

    return chosen


def difnn(terms: int) -> Chosen:
    """Of so many terms of each input and of the output."""

    def chosen(record: PreparedRecord, seed: int) -> Lagged:
        inputs = named(record.inputs.shape[1])
        return select_links(
            [record], outputs=[LEVEL], inputs=inputs, output_lags=0, input_lags=1, terms=terms, seed=seed
        )

    return chosen


def one(choose: Chosen, taught: tuple[Array, Array], unseen: tuple[Array, Array], seed: int) -> dict[str, float]:
    """Errors before and after tuning on what is unseen, numbers that are learned, seconds of the fit."""
    record = of_inputs(*taught, name="function")
    started = choose(record, seed)
    fitted = tuned(started, [record])
    before, after = (
        float(np.sqrt(np.mean((predicted(item, unseen[0]) - unseen[1]) ** 2))) for item in (started, fitted.system)
    )
    free = sum(not item.fixed for item in started.parameters) + len(started.weights)
    return {"untuned": before, "tuned": after, "numbers": free, "seconds": fitted.seconds}


def compared(
    title: str, models: Mapping[str, Chosen], taught: tuple[Array, Array], unseen: tuple[Array, Array]
) -> tuple[dict[str, Any], list[Table]]:
    """All models and seeds."""
    found: dict[str, Any] = {}
    table = Table("model", "numbers", "untuned", "tuned: mean", "least", "largest", "seconds", title=title)
    for name, choose in models.items():
        rows = [one(choose, taught, unseen, seed) for seed in SEEDS]
        found[name] = {key: result.spread([row[key] for row in rows]) for key in rows[0]}
        values = found[name]
        table.add_row(
            name, f"{values['numbers']['mean']:.0f}", f"{values['untuned']['mean']:.2g}",
            *(f"{value:.2g}" for value in values["tuned"].values()), f"{values['seconds']['mean']:.2f}",
        )  # fmt: skip
    return found, [table]


def series(_: Rig) -> tuple[dict[str, Any], list[Table]]:
    """Mackey and Glass, six steps ahead."""
    x, t = mackey_glass(FIRST + COUNT + AHEAD + 1), FIRST + np.arange(COUNT)
    inputs, values = np.stack([x[t - lag] for lag in LAGS], axis=1), x[t + AHEAD]
    half = COUNT // 2
    models = {
        "Takagi-Sugeno, 8 rules": takagi_sugeno(8),
        "DIFNN, 10 terms": difnn(10),
        "perceptron, 17 units": network(17),
    }
    title = f"Mackey-Glass, unseen half (deviation {values[half:].std():.3f}), 3 seeds"
    return compared(title, models, (inputs[:half], values[:half]), (inputs[half:], values[half:]))


def sum_of_sines(_: Rig) -> tuple[dict[str, Any], list[Table]]:
    """Of 201 points; judged on a grid ten times as dense."""
    points, dense = (np.linspace(-1.0, 1.0, count) for count in (POINTS, 10 * (POINTS - 1) + 1))
    models = {
        "DIFNN, 15 terms": difnn(15),
        "Takagi-Sugeno, 15 rules": takagi_sugeno(15),
        "perceptron, 20 units": network(20),
    }
    taught, unseen = ((u[:, None], sines(u)) for u in (points, dense))
    _draw(taught, unseen)
    return compared("sum of three sines, dense grid, 3 seeds", models, taught, unseen)


def _draw(taught: tuple[Array, Array], unseen: tuple[Array, Array]) -> None:
    """The sum of sines, the network before it is tuned, the terms that its tuning finds, and what is then left."""
    record, (points, values) = of_inputs(*taught, name="function"), (unseen[0][::SHOWN], unseen[1][::SHOWN])
    started, u = difnn(15)(record, SEEDS[0]), points[:, 0]
    network = tuned(started, [record]).system
    assert isinstance(network, Difnn)
    centres, logarithms, *_ = np.reshape(network.term_weights, (4, network.clusters))
    away = (u[:, None] / network.scales[0] - centres) / np.exp(logarithms)
    terms = [(u, term) for term in np.exp(-(away**2)).T]
    first, last = (predicted(item, points) for item in (started, network))
    plots = [
        Plot(title="not tuned, and the function", across="u", up="y", lines=[(u, first), (u, values)]),
        Plot(title="terms of the input, tuned", across="u", up="membership", lines=terms),
        Plot(title="error, tuned in 100 steps", across="u", up="millionths", lines=[(u, 1e6 * (last - values))]),
    ]
    draw(PICTURE, plots, title="A DIFNN of 15 rules learns a sum of three sines")
