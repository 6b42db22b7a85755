"""Model structures, and the models that are identified with them."""

from hybrid_sysid_ros.models.model import Model, load
from hybrid_sysid_ros.models.sampling import InputHandling, Sampling
from hybrid_sysid_ros.models.structure import (
    Option,
    Options,
    Structure,
    build,
    options_of,
    structure_names,
    structure_of,
)

__all__ = [
    "InputHandling",
    "Model",
    "Option",
    "Options",
    "Sampling",
    "Structure",
    "build",
    "load",
    "options_of",
    "structure_names",
    "structure_of",
]
