"""A recurrent network with numbers that matter, for tests of what holds for all structures."""

from collections.abc import Callable

import numpy as np

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.core.blocks import Block
from hybrid_sysid_ros.extensions.recurrent.gated_units import GatedUnits
from hybrid_sysid_ros.extensions.recurrent.recurrent import Recurrent
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam

POSITION, DRIVE = Variable.of(CamBeam.outputs[0]), Variable.of(CamBeam.inputs[0])


def recurrent() -> Recurrent:
    """Of three hidden states."""
    system = Recurrent(outputs=(POSITION,), inputs=(DRIVE,), units=3, scales=(0.03, 0.2, 4.0), period=0.025)
    return system.with_weights(np.random.default_rng(0).normal(size=len(system.weights)))


SYSTEMS: dict[str, Callable[[], System]] = {"recurrent": recurrent}
BLOCKS: dict[str, tuple[Block, Block]] = {
    "gated units": (GatedUnits(units=3, size=9 + 9 + 27 + 3 + 3 + 1 + 5), GatedUnits(units=2, size=50))
}
