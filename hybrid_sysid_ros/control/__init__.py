"""Exact MPC, its imitation by a network, and what they share."""

from hybrid_sysid_ros.control.controller import Controller, Plan, Status
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.problem import Problem

__all__ = ["Controller", "ExactMpc", "Plan", "Problem", "Status"]
