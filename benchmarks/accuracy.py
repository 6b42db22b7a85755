"""Coverage of intervals from simulated and live shots: exact, biased, as declared, stopped.

Two coordinates with a correlation of .3, 200 simulated shots, intervals of 90 %, a discrepancy of .5 standard
deviations and 10 % declared; 10 000 repetitions of each of three seeds. A coverage is that of the worse coordinate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.table import Table
from scipy import stats

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.accuracy.statistics import Discrepancy, NormalInverseWishart, Strata
from hybrid_sysid_ros.extensions.accuracy.statistics.circular_error import circular_error_probable
from hybrid_sysid_ros.support.arrays import Array

NAME = "accuracy"
REPETITIONS, SEEDS, LEVEL = 10_000, (0, 1, 2), 0.9
SIMULATED, LIVE = 200, (5, 10, 20)
COVARIANCE = np.array([[1.0, 0.3], [0.3, 1.0]])
DECLARED = Discrepancy(mean=0.5, spread=0.1)
COMMON = Discrepancy(mean=0.5, spread=0.1 * 2**0.5)
"""Where both spreads are off by the same factor: the prior takes them for two that are independent."""
NOTHING = NormalInverseWishart.reference(2)
DRAWS, PART = 1000, 500
"""Of the covariance for a circular error, and repetitions at once."""
WIDTH, MOST = 1.0, 60
"""Of a mean's interval at which shooting stops, and shots at which it stops anyway."""
STRATA = Strata(shares=np.array([0.3, 0.5, 0.2]), successes=np.array([0.2, 0.6, 0.9]))
STRATIFIED, RUNS = 100, 200_000


@dataclass(frozen=True, kw_only=True)
class Truth:
    """How live shots differ from simulated ones, (repetitions or 1, 2)."""

    mean: Array = field(default_factory=lambda: np.zeros((1, 2)))
    """Their mean, in standard deviations of their own."""
    factor: Array = field(default_factory=lambda: np.ones((1, 2)))
    """Their standard deviations, over the simulated ones."""

    @property
    def offset(self) -> Array:
        """Their mean, as the simulated one is 0."""
        return self.factor * self.mean

    def live(self, shots: int, generator: np.random.Generator) -> Array:
        """Live shots (repetitions, shots, 2)."""
        return self.factor[:, None, :] * (self.mean[:, None, :] + normal(shots, generator))


def fixed(mean: tuple[float, float], factor: float) -> Truth:
    """The same in all repetitions."""
    return Truth(mean=np.array([mean]), factor=np.full((1, 2), factor))


INSIDE = {
    "exact": fixed((0.0, 0.0), 1.0),
    "spread +10 %": fixed((0.0, 0.0), 1.1),
    "spread -10 %": fixed((0.0, 0.0), 1 / 1.1),
    "mean +.5": fixed((0.0, 0.5), 1.0),
}
"""One thing off by as much as was declared."""
AT_ONCE = {
    "mean +.5, spread +10 %": fixed((0.0, 0.5), 1.1),
    "mean +.5, spread -10 %": fixed((0.0, 0.5), 1 / 1.1),
    "mean +.5 and +.5": fixed((0.5, 0.5), 1.0),
    "mean +.5 and -.5": fixed((-0.5, 0.5), 1.0),
}
"""Two things off by as much as was declared; both means make .62 and .85 standard deviations, as they correlate."""
BEYOND = {
    "mean +1": fixed((0.0, 1.0), 1.0),
    "spread -30 %": fixed((0.0, 0.0), 0.7),
}
"""More off than was declared."""


def normal(shots: int, generator: np.random.Generator) -> Array:
    """Shots of the simulation, (REPETITIONS, shots, 2)."""
    return np.asarray(generator.standard_normal((REPETITIONS, shots, 2)) @ np.linalg.cholesky(COVARIANCE).T)


def drawn(generator: np.random.Generator, *, common: bool) -> Truth:
    """Truths as they were declared; common: both spreads are off by the same factor."""
    mean = DECLARED.mean * normal(1, generator)[:, 0]
    logarithm = DECLARED.spread * generator.standard_normal((REPETITIONS, 1 if common else 2))
    return Truth(mean=mean, factor=np.exp(logarithm) * np.ones(2))


def measures(posterior: NormalInverseWishart, truth: Truth) -> dict[str, float]:
    """Coverage of the mean's region and of the intervals of mean and spread, and their median widths."""
    found = {"region": float(np.mean(posterior.mean_distance(truth.offset) <= LEVEL))}
    for name, (low, high), true in (
        ("mean", posterior.mean_interval(LEVEL), truth.offset),
        ("spread", posterior.spread_interval(LEVEL), truth.factor),
    ):
        found[name] = float(np.min(np.mean((low <= true) & (true <= high), axis=0)))
        found[f"{name} width"] = float(np.median(high - low))
    return found


def circle(posterior: NormalInverseWishart, truth: Truth, generator: np.random.Generator) -> dict[str, float]:
    """Coverage and median width of the interval of the circular error probable about the mean."""
    factor = np.broadcast_to(truth.factor, (REPETITIONS, 2))
    true = circular_error_probable(factor[:, :, None] * COVARIANCE * factor[:, None, :])
    ends = np.concatenate(
        [
            np.quantile(circular_error_probable(part.covariances(DRAWS, generator)), [0.05, 0.95], axis=-1)
            for part in parts(posterior)
        ],
        axis=1,
    )
    inside = (ends[0] <= true) & (true <= ends[1])
    return {"circular error": float(np.mean(inside)), "circular error width": float(np.median(ends[1] - ends[0]))}


