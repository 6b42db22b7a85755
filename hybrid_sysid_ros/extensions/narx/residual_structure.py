"""Parallel (output-error) model of the residual: a gray box, and a learned model of what it leaves beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.narx.residual_hybrid import ResidualHybrid, averaged_residual
from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.models.structure import FitContext, Option, Structure
from hybrid_sysid_ros.structures.gray_box import FIT_OPTIONS
from hybrid_sysid_ros.structures.hybrid import MEMBERS, RIDGE

TOLERANCE, ITERATIONS = 1e-4, 80
"""Of the residual's fit: its feedback makes the cost's valleys long and narrow."""
OPTIONS = {
    "output_lags": Option(default=3, low=1, high=6, kind="int", description="Past residuals of each output."),
    "input_lags": Option(default=2, low=1, high=6, kind="int", description="Past inputs."),
    "units": Option(default=12, low=0, high=32, kind="int", description="Units of the residual's network; 0: none."),
    "degree": Option(default=1, low=0, high=3, kind="int", description="Degree of the residual's polynomial; 0: none."),
    "terms": Option(default=0, low=0, high=40, kind="int", description="Products for an output; 0: by the BIC."),
    "members": MEMBERS,
    "ridge": replace(RIDGE, default=0.3),
    **FIT_OPTIONS,
}


class ResidualStructure(Structure):
    """The gray box first; then models of its residual by their own free run beside the gray box as it is: with
    networks of several seeds, averaged into one, so that no single seed decides.
    """

    summary = "parallel (output-error) model of the residual of a gray box"
    seeded = True
    combines = True
    default_box = "gray"

    @property
    def options(self) -> Mapping[str, Option]:
        return {**OPTIONS, **{name: item for name, item in self.gray.options.items() if name not in OPTIONS}}

    def fit(self, context: FitContext) -> Fit:
        from hybrid_sysid_ros.extensions.narx.residual_fit import ResidualSequence, check_forgets, initial_guess

        gray, options = self.gray.fit(context.of(self.gray)), context.options
        residuals = [ResidualSequence.of(gray.system, item) for item in context.experiments(gray.system)]
        start, units = initial_guess(gray.system, residuals, options), int(options["units"])
        fits = []
        for member in range(int(options["members"]) if units else 1):
            system = start.with_network(units, seed=context.seed + 1000 * member)
            fits.append(
                context.fit(
                    system,
                    experiments=[residual.initialised(system) for residual in residuals],
                    ridge=float(options["ridge"]),
                    hold=[item.name for item in system.physics.parameters],
                    tolerance=TOLERANCE,
                    iterations=ITERATIONS,
                )
            )
        system = averaged_residual([item.system for item in fits if isinstance(item.system, ResidualHybrid)])
        check_forgets(system, residuals)
        return replace(
            gray,
            system=system,
            relative_error=float(np.mean([item.relative_error for item in fits])),
            seconds=gray.seconds + sum(item.seconds for item in fits),
            evaluations=gray.evaluations + sum(item.evaluations for item in fits),
        )

    def assemble(self, design: Mapping[str, Any], weights: NDArray[np.float64]) -> System:
        physics = self.gray.assemble(design.get("physics") or {}, np.zeros(0))
        return ResidualHybrid.of(physics, design, weights)

    def stages(self, system: System) -> Mapping[str, System]:
        assert isinstance(system, ResidualHybrid)
        return {"gray box": system.physics, "with its residual": system}
