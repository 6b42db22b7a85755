"""Node loop: the loop of the nodes on a simulated plant, in one process, as a bag of it would tell it."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import make_interp_spline

from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.extensions.shared.guarded_controller import GuardedController
from hybrid_sysid_ros.rigs.excitation import ReferenceSchedule
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration


def node_loop(
    rig: Rig, loop: GuardedController, schedule: ReferenceSchedule, plant: Plant, *, latency: float
) -> ClosedLoop:
    """Answer each reading at the estimator's rate along a reference, whose previews are lines between their points. The
    outputs are the readings. latency: time from a reading to the command that answers it [s].
    """
    period = 1.0 / configuration.defaults(rig, "estimator")["rate"]
    steps, waiting = rig.steps(period, "the estimator's period"), round(latency / rig.step)
    scales = np.array([item.scale for item in rig.display])
    times = period * np.arange(round(schedule.duration / period))
    spacing = configuration.defaults(rig, "reference")["point_spacing"]
    points = spacing * np.arange(math.ceil((schedule.duration + loop.lead + loop.times[-1]) / spacing) + 1)
    reference = make_interp_spline(points, scales * schedule(points), k=1)
    outputs, inputs, estimates = [], [], []
    loop.estimator.begin()
    loop.begin()
    applied = loop.input.copy()
    for time in times:
        reading = plant.sensed().copy()
        estimate = loop.estimator.update(float(time), reading, applied)
        ahead = reference(time + loop.lead + np.concatenate([[0.0], loop.times]))
        command = loop.control(estimate, applied, ahead[0], ahead[1:], period)
        before, applied = (
            applied,
            np.array([item.bounded(float(u)) for item, u in zip(rig.actuators, command, strict=True)]),
        )
        outputs.append(reading)
        inputs.append(applied)
        estimates.append(estimate.state.copy())
        for step in range(steps):
            plant.advance(before if step < waiting else applied)
    return ClosedLoop(
        time=times,
        outputs=np.array(outputs),
        estimates=np.array(estimates),
        references=scales * schedule(times),
        inputs=np.array(inputs),
    )