def parts(posterior: NormalInverseWishart) -> Iterator[NormalInverseWishart]:
    """Some repetitions at a time: all draws at once would fill the memory."""
    for start in range(0, REPETITIONS, PART):
        piece = slice(start, start + PART)
        yield NormalInverseWishart(
            centre=posterior.centre[piece],
            strength=posterior.strength,
            scale=posterior.scale[piece],
            degrees=posterior.degrees,
        )


def stopped(prior: NormalInverseWishart, truth: Truth, generator: np.random.Generator) -> dict[str, float]:
    """Of shooting until the second mean's interval is at most WIDTH wide: coverage of it, and shots (mean)."""
    shots = truth.live(MOST, generator)
    width, covered = np.full((MOST + 1, REPETITIONS), np.inf), np.zeros((MOST + 1, REPETITIONS), bool)
    for count in range(3, MOST + 1):
        low, high = prior.updated(shots[:, :count]).mean_interval(LEVEL)
        width[count] = (high - low)[:, 1]
        covered[count] = (low <= truth.offset)[:, 1] & (truth.offset <= high)[:, 1]
    width[MOST] = 0.0
    stop = np.argmax(width <= WIDTH, axis=0)
    return {"coverage": float(np.mean(covered[stop, np.arange(REPETITIONS)])), "shots": float(np.mean(stop))}


def efficiency(generator: np.random.Generator) -> float:
    """K_a by simulation: variance of the share of successes without strata over that with them."""
    overall = float(STRATA.shares @ STRATA.successes)
    plain = generator.binomial(STRATIFIED, overall, RUNS) / STRATIFIED
    counts = STRATA.allocation(STRATIFIED)
    hits = generator.binomial(counts, STRATA.successes, (RUNS, len(counts)))
    return float(np.var(plain) / np.var(hits / counts @ STRATA.shares))


def one_seed(seed: int) -> dict[str, Any]:
    """Everything for a seed."""
    generator = np.random.default_rng(seed)
    simulated = NOTHING.updated(normal(SIMULATED, generator))
    prior, for_common = DECLARED.weaken(simulated), COMMON.weaken(simulated)
    truths = {**INSIDE, **AT_ONCE, **BEYOND, "drawn": drawn(generator, common=False)}
    common = drawn(generator, common=True)
    found: dict[str, Any] = {}
    for count in LIVE:
        row = found[str(count)] = {}
        for name, truth in truths.items():
            row[name] = measures(prior.updated(truth.live(count, generator)), truth)
        row["live only"] = measures(NOTHING.updated(INSIDE["exact"].live(count, generator)), INSIDE["exact"])
        exact_prior = NOTHING.updated(normal(SIMULATED, generator))
        row["exact prior"] = measures(exact_prior.updated(INSIDE["exact"].live(count, generator)), INSIDE["exact"])
        for name, truth, known in (
            ("drawn", truths["drawn"], prior),
            ("drawn, common factor", common, prior),
            ("drawn, common factor, declared so", common, for_common),
        ):
            posterior = known.updated(truth.live(count, generator))
            row.setdefault(name, {}).update(circle(posterior, truth, generator))
    found["stopped"] = {
        "together": stopped(prior, truths["drawn"], generator),
        "live only": stopped(NOTHING, truths["drawn"], generator),
    }
    found["efficiency"] = efficiency(generator)
    return found


def noticed(count: int) -> float:
    """How often Hotelling's test (5 %) of live against simulated shots tells that a mean is off by .5."""
    free, offset = SIMULATED + count - 3, np.array([0.0, 0.5])
    distance = SIMULATED * count / (SIMULATED + count) * offset @ np.linalg.solve(COVARIANCE, offset)
    return float(stats.ncf.sf(stats.f.isf(0.05, 2, free), 2, free, distance))


def gathered(found: list[Any]) -> Any:
    """Mean, least and largest over the seeds, at the ends of nested mappings."""
    if isinstance(found[0], dict):
        return {key: gathered([item[key] for item in found]) for key in found[0]}
    return result.spread(found)


def text(values: dict[str, float]) -> str:
    """Mean and range."""
    return f"{values['mean']:.3f} ({values['min']:.3f}-{values['max']:.3f})"


def main() -> int:
    """Run, print tables, write the results."""
    machine = result.machine()
    found = gathered([one_seed(seed) for seed in SEEDS])
    for count in LIVE:
        row = found[str(count)]
        columns = ("region", "mean", "spread", "mean width", "spread width", "circular error", "circular error width")
        title = f"coverage of 90 % intervals after {count} live shots, mean (range) of {len(SEEDS)} seeds"
        table = Table("live shots are", *columns, title=title)
        for name, values in row.items():
            table.add_row(name, *(text(values[column]) if column in values else "" for column in columns))
        print_table(table)
        for kind in ("mean width", "spread width"):
            alone = row["live only"][kind]["mean"]  # of the same shots it goes with their spread
            narrower = {
                name: 1.0 - row[name][kind]["mean"] / (alone * truth.factor[0, 0]) for name, truth in INSIDE.items()
            }
            row[f"{kind}, narrower than live only"] = narrower
            print(
                f"{kind}, narrower than live only: "
                + ", ".join(f"{name} {part:.1%}" for name, part in narrower.items())
            )
        row["mean off by .5 noticed"] = noticed(count)
        print(f"a mean off by .5 is noticed in {noticed(count):.1%}")
    for name, values in found["stopped"].items():
        print(f"stopped at a mean width of {WIDTH:g}, {name}: {text(values['coverage'])} after {text(values['shots'])}")
    print(f"K_a: {STRATA.efficiency:.4f}, simulated {text(found['efficiency'])}")
    found["K_a"] = STRATA.efficiency
    print(result.write(NAME, found, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
