"""Stuck samples and stops: which of them were found."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

Flags = NDArray[np.bool_]

STUCK = 0.2
"""Speed of a bit that is stuck [rad/s], as the source's table of torque over speed has it."""


def found(truth: Flags, reported: Flags) -> dict[str, float]:
    """Precision and recall of stuck samples, (samples,) of bool each, and of stops, with the share and the count.

    A stop is found where any sample of it is reported, and one that is reported is right where it touches a true one.
    """
    both = float(np.sum(truth & reported))
    return {
        "precision": both / max(float(reported.sum()), 1.0),
        "recall": both / max(float(truth.sum()), 1.0),
        "share": float(truth.mean()),
        "stop_precision": _touched(reported, truth),
        "stop_recall": _touched(truth, reported),
        "stops": float(label(truth)[1]),
    }


def _touched(stops: Flags, by: Flags) -> float:
    """Share of the stops in which the other tells one, too."""
    pieces, count = label(stops)
    return len(np.setdiff1d(pieces[by], 0)) / max(count, 1)
