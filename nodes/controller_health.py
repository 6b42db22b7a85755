"""Controller health: what a controller says of itself in the diagnostics, and whether it is ready to be armed."""

from __future__ import annotations

from dataclasses import replace
from time import monotonic_ns
from typing import TYPE_CHECKING

import numpy as np

from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.nodes.diagnostics import ERROR, OK, WARN, Task, doubted, named_counts
from hybrid_sysid_ros.nodes.messages import SECOND

if TYPE_CHECKING:
    from hybrid_sysid_ros.nodes.controller import ControllerNode

NO_REFERENCE, HELD, ZEROED, RESTED, STOPPED = "no reference", "held", "zeroed", "rested", "stopped"
"""Layers of safety, beside those of the controller: rested by the guard, zeroed without a sound estimate."""
SOUND = {"solved", "iterated", "policy"}


def unready(node: ControllerNode) -> list[str]:
    """What is in the way of arming: whether estimates come, are numbers, of all sensors and beyond doubt, and whether
    what was loaded is still what lies in its folder.
    """
    found, heard = [], node.validators["state_estimate"].heard
    if not heard or monotonic_ns() - heard > node.settings["stale_seconds"] * SECOND:
        found.append("no estimates come on state_estimate: start the estimator and the sensors")
    elif not np.isfinite(node.adapter.given).all():
        found.append("the estimates are no numbers: look at the estimator's diagnostics")
    guard = node.adapter.guard
    found += [f"{guard.reason}: wait until it has settled"] if guard.level else []
    found += ["a sensor shows nothing or is left out: look at the estimator's diagnostics"] * node.adapter.incomplete
    return [*found, *filter(None, [node.adapter.doubt]), *node.changed.values()]


def loop_tasks(node: ControllerNode) -> list[Task]:
    """The tasks of a controller: its loop, and the policy behind it."""
    layers, statuses, times = dict(node.layers), dict(node.statuses), dict(node.operation.times)
    answers = sum(count for name, count in layers.items() if name != NO_REFERENCE)
    loop = {
        "answers without a reference": layers.get(NO_REFERENCE, 0),
        "commands held": layers.get(HELD, 0),
        "commands at rest": layers.get(ZEROED, 0),
        "answers after the end of the reference": node.ended,
        "references beyond the travel": node.clipped,
        **{f"estimates {reason}": count for reason, count in node.dropped("state_estimate").items()},
        **{f"references {reason}": count for reason, count in node.dropped("reference").items()},
    }
    guard, operation = node.adapter.guard, node.operation
    by_itself = operation.reached if operation.reached < LoopState.STOPPED else LoopState.DRIVING
    state = operation.state(by_itself)  # what a user has asked for counts before the next estimate
    by_guard = guard.level and LoopState.DRIVING < state < LoopState.STOPPED
    reason = guard.reason if by_guard or state is LoopState.SLOWED else operation.words
    if state is LoopState.RESTING and not by_guard:
        reason = "there is no sound estimate, or no answer to it"
    values = {
        "state": state.word,
        "state_reason": reason,
        "stops": operation.stops,
        "ready": "; ".join(unready(node)) or "yes",
        **{f"times_{each.word}": times.get(each, 0) for each in LoopState},
        **{f"evidence_{name}": value for name, value in guard.evidence.items()},
        "policy": node.settings["policy"],
        "commands": answers,
        **named_counts("layer", layers),
        "dropped_estimates": sum(node.entry.dropped.values()),
        "dropped_references": sum(node.wishes.dropped.values()),
        "clipped_references": node.clipped,
        "repeated_estimates": node.repeated,
        **node.execution.report("execution"),
        **node.age.report("estimate_age"),
    }
    judged = node.silent(node.judged("loop", loop, answers, **values), "state_estimate")
    doubts, why = guard.doubts
    was_doubted, node.doubts = doubts != node.doubts, doubts  # since the last report: a loop slows for less
    if was_doubted or guard.level or state is LoopState.SLOWED:
        worst = ERROR if guard.level > LoopState.SLOWED else WARN
        words = f"{state.word}: {why}" if guard.settings.act else f"{why} (distrust is tell)"
        rest = "" if judged.level == OK else f"; {judged.message}"
        judged = replace(judged, level=max(judged.level, worst), message=words + rest)
    if not node.stamp and judged.level == OK:
        judged = replace(judged, message="waiting for estimates")
    if operation.words and (judged.level == OK or operation.emergency):
        level = max(judged.level, WARN) if operation.emergency else judged.level
        judged = replace(judged, level=level, message=operation.words)
    plans = {f"plans {name}": count for name, count in statuses.items() if name not in SOUND}
    supervisor = node.adapter.supervisor
    checked = {} if supervisor is None else named_counts("check", dict(supervisor.reasons))
    policy = node.judged("policy", plans, answers, **named_counts("status", statuses), **checked)
    return [judged, doubted(policy, node.adapter.doubt)]
