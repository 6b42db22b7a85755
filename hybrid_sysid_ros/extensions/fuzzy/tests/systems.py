"""Fuzzy systems with numbers that matter, for tests of what holds for all structures."""

from collections.abc import Callable

import numpy as np

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.extensions.fuzzy.difnn import Difnn
from hybrid_sysid_ros.extensions.fuzzy.takagi_sugeno import TakagiSugeno
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam

POSITION, DRIVE = Variable.of(CamBeam.outputs[0]), Variable.of(CamBeam.inputs[0])


def rules() -> TakagiSugeno:
    """Three rules by the position and the drive before."""
    random = np.random.default_rng(0)
    return TakagiSugeno(
        outputs=(POSITION,),
        inputs=(DRIVE,),
        output_lags=2,
        input_lags=2,
        scales=(0.1, 5.0),
        low=(-0.2, -10.0),
        high=(0.2, 10.0),
        premises=(0, 3),
        rules=3,
        premise_weights=tuple(random.normal(scale=0.5, size=12)),
        consequents=tuple(random.normal(scale=0.3, size=15)),
    )


def linked() -> Difnn:
    """Four rules by three terms of the position and of the drive."""
    return Difnn(
        outputs=(POSITION,),
        inputs=(DRIVE,),
        output_lags=1,
        input_lags=2,
        scales=(0.1, 5.0),
        low=(-0.2, -10.0),
        high=(0.2, 10.0),
        antecedents=((0, 1, 2), (1, 1, 0), (2, 0, 1), (0, 0, 0)),
        links=(((0, 0), (0, 1), (1, 1), (2, 2), (3, 1)),),
        clusters=3,
        term_weights=tuple(np.random.default_rng(0).normal(scale=0.7, size=24)),
    )


SYSTEMS: dict[str, Callable[[], System]] = {"takagi_sugeno": rules, "difnn": linked}
