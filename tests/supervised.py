"""Instances that a supervised policy answers, and supervisors of linear problems."""

import dataclasses

import numpy as np

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.safety.supervisor import Supervisor, Tolerances

TOLERANCES = Tolerances(cost=0.05, floor=0.5, violation=1e-4, disturbance=(1.0,), patience=3)


def instances(case, number, seed=0):
    """Near rest, the disturbances below zero: there the broken policy is sound."""
    random = np.random.default_rng(seed)
    (p, n), m = case.c.shape, case.b.shape[1]
    scale = 0.02 * np.repeat([1.0, 5.0], n // 2)
    for _ in range(number):
        preview = 0.02 * random.normal(size=(case.problem.horizon, p))
        yield random.normal(size=n) * scale, -0.5 * random.uniform(size=m), 3 * random.normal(size=m), preview


def flat(instance):
    return np.concatenate([np.ravel(part) for part in instance])


def bad(instance):
    """The same, but with the disturbance under which the broken policy is broken."""
    return (instance[0], np.append(0.5, instance[1][1:]), *instance[2:])


def supervisor_of(case, policy, tolerances=TOLERANCES, **options):
    return Supervisor(policy, ExactMpc(case.system, policy.problem, **options), tolerances)


def policy_shifted(policy, units):
    """The same law, all of its inputs so much higher."""
    hidden, (matrix, bias) = policy.layers
    half = 0.5 * (np.array(policy.problem.input_high) - np.array(policy.problem.input_low))
    return dataclasses.replace(policy, layers=(hidden, (matrix, bias + units / np.tile(half, policy.horizon))))


def checked(case, policy, instance, last_plan, tolerances=TOLERANCES):
    """What a single check finds."""
    mpc = ExactMpc(case.system, policy.problem)
    supervisor, horizon = Supervisor(policy, mpc, tolerances), mpc.shooting.horizon
    mpc.adopt(np.zeros(policy.inputs), np.reshape(last_plan, horizon.inputs.shape), np.zeros_like(horizon.states))
    supervisor.control(*instance)
    return supervisor.reason
