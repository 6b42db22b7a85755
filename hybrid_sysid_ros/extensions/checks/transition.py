"""Transition: a rig linearised at rest, under the loops or the feedback of its experiments."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.core import step_with_jacobian
from hybrid_sysid_ros.rigs.feedback import Feedback
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import LowPassFilter
from hybrid_sysid_ros.support.arrays import Array

STEPS_LATE = 100
"""Most steps of delay in a loop; a loop with more is examined in longer steps."""


def transition_of(rig: Rig, rounding: float) -> tuple[Array, float, str]:
    """The linearised rig under its loops or feedback, the seconds of that step, and the section that declares them."""
    feedback, loops = rig.experiments.feedback, rig.experiments.loops
    if feedback is not None:
        every = rig.steps(feedback.period, f"{rig.file}: experiments.feedback.period")
        return _under_feedback(rig, feedback, rounding, every), feedback.period, "feedback"
    late = (rig.system.input_delays[index] + rig.sensors[loop.output].delay for index, loop in loops.items())
    every = 1 + int(max(late, default=0.0) / (STEPS_LATE * rig.step))
    return _under_loops(rig, rounding, every), every * rig.step, "loops" if loops else ""


def _jacobians(rig: Rig, rounding: float) -> tuple[Array, Array]:
    """[A, B] of a step and [C, D] of the outputs at rest."""
    rest = np.zeros(len(rig.system.states)), np.zeros(len(rig.system.inputs))
    found = [
        step_with_jacobian(rig.system, *rest, step=rig.step, smoothing=rounding, output=output)[1]
        for output in (False, True)
    ]
    step, output = (
        np.nan_to_num(jacobian, posinf=0.0, neginf=0.0) for jacobian in found
    )  # the derivative of a root is infinite at rest
    return step, output


def _under_feedback(rig: Rig, feedback: Feedback, rounding: float, every: int) -> Array:
    """Transition over a period at rest of states and integrals, (states + inputs, states + inputs), without delays."""
    step, output = _jacobians(rig, rounding)
    n, m = len(step), len(rig.actuators)
    held, seen = _held(step, every), output[:, :n]
    gains, following = feedback.gains @ seen, feedback.period * feedback.integral @ seen[list(feedback.followed)]
    return np.block([[held[:, :n] - held[:, n:] @ gains, -held[:, n:]], [following, np.eye(m)]])


def _under_loops(rig: Rig, rounding: float, every: int) -> Array:
    """Transition (all, all) over ``every`` steps at rest while the loops of the experiments drive their inputs: of the
    system's states, and of each loop's low-pass, integral part and delayed inputs. A sensor's delay counts as a delay
    of its loop's input.
    """
    system, m, h = rig.system, len(rig.system.inputs), every * rig.step
    step, output = _jacobians(rig, rounding)
    step, loops, sizes = _held(step, every), [], [len(step)]
    for index, loop in rig.experiments.loops.items():
        sensor, low_pass = rig.sensors[loop.output], np.zeros((0, 1))
        if sensor.low_pass:
            exact = LowPassFilter(sensor.low_pass, rig.step)
            low_pass = _held(np.column_stack([exact.transition, exact.gain]), every)
        whole, part = divmod((system.input_delays[index] + sensor.delay) / h, 1.0)
        loops.append((index, loop, sensor.scale, low_pass, int(whole), part))
        sizes += [len(low_pass), 1, int(whole) + 2]
    state, *kept = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])  # each row in terms of all numbers
    acted, acting, following = np.zeros((m, sum(sizes))), np.zeros((m, sum(sizes))), []
    for (index, *_, whole, part), past in zip(loops, kept[2::3], strict=True):
        acted[index] = (1.0 - part) * past[whole] + part * past[whole + 1]
    outputs = output @ np.vstack([state, acted])
    for (index, loop, scale, low_pass, whole, part), filtered, integral, past in zip(
        loops, kept[::3], kept[1::3], kept[2::3], strict=True
    ):
        both = np.vstack([filtered, outputs[loop.output]])
        error = -both[len(filtered) - 1] / scale  # of the low-pass's last state, or without one of the output
        past = np.vstack([loop.gain * error + integral, past[:-1]])
        acting[index] = (1.0 - part) * past[whole] + part * past[whole + 1]
        following += [low_pass @ both, integral + loop.gain * loop.integral * h * error, past]
    return np.vstack([step @ np.vstack([state, acting]), *following])


def _held(step: Array, count: int) -> Array:
    """[A, B] of ``count`` steps under constant inputs."""
    n, width = step.shape
    held: Array = np.linalg.matrix_power(np.vstack([step, np.eye(width)[n:]]), count)[:n]
    return held
