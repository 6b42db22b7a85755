"""Structures to identify, and the models they become."""

from hybrid_sysid_ros.models.model import Model, load
from hybrid_sysid_ros.models.sampling import InputHandling, Sampling
from hybrid_sysid_ros.models.structures import STRUCTURES, build

__all__ = ["STRUCTURES", "InputHandling", "Model", "Sampling", "build", "load"]
