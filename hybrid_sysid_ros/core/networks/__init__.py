"""Small networks as blocks of a law."""

from hybrid_sysid_ros.core.networks.softsign import Softsign
from hybrid_sysid_ros.core.networks.tanh_layers import NetworkLayers

__all__ = ["NetworkLayers", "Softsign"]
