"""Feed-forward of a feedback from a model: what its followed outputs' courses ask of the other outputs and inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.extensions.trim.equilibrium import equilibrium
from hybrid_sysid_ros.rigs.feedback import TERMS, Feedback
from hybrid_sysid_ros.support.errors import UserError


def scheduled(feedback: Feedback, system: System) -> Feedback:
    """The feedback with W and F of a model, as it was identified, in place of those of its file.

    About the model's equilibrium, x' = A x + B u and y = C x, the course x = sum X_k r^(k), u = sum U_k r^(k) of
    followed outputs r solves A X_k + B U_k = X_(k-1) with followed outputs C X_0 = 1 and C X_k = 0 for k > 0; value,
    rate and acceleration of r are kept. Francis (1977), SIAM J. Control Optim. 15(3), for r^(k) = 0 from some k on.

    Raises UserError where the model has no equilibrium, an output that is no state, or outputs that its inputs can't
    hold anywhere.
    """
    found, n, m = equilibrium(system), len(system.declared_states), len(system.inputs)
    names = [item.name for item in system.declared_states]
    if missing := [item.name for item in system.outputs if item.name not in names]:
        raise UserError(f"feed-forward: output {missing[0]} is no state of the model")
    measured = np.eye(n)[[names.index(item.name) for item in system.outputs]]
    followed = measured[list(feedback.followed)]
    matrix = np.block([[found.transition, found.gain], [followed, np.zeros((len(followed), m))]])
    if len(followed) != m or np.linalg.matrix_rank(matrix) < n + m:
        raise UserError("feed-forward: the model's inputs can't hold the followed outputs anywhere")
    before, wanted, forward = np.zeros((n, m)), [], []
    for k in range(TERMS):
        course = np.linalg.solve(matrix, np.concatenate([before, np.eye(m) if k == 0 else np.zeros((m, m))]))
        before = course[:n]
        wanted.append(measured @ before)
        forward.append(course[n:])
    by_command = [np.stack(parts, axis=2).reshape(len(parts[0]), -1) for parts in (wanted, forward)]
    return replace(feedback, wanted=by_command[0], forward=by_command[1])
