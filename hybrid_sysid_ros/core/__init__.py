"""Systems: a law is written once, then stepped, compiled, simulated with derivatives and exported to CasADi."""

from hybrid_sysid_ros.core.compiled import compiled
from hybrid_sysid_ros.core.declaration import Variable
from hybrid_sysid_ros.core.friction import Ageing, Bristles, Contact, Dry, Hysteretic, MaxwellSlip, Viscous
from hybrid_sysid_ros.core.networks import Softsign
from hybrid_sysid_ros.core.parameters import Parameter, bounded
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.core.rollout import one_step, rollouts, simulate, step_with_jacobian
from hybrid_sysid_ros.core.runge_kutta import RungeKutta
from hybrid_sysid_ros.core.sensitivities import Sensitivities
from hybrid_sysid_ros.core.steppers import ImplicitFriction, Sampled, Stepper
from hybrid_sysid_ros.core.system import Recurrence, System

__all__ = [
    "Ageing",
    "Bristles",
    "Contact",
    "Dry",
    "Hysteretic",
    "ImplicitFriction",
    "MaxwellSlip",
    "Parameter",
    "RecordMap",
    "Recurrence",
    "RungeKutta",
    "Sampled",
    "Sensitivities",
    "Softsign",
    "Stepper",
    "System",
    "Variable",
    "Viscous",
    "bounded",
    "compiled",
    "one_step",
    "rollouts",
    "simulate",
    "step_with_jacobian",
]
