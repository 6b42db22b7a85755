"""Tuning of fuzzy models."""

from __future__ import annotations

from collections.abc import Sequence

from hybrid_sysid_ros.extensions.shared.lagged import Lagged
from hybrid_sysid_ros.identification.fitting import STAGES, FitProgress, fit
from hybrid_sysid_ros.models.fit import Fit, PreparedRecord

RIDGE = 1e-12
"""Clusters have chosen where rules are: nothing pulls their numbers to zero."""

TOLERANCE, ITERATIONS = 1e-6, 100
"""Of each stage."""


def tuned(system: Lagged, experiments: Sequence[PreparedRecord], *, progress: FitProgress | None = None) -> Fit:
    """Centres, widths and consequents by the error of the free run, from where clusters and least squares put them.

    A model of inputs alone has no run that errors would grow in, so that whole records are its only stage. Raises
    UserError as :func:`~.fitting.fit` does.
    """
    stages = STAGES if system.output_lags else STAGES[-1:]
    return fit(
        system,
        experiments,
        stages=stages,
        ridge=RIDGE,
        tolerance=TOLERANCE,
        iterations=ITERATIONS,
        progress=progress,
    )
