"""Replaying: what a bag recorded of a loop, and what its estimator and controller answer to the same today."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags import attached, laid_out
from hybrid_sysid_ros.bags.bag import opened
from hybrid_sysid_ros.bags.columns import TopicColumns
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import processes, run_provenance
from hybrid_sysid_ros.runtime.parameters import parameters
from hybrid_sysid_ros.runtime.recorded_loop import ONE_CLOCK
from hybrid_sysid_ros.runtime.session import Session
from hybrid_sysid_ros.support.errors import UserError

REPLAY = "hybrid_sysid_ros.extensions.playback.nodes.replay"
NEEDED = ("joint_states", "reference", "state_estimate", "joint_command")
"""Topics that a replay goes by and is compared with."""
BY_TIME = ("silence", "time_limit")
"""Parameters of waiting, which nobody does here."""


@dataclass(frozen=True, kw_only=True)
class Changes:
    """What is other than it was recorded; empty: as it was."""

    rig: str = ""
    model: str = ""
    policy: str = ""
    policy_path: str = ""


@dataclass(frozen=True, kw_only=True)
class ReplayPlan:
    """What is replayed: parameters of estimator and controller, and where they come from."""

    rig: Rig
    lockstep: bool
    """Whether the bag was recorded in lockstep, so that the same answers are to be expected."""
    estimator: Mapping[str, Any]
    controller: Mapping[str, Any]
    source: str
    """Of the parameters, in words."""
    changes: Changes
    """What is other than it was recorded."""

    @property
    def fixed(self) -> list[str]:
        """Parameters that are other than they were recorded, whatever became of those while the bag was recorded."""
        changed = [name for name, value in dataclasses.asdict(self.changes).items() if value]
        return [*changed, *BY_TIME]


def replay_plan_of(bag: Path, changes: Changes, scratch: Path, *, recover: bool = False) -> ReplayPlan:
    """What to replay of a bag, by what it says of itself; of a bag that says nothing, by the rig's defaults.

    Another model without another policy is driven by the exact MPC: a network is of the model that it was trained for.
    scratch: a folder for the models and policies that are in the bag. Raises UserError where a topic is missing, what
    the bag says of itself is unreadable, or the rig is not there.
    """
    if changes.model and not changes.policy and not changes.policy_path:
        changes = dataclasses.replace(changes, policy="exact")
    found = attached(bag)
    stored = {node: run_provenance.parameters(found, node) for node in ("estimator", "controller")}
    rig = rigs.load(changes.rig or stored["estimator"].get("rig") or rigs.default())
    lockstep, rate = _timing(bag, rig, recover)
    values = {node: _known(rig, node, stored[node]) for node in stored}
    given = {"model": changes.model, "policy": changes.policy, "policy_path": changes.policy_path}
    for node, parameters_of in values.items():
        for kind, name in run_provenance.FOLDERS.items():
            if any(key.startswith(f"{node}/{kind}/") for key in found):
                parameters_of[name] = str(laid_out(found, scratch, below=f"{node}/{kind}"))
        parameters_of |= {name: value for name, value in given.items() if value and name in parameters(rig, node)}
        if changes.policy == "exact" and not changes.policy_path:  # the recorded network is of no use, or does not fit
            parameters_of.pop("policy_path", None)
        parameters_of |= {"rig": rig.source, "lockstep": lockstep, "autostart": True}
        if not lockstep:  # the bag's time is the nodes', which has no hurry
            parameters_of |= {"use_sim_time": True, "silence": 0.0}
        elif not stored[node]:
            parameters_of["latency"] = 0.0
    values["estimator"].setdefault("rate", rate)
    if not lockstep:
        values["controller"]["time_limit"] = 0.0
    source = "as the bag says" if stored["estimator"] else "the rig's defaults: the bag does not say what they were"
    return ReplayPlan(rig=rig, lockstep=lockstep, **values, source=source, changes=changes)


def _known(rig: Rig, node: str, stored: Mapping[str, Any]) -> dict[str, Any]:
    """The recorded parameters that a node of today has."""
    known = parameters(rig, node)
    return {name: known[name].checked(value) for name, value in stored.items() if name in known}


def _timing(bag: Path, rig: Rig, recover: bool) -> tuple[bool, float]:
    """Whether a bag was recorded in lockstep, by its stamps, and the rate of its measurements [Hz]. Raises UserError
    where a topic that a replay needs is missing or silent.
    """
    names = [f"/{rig.namespace.strip('/')}/{topic}" for topic in NEEDED]
    with opened(bag, recover=recover) as source:
        for name in names:
            if name not in source.topics or not source.topics[name].messages:
                raise UserError(
                    f"{bag}: no messages of {name}: the bag has {source.listing}; a replay needs all of "
                    f"{', '.join(names)}: record them, or name the right rig (--rig)"
                )
        block = next(iter(source.blocks(names[:1])))
        stamps = TopicColumns(block).stamps("header.stamp.sec")
        steps = np.diff(np.unique(stamps))
        if not len(steps):
            raise UserError(f"{bag}: {names[0]} has one measurement only: nothing to replay")
        return bool(abs(np.median(block.logged - stamps)) > ONE_CLOCK), round(1e9 / float(np.median(steps)), 6)


def replay(
    bag: Path,
    out: Path,
    changes: Changes,
    *,
    recover: bool = False,
    tell: Callable[[str], None] = print,
    progress: Callable[[float], None] = lambda seconds: None,
) -> ReplayPlan:
    """Replay a bag into another, `out`, in a process of its own; return what was replayed.

    progress: gets the seconds that it has taken so far. Raises UserError without ROS, where the bag lacks something, or
    where a node can't be made with these parameters.
    """
    with TemporaryDirectory() as scratch:
        plan = replay_plan_of(bag, changes, Path(scratch), recover=recover)
        order = {
            "bag": str(bag),
            "out": str(out),
            "namespace": f"/{plan.rig.namespace.strip('/')}",
            "estimator": plan.estimator,
            "controller": plan.controller,
            "fixed": plan.fixed,
            "recover": recover,
        }
        with Session(plan.rig.source, tell=tell) as session:
            session.start("replay", processes.module(REPLAY, json.dumps(order)))
            session.wait_for_end(["replay"], progress)
    return plan


def change_summary(changes: Changes) -> str:
    """Those changes in words."""
    given = {name: value for name, value in dataclasses.asdict(changes).items() if value}
    return ", ".join(f"{name} {value}" for name, value in given.items()) or "nothing changed"
