"""An equation is written once; from it come the compiled simulation, its derivatives and the casadi_form."""

from hybrid_sysid_ros.equations.equation import Equation, Step, Variable
from hybrid_sysid_ros.equations.linearisation import linearisation, workspace
from hybrid_sysid_ros.equations.motion import Law, Motion
from hybrid_sysid_ros.equations.operations import COMPILED, Operations
from hybrid_sysid_ros.equations.parameters import Parameter, parameter
from hybrid_sysid_ros.equations.perceptron import Perceptron
from hybrid_sysid_ros.equations.recurrence import Recurrence
from hybrid_sysid_ros.equations.simulation import Kernels, kernels, simulate

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
