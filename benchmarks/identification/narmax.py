"""SysIdentPy: polynomial NARX models, whose terms FROLS selects.

Chen, Billings and Luo (1989), Orthogonal least squares methods and their application to non-linear system
identification. It takes one record, so that the training records are joined; the few rows across joints don't matter.
The input is the mean over each 50 ms; the state is the first measured outputs, as many as the model has lags. Degree,
lags and number of terms are chosen in free run on left-out records: AIC and BIC, which judge one-step errors, choose
models that diverge on the test (degree 2 and 3) or score below .7 on every record of it (degree 1). Leaving out one
record at a time is in the peer's favour: two folds, as the other peers have, chose a model of half the R2.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from itertools import product

import numpy as np
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares

from benchmarks.identification.peer import Fitted, Peer
from hybrid_sysid_ros.identification import PreparedRecord
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.arrays import Array

POSITION, DRIVE = 0.04, 4.0
"""Units of output [rad] and input [V] in the regressors."""


def fit(experiments: Sequence[PreparedRecord], *, degree: int, output_lags: int, input_lags: int, terms: int) -> Fitted:
    """One FROLS fit with a given number of terms, by least squares."""
    model = FROLS(
        order_selection=False,
        n_terms=terms,
        ylag=output_lags,
        xlag=input_lags,
        estimator=LeastSquares(),
        basis_function=Polynomial(degree=degree),
    )
    inputs = np.concatenate([_inputs(item) for item in experiments])
    outputs = np.concatenate([item.outputs for item in experiments]) / POSITION
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model.fit(X=inputs, y=outputs)
    seconds = time.perf_counter() - began

    def simulation(experiment: PreparedRecord) -> Array:
        known = experiment.outputs[: model.max_lag] / POSITION
        return np.asarray(model.predict(X=_inputs(experiment), y=known)[:, 0] * POSITION)

    return Fitted(seconds=seconds, snapshots=[(seconds, simulation)])


def _inputs(experiment: PreparedRecord) -> Array:
    """(samples, 1): row k acts between outputs k and k + 1; the last one on none."""
    return np.concatenate([experiment.inputs, experiment.inputs[-1:]]) / DRIVE


def _size(degree: int, lags: int) -> int:
    """Number of monomials up to a degree in so many lagged values."""
    size = 1
    for power in range(1, degree + 1):
        size = size * (lags + power) // power
    return size


PEERS = (
    Peer(
        name="SysIdentPy: FROLS",
        packages=("sysidentpy",),
        sampling=Sampling(step=0.05),
        fit=fit,
        candidates=[
            {"degree": degree, "output_lags": output_lags, "input_lags": input_lags, "terms": terms}
            for degree, output_lags, input_lags in product((1, 2, 3), repeat=3)
            for terms in (3, 4, 5, 6, 8, 10, 12)
            if terms <= _size(degree, output_lags + input_lags)
        ],
        folds=6,
    ),
)
