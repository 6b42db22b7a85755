"""A state space with weights that matter, for the tests of all structures."""

import numpy as np

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.state_space.affine_map import AffineMap
from hybrid_sysid_ros.extensions.state_space.state_space import StateSpace

POSITION, DRIVE = Variable(name="position", unit="rad"), Variable(name="drive", unit="V")


def state_space(order=3, units=2, power=0):
    system = StateSpace(
        period=0.05, outputs=(POSITION,), inputs=(DRIVE,), order=order, units=units, power=power,
        scales=(0.01, 0.3, 0.05, 4.0), trials=((2.0, 0.2, 0.01), (3.0, 0.1, 0.01)),
    )  # fmt: skip
    weights = 0.3 * np.random.default_rng(3).normal(size=len(system.weights))
    wide = order + 2
    weights[: order * wide].reshape(order, wide)[:, :order] = 0.8 * np.eye(order) + 0.1 * np.eye(order, k=1)
    return system.with_weights(weights)


SYSTEMS = {"state_space": state_space}
BLOCKS = {
    "affine_map": (
        AffineMap(features=4, outputs=3, units=2, power=3),
        AffineMap(features=2, outputs=1, units=3, power=0),
    ),
    "affine": (AffineMap(features=4, outputs=3), AffineMap(features=3, outputs=2)),
}
