"""Plant health: what a simulated plant says of itself in the diagnostics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybrid_sysid_ros.nodes.diagnostics import WARN, Task

if TYPE_CHECKING:
    from hybrid_sysid_ros.nodes.plant import PlantNode

FAULTS = ("bias", "sensor_out", "brake", "command_delay")
"""Parameters that simulate faults of the rig."""


def loop_task(node: PlantNode) -> Task:
    """The task of a plant: its loop."""
    answers, drive = node.answers, node.drive
    if answers.latest < 0:
        waiting = "waiting for a controller on joint_command and readers of joint_states"
        return Task(name="loop", level=WARN, message=waiting)
    troubles = {
        "measurements without an answer": answers.missed,
        "measurements left out": node.overruns,
        "commands that answer nothing": node.rejected,
        "stops by hand": node.hand.count,
        "commands after a stop by hand": node.hand.disobeyed,
        "times at rest for want of commands": drive.timeouts,
        "steps at the end of the travel": node.plant.stopped,
        "times the clock was set": node.timeline.sets,
        **{f"commands {reason}": count for reason, count in node.dropped("joint_command").items()},
    }
    values = {
        "measurements": answers.latest + 1 - node.overruns,
        "measurement_rate_hz": answers.latest / max(node.time, 1e-9),
        "commands": answers.commands,
        "missed_commands": answers.missed,
        "last_missed": answers.last_missed,
        "rejected_commands": node.rejected + sum(node.entry.dropped.values()),
        "direct_commands": node.direct,
        "stops": node.stops,
        "stops_by_hand": node.hand.count,
        "stopped_by_hand": node.hand.latched,
        "disobeyed_commands": node.hand.disobeyed,
        "steps_at_travel_end": node.plant.stopped,
        "command_timeouts": drive.timeouts,
        "saturated_commands": drive.saturated,
        "overruns": node.overruns,
        "repeated_measurements": node.repeated,
        **{fault: node.settings[fault] for fault in FAULTS},
        **answers.delay.report("delay"),
        **node.lateness.report("timer_lateness"),
    }
    task = node.judged("loop", troubles, answers.latest + 1, **values)
    return node.hand.noted(node.silent(task, "joint_command"))
