"""A state space of 30 states with three inputs and outputs, from 100 000 samples whose order is known."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.signal import lfilter

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.state_space.identification import StateSpaceSettings, identify_state_space
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.fit import PreparedRecord

SAMPLES, STATES, SIGNALS = 100_000, 30, 3
NOISE = 0.05
"""Of each output, in its deviation."""


def measured() -> dict[str, Any]:
    """Seconds of the fit and its error in the outputs' deviation, at best NOISE."""
    random = np.random.default_rng(0)
    hertz = np.geomspace(0.01, 0.4, STATES // 2)
    inputs, outputs = random.normal(size=(SAMPLES, SIGNALS)), np.zeros((SAMPLES, SIGNALS))
    for pole in np.exp((1j - 0.03) * np.pi * hertz):
        b, c = random.normal(size=(2, SIGNALS)) + 1j * random.normal(size=(2, SIGNALS))
        mode = lfilter([0.0, 1.0], [1.0, -pole], inputs @ b)
        outputs += np.real(mode[:, None] * c * (1.0 - abs(pole)))
    outputs += NOISE * outputs.std(axis=0) * random.normal(size=outputs.shape)
    record = PreparedRecord(
        name="modes",
        sampling=Sampling(step=0.01, period=0.01),
        inputs=inputs[:-1],
        outputs=outputs,
        states=np.zeros((SAMPLES, 0)),
    )
    y, u = (tuple(Variable(name=f"{kind}_{i}", unit="1") for i in range(SIGNALS)) for kind in ("out", "in"))
    began = time.monotonic()
    fit = identify_state_space([record], y, u, StateSpaceSettings(order=STATES))
    return {"seconds": round(time.monotonic() - began, 1), "error": fit.relative_error, "noise": NOISE}
