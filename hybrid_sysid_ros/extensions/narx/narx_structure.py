"""Polynomial NARX: terms by error reduction, then their coefficients by the error of the simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.narx.narx import Narx
from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.models.structure import FitContext, Option, Structure

RIDGE = 1e-6
"""Its terms are chosen already: nothing pulls their coefficients to zero."""


class NarxStructure(Structure):
    """A recurrence in lagged outputs and inputs; it holds at the period of the samples alone."""

    summary = "a polynomial in lagged outputs and inputs"

    @property
    def options(self) -> Mapping[str, Option]:
        return {
            "output_lags": Option(default=1, low=1, high=6, kind="int", description="Past outputs."),
            "input_lags": Option(default=2, low=1, high=6, kind="int", description="Past inputs."),
            "degree": Option(default=3, low=1, high=3, kind="int", description="Degree of the polynomial."),
            "terms": Option(default=4, low=0, high=40, kind="int", description="Terms of an output; 0: by the BIC."),
        }

    def sampling(self, asked: Sampling) -> Sampling:
        return replace(asked, step=asked.period)

    def fit(self, context: FitContext) -> Fit:
        from hybrid_sysid_ros.extensions.narx.term_selection import select_terms

        options = {name: int(value) for name, value in context.options.items()}
        chosen = select_terms(
            context.experiments(self.physics),
            outputs=self.physics.outputs,
            inputs=self.physics.inputs,
            output_lags=options["output_lags"],
            input_lags=options["input_lags"],
            degree=options["degree"],
            terms=options["terms"] or None,
        )
        return context.fit(chosen, ridge=RIDGE)

    def assemble(self, design: Mapping[str, Any], weights: NDArray[np.float64]) -> Narx:
        return Narx.of(design, weights)
