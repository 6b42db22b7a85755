"""Accuracy from simulated and live shots: what a simulation says, as far as it is believed, and what shots show."""

from hybrid_sysid_ros.extensions.accuracy.statistics.assumptions import Assumptions, assumptions
from hybrid_sysid_ros.extensions.accuracy.statistics.comparison import (
    ShotComparison,
    ShotQuantity,
    Verdict,
    compare,
    needed,
    overall,
)
from hybrid_sysid_ros.extensions.accuracy.statistics.discrepancy import Conflict, Discrepancy, conflict
from hybrid_sysid_ros.extensions.accuracy.statistics.estimate import (
    Accuracy,
    AccuracyEstimate,
    Bounded,
    assess,
    estimate,
    fewest,
)
from hybrid_sysid_ros.extensions.accuracy.statistics.normal_inverse_wishart import NormalInverseWishart
from hybrid_sysid_ros.extensions.accuracy.statistics.sequential import mean_width, shots_until, spread_width
from hybrid_sysid_ros.extensions.accuracy.statistics.shots import Shots, read_shots
from hybrid_sysid_ros.extensions.accuracy.statistics.strata import Strata

__all__ = [
    "Accuracy",
    "AccuracyEstimate",
    "Assumptions",
    "Bounded",
    "Conflict",
    "Discrepancy",
    "NormalInverseWishart",
    "ShotComparison",
    "ShotQuantity",
    "Shots",
    "Strata",
    "Verdict",
    "assess",
    "assumptions",
    "compare",
    "conflict",
    "estimate",
    "fewest",
    "mean_width",
    "needed",
    "overall",
    "read_shots",
    "shots_until",
    "spread_width",
]
