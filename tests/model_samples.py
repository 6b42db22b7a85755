"""Models of every structure with numbers that need every digit, for tests of what holds for all of them."""

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models import Model, Sampling, build, structure_names
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from tests.structures import FURTHER

FROM_DATA = {name: made() for name, made in FURTHER.items()}
"""Systems of the structures that are made of their data."""
BUILT = [name for name in structure_names() if name not in FROM_DATA]
SCALES = np.array([0.1, 0.4, 5.0])


def started(structure: str, seed: int) -> System:
    """A structure of the beam as a fit begins with it."""
    return FROM_DATA.get(structure) or build(structure, CamBeam(), scales=SCALES, seed=seed)[0]


def model_of(structure: str, seed: int = 0) -> Model:
    """A model of a structure with numbers that need every digit."""
    random = np.random.default_rng(seed)
    system = started(structure, seed)
    high = [item.high for item in system.parameters]
    values = [v + (h - v) * random.uniform(0, 0.1) for v, h in zip(system.values, high, strict=True)]
    system = system.with_values(np.array(values))
    if len(system.weights):
        system = system.with_weights(random.normal(size=len(system.weights)) / 3)
    free = tuple(item.name for item in system.parameters if not item.fixed)
    free += tuple(f"weight_{k}" for k in range(len(system.weights)))
    root = random.normal(size=(len(free), len(free)))
    return Model(
        rig="cam_beam",
        structure=structure,
        system=system,
        sampling=Sampling(step=0.005, period=0.05, input="sampled"),
        names=free,
        covariance=root @ root.T / 7,
        training_range={"position": (-0.1 / 3, 0.1), "velocity": (-0.5, 0.5), "drive": (-10.0, 10.0)},
        records=({"name": "a", "source": "a.mcap", "sha256": "0" * 64, "part": [0.0, 0.5]},),
        scores={"a": {"r2": 1 / 3, "rmse": 1e-3, "fit_percent": 90.0}, "b": {"r2": -np.inf, "rmse": np.inf}},
        fit={"relative_error": 0.1, "seconds": 1.0, "evaluations": 10, "seed": 0},
    )
