"""Fuzzy structures: rules from clusters and least squares, then all of their numbers by the error of the simulation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.fuzzy.difnn import Difnn
from hybrid_sysid_ros.extensions.fuzzy.takagi_sugeno import TakagiSugeno
from hybrid_sysid_ros.extensions.shared.lagged import Lagged
from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.models.structure import FitContext, Option, Structure

LAGS = {
    "output_lags": Option(default=2, low=0, high=6, kind="int", description="Past outputs; 0: inputs alone."),
    "input_lags": Option(default=2, low=1, high=6, kind="int", description="Past inputs."),
}


class FuzzyStructure(Structure):
    """A recurrence in lagged outputs and inputs by rules; it holds at the period of the samples alone."""

    seeded = True

    def sampling(self, asked: Sampling) -> Sampling:
        return replace(asked, step=asked.period)

    @abstractmethod
    def chosen(self, context: FitContext, options: Mapping[str, int], signals: Mapping[str, Any]) -> Lagged:
        """The rules that the records show; signals: what all selections take."""

    def fit(self, context: FitContext) -> Fit:
        from hybrid_sysid_ros.extensions.fuzzy.tuning import tuned

        options = {name: int(value) for name, value in context.options.items()}
        signals = {
            "outputs": self.physics.outputs,
            "inputs": self.physics.inputs,
            "output_lags": options["output_lags"],
            "input_lags": options["input_lags"],
            "seed": context.seed,
        }
        system = self.chosen(context, options, signals)
        return tuned(system, context.experiments(system), progress=context.progress)


class TakagiSugenoStructure(FuzzyStructure):
    """Rules with affine consequents."""

    summary = "Takagi-Sugeno rules on lagged outputs and inputs"

    @property
    def options(self) -> Mapping[str, Option]:
        return {
            **LAGS,
            "rules": Option(
                default=0, low=0, high=40, kind="int", description="how many, 0: until validation falls no more"
            ),
            "all_premises": Option(
                default=0, low=0, high=1, kind="int", description="1: rules by all lags, not only by those of use"
            ),
            "gustafson_kessel": Option(
                default=0, low=0, high=1, kind="int", description="1: clusters are ellipsoids, not fuzzy C-means"
            ),
        }

    def chosen(self, context: FitContext, options: Mapping[str, int], signals: Mapping[str, Any]) -> Lagged:
        from hybrid_sysid_ros.extensions.fuzzy.rule_selection import select_rules

        lags = options["output_lags"], options["input_lags"]
        regressors = lags[0] * len(self.physics.outputs) + lags[1] * len(self.physics.inputs)
        return select_rules(
            context.experiments(self.physics),
            rules=options["rules"] or None,
            premises=range(regressors) if options["all_premises"] else None,
            ellipsoids=bool(options["gustafson_kessel"]),
            **signals,
        )

    def assemble(self, design: Mapping[str, Any], weights: NDArray[np.float64]) -> TakagiSugeno:
        return TakagiSugeno.of(design, weights)

    def lines(self, system: System) -> Sequence[str]:
        assert isinstance(system, TakagiSugeno)
        return [f"rule {number}: {rule}" for number, rule in enumerate(system.words, start=1)]

    def figures(self, system: System) -> Mapping[str, Any]:
        from hybrid_sysid_ros.extensions.fuzzy.report.figures import membership_figure

        assert isinstance(system, TakagiSugeno)
        return {"memberships": membership_figure(system)}


class DifnnStructure(FuzzyStructure):
    """A fuzzy-neural network: rules that are linked to terms of the outputs."""

    summary = "a fuzzy-neural network (DIFNN) on lagged outputs and inputs"

    @property
    def options(self) -> Mapping[str, Option]:
        return {
            **{name: replace(option, default=1) for name, option in LAGS.items()},
            "terms": Option(default=5, low=1, high=40, kind="int", description="Terms of each lag and of each output."),
            "least": Option(
                default=3, low=1, high=1000, kind="int", description="samples that a rule must be the winner of"
            ),
        }

    def chosen(self, context: FitContext, options: Mapping[str, int], signals: Mapping[str, Any]) -> Lagged:
        from hybrid_sysid_ros.extensions.fuzzy.link_selection import select_links

        experiments = context.experiments(self.physics)
        return select_links(experiments, terms=options["terms"], least=options["least"], **signals)

    def assemble(self, design: Mapping[str, Any], weights: NDArray[np.float64]) -> Difnn:
        return Difnn.of(design, weights)
