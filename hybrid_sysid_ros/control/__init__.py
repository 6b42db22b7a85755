"""Exact MPC, its imitation by a network, and their common parts."""

from hybrid_sysid_ros.control.controller import Controller, MpcSolution, Status
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.terms import StageTerm

__all__ = ["ControlProblem", "Controller", "ExactMpc", "MpcSolution", "StageTerm", "Status"]
