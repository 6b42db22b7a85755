"""Small networks and polynomials as blocks of a law."""

from hybrid_sysid_ros.core.networks.gated_units import GatedUnits
from hybrid_sysid_ros.core.networks.polynomial import Polynomial
from hybrid_sysid_ros.core.networks.softsign import Softsign
from hybrid_sysid_ros.core.networks.tanh_layers import NetworkLayers

__all__ = ["GatedUnits", "NetworkLayers", "Polynomial", "Softsign"]
