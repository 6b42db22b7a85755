"""An equation is written once; from it come the compiled simulation, its derivatives and the casadi_form."""

from hybrid_sysid_ros.core.equation import Equation, Step, Variable
from hybrid_sysid_ros.core.linearisation import linearisation, workspace
from hybrid_sysid_ros.core.motion import Law, Motion
from hybrid_sysid_ros.core.operations import COMPILED, Operations
from hybrid_sysid_ros.core.parameters import Parameter, parameter
from hybrid_sysid_ros.core.perceptron import Perceptron
from hybrid_sysid_ros.core.recurrence import Recurrence
from hybrid_sysid_ros.core.simulation import Kernels, kernels, simulate

__all__ = [
    "COMPILED",
    "Equation",
    "Kernels",
    "Law",
    "Motion",
    "Operations",
    "Parameter",
    "Perceptron",
    "Recurrence",
    "Step",
    "Variable",
    "kernels",
    "linearisation",
    "parameter",
    "simulate",
    "workspace",
]
