"""Structures to identify, and the models they become."""

from hybrid_sysid_ros.models.model import Model, load
from hybrid_sysid_ros.models.options import Option, Options
from hybrid_sysid_ros.models.sampling import InputHandling, Sampling
from hybrid_sysid_ros.models.structures import STRUCTURES, build, options_of

__all__ = ["STRUCTURES", "InputHandling", "Model", "Option", "Options", "Sampling", "build", "load", "options_of"]
