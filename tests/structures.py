"""Systems of every structure with numbers that matter, for tests of what holds for all of them."""

from collections.abc import Callable
from functools import partial

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models import STRUCTURES, build
from hybrid_sysid_ros.models.narx import Narx
from hybrid_sysid_ros.models.recurrent import Recurrent
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam

RANGE = np.array([0.15, 0.5, 10.0])  # position [rad], velocity [rad/s], drive [V] of the beam's records
DEFLECTION = 0.005  # of bristles, as far as they bend [rad]
MOTIONS = [name for name in STRUCTURES if name not in ("narx", "recurrent")]


def structure(name: str, seed: int = 0) -> System:
    """A structure with every parameter away from its start, and a network that matters."""
    random = np.random.default_rng(seed)
    system, _ = build(name, CamBeam(), scales=RANGE, seed=seed)
    values = [item.start + 0.1 * item.scale * random.uniform(-1, 1) for item in system.parameters]
    bounded = [np.clip(v, item.low, item.high) for v, item in zip(values, system.parameters, strict=True)]
    system = system.with_values(np.array(bounded))
    return system.with_weights(random.normal(size=len(system.weights))) if len(system.weights) else system


def recurrent() -> Recurrent:
    system = Recurrent(units=5, position_scale=0.05, rate_scale=0.2, drive_scale=4.0)
    return system.with_weights(np.random.default_rng(0).normal(size=len(system.weights)))


def polynomial() -> Narx:
    return Narx(
        exponents=((0, 0, 0, 0), (1, 0, 0, 0), (0, 1, 1, 0), (2, 0, 0, 1), (0, 0, 1, 2)),
        coefficients=(0.1, 0.9, -0.2, 0.3, 0.1),
        output_lags=2,
        input_lags=2,
        output_range=(-0.2, 0.2),
        input_range=(-10.0, 10.0),
        output_scale=0.1,
        input_scale=5.0,
    )


SYSTEMS: dict[str, Callable[[], System]] = {
    **{name: partial(structure, name) for name in MOTIONS},
    "narx": polynomial,
    "recurrent": recurrent,
}
