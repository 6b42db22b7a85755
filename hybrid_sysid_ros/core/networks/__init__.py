"""Small networks, polynomials and fuzzy rules as blocks of a law."""

from hybrid_sysid_ros.core.networks.affine_rules import AffineRules
from hybrid_sysid_ros.core.networks.gated_units import GatedUnits
from hybrid_sysid_ros.core.networks.linked_rules import LinkedRules
from hybrid_sysid_ros.core.networks.memberships import Memberships
from hybrid_sysid_ros.core.networks.polynomial import Polynomial
from hybrid_sysid_ros.core.networks.softsign import Softsign
from hybrid_sysid_ros.core.networks.tanh_layers import Layers

__all__ = ["AffineRules", "GatedUnits", "Layers", "LinkedRules", "Memberships", "Polynomial", "Softsign"]
