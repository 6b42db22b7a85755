"""Extended Kalman filter, of second order."""

from __future__ import annotations

from typing import Any

from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.estimation.augmented import copy, differences
from hybrid_sysid_ros.estimation.estimator import Estimator
from hybrid_sysid_ros.estimation.memory import matrix, vector
from hybrid_sysid_ros.estimation.recursion import filtered
from hybrid_sysid_ros.estimation.square_root import triangle
from hybrid_sysid_ros.support.arrays import Array


@inner
def predict(core: Any, mean: Array, root: Array, drive: Array, h: float) -> None:
    """One step of a belief, in place."""
    size = mean.shape[0]
    rows, following = matrix(core.rows, 3 * size + 2 * core.inputs + 1, size), vector(core.gain, size)
    count = differences(core, mean, root, drive, h, following, rows)
    copy(following, mean)
    triangle(rows, count, root)


@kernel
def _run(
    memory: Any, task: int, time: float, since: float, first: int, given: Array, applied: Array, out: Array, P: Array
) -> int:
    return filtered(memory, task, time, since, first, given, applied, out, P, predict)  # type: ignore[no-any-return]


class ExtendedKalmanFilter(Estimator):
    """The root S of the covariance, P = S S', goes through the slopes of the step; see :class:`~.estimator.Estimator`.

        prediction   z+ = mean of f(z, u),  S+' = triangle of [slopes of f by S and by the inputs' noise; bends; Q dt]
        correction   V = H P H' + R,  z += P H' (y - h(z)) / V,  S (I - g a a'),  a = S' H'

    Mean, slopes and bends are of differences over what is uncertain, not of derivatives, which know nothing of
    friction's corners: :func:`~.augmented.differences`, by Norgaard, Poulsen, Ravn (2000), Automatica 36(11).
    """

    _run = staticmethod(_run)
