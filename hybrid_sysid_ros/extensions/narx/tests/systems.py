"""Systems of both structures with numbers that matter, for tests of what holds for all structures."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.core.blocks import Block
from hybrid_sysid_ros.extensions.narx.narx import Narx
from hybrid_sysid_ros.extensions.narx.polynomial import Polynomial
from hybrid_sysid_ros.extensions.narx.residual_hybrid import ResidualHybrid
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam

POSITION, DRIVE = Variable.of(CamBeam.outputs[0]), Variable.of(CamBeam.inputs[0])


def polynomial() -> Narx:
    return Narx(
        outputs=(POSITION,),
        inputs=(DRIVE,),
        exponents=(((0, 0, 0, 0), (1, 0, 0, 0), (0, 1, 1, 0), (2, 0, 0, 1), (0, 0, 1, 2)),),
        coefficients=(0.1, 0.9, -0.2, 0.3, 0.1),
        output_lags=2,
        input_lags=2,
        scales=(0.1, 5.0),
        low=(-0.2, -10.0),
        high=(0.2, 10.0),
    )


def residual(physics: System | None = None, seed: int = 0) -> ResidualHybrid:
    """Beside the beam, or another system: two lags of each output, a linear term, a product, and a network."""
    from tests.structures import structure  # which looks for these systems itself

    random, physics = np.random.default_rng(seed), structure("gray") if physics is None else physics
    outputs, seen = len(physics.outputs), len(physics.declared_states) + len(physics.inputs)
    width = seen + len(physics.inputs) + 2 * outputs
    linear, product = (tuple(int(i in places) for i in range(width)) for places in ((seen - 1,), (0, width - 1)))
    size = 2 * outputs + 3 * (width + 1 + outputs)
    design = {
        "period": 0.005,
        "output_lags": 2,
        "input_lags": 2,
        "units": 3,
        "exponents": [[linear, product]] * outputs,
    }
    system = ResidualHybrid.of(physics, {**design, "physics": physics.design}, random.normal(size=size))
    return replace(
        system,
        reflections=tuple(random.uniform(-0.9, 0.9, 2 * outputs).tolist()),
        scales=(*random.uniform(0.1, 1.0, width).tolist(), *random.uniform(0.01, 0.02, outputs).tolist()),
    )


SYSTEMS: dict[str, Callable[[], System]] = {"narx": polynomial, "residual": residual}
BLOCKS: dict[str, tuple[Block, Block]] = {
    "polynomial": (
        Polynomial(exponents=((0, 0), (1, 0), (2, 3), (0, 1)), features=2),
        Polynomial(exponents=((2,),), features=1),
    )
}
