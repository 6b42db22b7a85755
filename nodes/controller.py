"""Controller: answers every estimate with a command."""

from __future__ import annotations

import gc
import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from time import monotonic_ns, perf_counter
from typing import Any

import numpy as np
from rclpy.publisher import Publisher

from hybrid_sysid_ros.control import Controller, ExactMpc, Plan, Problem
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.supervisor import LAYERS, Supervisor
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.nodes.base import RigNode, run
from hybrid_sysid_ros.nodes.border import Order
from hybrid_sysid_ros.nodes.cdr import JointWriter, TrajectoryWriter
from hybrid_sysid_ros.nodes.diagnostics import OK, Task
from hybrid_sysid_ros.nodes.layout import AHEAD, Layout, Place, Slots
from hybrid_sysid_ros.nodes.messages import SECOND, Joints, Trajectory
from hybrid_sysid_ros.nodes.model import model_of
from hybrid_sysid_ros.nodes.preview import Preview
from hybrid_sysid_ros.nodes.source import Source
from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.runtime.checking import check_tolerances
from hybrid_sysid_ros.runtime.configuration import mpc_problem, shipped
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

WATCH_PERIOD = 0.05  # s, between two looks whether estimates still come
SHOW_PERIOD = 0.1  # s, between two predicted trajectories
WARM_UPS = 6  # answers before the node is ready
COMPILING = 1.0  # s, from which on an answer has compiled something
NO_REFERENCE, HELD, ZEROED = "no reference", "held", "zeroed"  # layers of safety, beside those of the controller
SOUND = {"solved", "iterated", "policy"}
STANDING_IN = {"shifted plan", "held"}  # layers that may stand in for zero_after, no longer
REFERENCE_PATIENCE = 3 * SECOND  # that a controller waits for somebody who gives references
MARGIN = 0.02  # of the travel, at each end, that no reference reaches


class ControllerNode(RigNode):
    """state_estimate and reference in; joint_command out with the stamp of the estimate.

    Layers, each counted: the network's plan; where that does not pass its check, the exact MPC's; where that is late or
    has no solution, the rest of the last plan; for an estimate that is no number or older than stale_after the last
    command; when these have lasted for zero_after, inputs at rest, as on the way out. Without supervision the network
    or the exact MPC is the first layer. References are held within the rig's travel.
    Until the first reference comes the outputs are held where they were found. In lockstep an estimate waits for a
    reference that covers its preview instead. joint_command is advertised once there are estimates to expect.

    The state is rebuilt by name from the entries NAME_ahead, whatever else there is and in whatever order.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("controller", **options)
        self.lockstep: bool = self.settings["lockstep"]
        model = model_of(self)
        self.network: Policy | None = None
        self.controller = self.new_controller(model)
        self.ahead = round((model.system.delay + self.settings["latency"]) * SECOND)
        period, horizon = self.controller.period, self.controller.horizon
        self.grid = np.round(period * np.arange(1, horizon + 1) * SECOND).astype(np.int64)
        self.layout = layout = Layout(self.rig, model.system)
        states, inputs = len(layout.states), len(layout.inputs)
        self.estimated = Slots([place.ending(AHEAD) for place in (*layout.states, *layout.inputs)])
        self.given = np.empty(states + inputs)
        self.state, self.disturbance = np.split(self.given, [states])
        self.outputs = Slots(layout.outputs)
        self.tracked = np.array(self.problem.output_weights) > 0.0
        low, high = self.rig.travel_of_outputs
        margin = np.where(np.isfinite(high - low), MARGIN * (high - low), 0.0)
        self.reach = low + margin, high - margin
        correction = self.network.correction if self.network is not None else None
        names: tuple[str, ...] = correction.names if correction is not None else ()
        self.followed = Slots([Place(name, "position") for name in names])
        self.rest = np.array([actuator.rest for actuator in self.rig.actuators])
        planned = Slots([*layout.states, *layout.inputs])
        self.plans = TrajectoryWriter(planned, self.grid.tolist(), self.signature)
        self.writer = JointWriter(Slots(layout.inputs), self.signature)
        self.commands: Publisher | None = None
        self.predictions = self.open("predicted_trajectory")
        self.entry, self.wishes = self.border("state_estimate"), self.border("reference")
        self.begin()
        self.warm_up()
        self.begin()
        needed = [self.listen(self.entry, "state_estimate", self.on_estimate)]
        references = self.listen(self.wishes, "reference", self.on_reference)
        if self.lockstep:
            needed.append(references)
        patience = 0 if self.lockstep else monotonic_ns() + REFERENCE_PATIENCE  # the first step of a run is a step, too

        def expected() -> bool:
            referred = bool(references.publishers()) or monotonic_ns() > patience
            return referred and all(entry.publishers() for entry in needed)

        self.when(expected, self.advertise)
        if not self.lockstep:
            self.every(WATCH_PERIOD, self.watch)

    def new_controller(self, model: Model) -> Controller:
        """The controller that the parameters name."""
        settings = self.settings
        self.problem = asked = mpc_problem(settings, self.rig, model.system)
        interior = settings["solver"] == "ipopt"
        if settings["policy"] == "exact":
            return self.reference_solver(model, asked) if interior else self.exact(model, asked)
        if interior:
            raise UserError(f"parameter solver is ipopt, policy {settings['policy']}: ipopt works alone, policy:=exact")
        path = Path(settings["policy_path"] or shipped(self.rig.name, "policy"))
        self.sources["policy"] = Source(path)
        self.network = network = policy.load(path, model=model)
        self.look_at(network, path, asked)
        self.problem = network.problem
        if settings["policy"] == "network":
            return network
        tolerances = check_tolerances(settings, self.rig, network.problem)
        return Supervisor(network, self.exact(model, network.problem), tolerances)

    def reference_solver(self, model: Model, problem: Problem) -> Controller:
        """IPOPT on the exact MPC's problem: slow, so it is for lockstep, and loaded only where it is asked for."""
        from hybrid_sysid_ros.control.mpc.interior_point import InteriorPointMpc

        if not self.lockstep:
            self.get_logger().warning("solver ipopt takes longer than a measurement's period: it is for lockstep")
        return InteriorPointMpc(model.system, problem)

    def exact(self, model: Model, problem: Problem) -> ExactMpc:
        """The exact MPC. In lockstep it takes its time, so that a run repeats."""
        limit = math.inf if self.lockstep else self.settings["time_limit"] or math.inf
        clock = None if math.isinf(limit) else perf_counter
        real_time = self.settings["real_time"]
        return ExactMpc(model.system, problem, real_time=real_time, time_limit=limit, clock=clock)

    def look_at(self, network: Policy, path: Path, asked: Problem) -> None:
        """Say what a user should know about a network; refuse one that is not certified where that is required."""
        doubt = ""
        if network.certificate is None:
            doubt = f"{path}: has no certificate: hybrid-sysid policy certify {path} makes one"
        else:
            driver, least = self.settings["policy"], self.settings["certificate_rate"]
            mu = network.certificate.mu(driver)
            if mu < least:
                doubt = f"{path}: its certificate says mu {mu:.4f} of {driver}, less than certificate_rate {least:g}"
        if doubt and self.settings["certificate"] == "require":
            raise UserError(doubt)
        if doubt:
            self.get_logger().warning(doubt)
        made = network.problem
        names = [item.name for item in fields(Problem) if getattr(asked, item.name) != getattr(made, item.name)]
        if names:
            self.get_logger().warning(
                f"{path}: was trained with other values of {', '.join(names)} than the parameters say, and keeps them"
            )

    def begin(self) -> None:
        """Begin anew, nothing counted."""
        self.layers: Counter[str] = Counter()
        self.statuses: Counter[str] = Counter()
        if isinstance(self.controller, Supervisor):
            self.controller.reasons.clear()
        self.clipped = self.ended = self.repeated = 0
        self.execution, self.age = Timing(), Timing()
        self.forget()

    def forget(self) -> None:
        """Begin a new experiment."""
        self.controller.reset()
        self.stamp = self.sound = self.shown = self.answered = self.acted = 0
        self.settled = False
        self.home = np.zeros(len(self.outputs))
        self.input = self.rest.copy()
        self.preview: Preview | None = None
        self.waiting: Joints | None = None

    def warm_up(self) -> None:
        """Answer estimates that nobody gave: this compiles, and loads what is loaded at first use.

        The first answers are late, for they compile; those after them go on as in the loop.
        """
        names = Slots(self.layout.estimate(())).names
        self.given[:] = 0.0
        for stamp in range(1, WARM_UPS + 1):
            began = perf_counter()
            self.preview = Preview(np.array([stamp, stamp + 10 * SECOND]), np.zeros((2, len(self.outputs))))
            self.proceed(Joints("", stamp, names, [[0.0] * len(names)] * 3), stamp, began)
            if perf_counter() - began > COMPILING:
                gc.collect()  # what the compiler has left, before it needs as much again

    def advertise(self) -> None:
        """Open the topic of the commands."""
        self.commands = self.open("joint_command")

    def on_reference(self, message: Trajectory) -> None:
        """Keep the newest reference."""
        if not self.wishes.hears(message.source):
            return
        now = self.stamp if self.lockstep else self.now()
        preview = Preview.of(message, self.wishes, self.outputs, self.tracked, now)
        if preview is None:
            return
        self.wishes.believe(message.source)
        self.clipped += not preview.within(*self.reach)
        self.preview = preview
        if self.waiting is not None:
            waiting, self.waiting = self.waiting, None
            self.proceed(waiting, waiting.stamp, perf_counter())

    def on_estimate(self, joints: Joints) -> None:
        """Answer an estimate."""
        began = perf_counter()
        given = self.entry.read(joints, self.estimated)
        if given is None or (order := self.entry.admit(joints)) is None:
            return
        if order is Order.AGAIN or order is Order.LATE:
            self.repeated += 1
            self.publish()
            return
        if order is Order.RESTART:
            self.forget()
        self.given[:] = given
        self.proceed(joints, joints.stamp if self.lockstep else self.now(), began)

    def proceed(self, joints: Joints, now: int, began: float) -> None:
        """Answer an estimate that is believed and read; now: in the ROS clock [ns], began: when it came [s]."""
        stamp = joints.stamp
        last = stamp + self.ahead + int(self.grid[-1])
        if self.lockstep and (self.preview is None or not self.preview.covers(last)):
            self.wait(joints, last - stamp)
            return
        plan = self.answer(joints, (now - stamp) / SECOND, began)
        if plan is not None and stamp - self.shown >= SHOW_PERIOD * SECOND:
            self.shown = stamp
            self.show(plan, stamp + self.ahead)

    def wait(self, joints: Joints, reach: int) -> None:
        """In lockstep: keep an estimate until the reference reaches far enough [ns]."""
        if self.waiting is not None and self.preview is not None:
            self.get_logger().warning(
                f"the reference does not reach {reach / SECOND:g} s ahead: raise its preview_seconds", once=True
            )
        self.waiting = joints

    def answer(self, joints: Joints, age: float, began: float) -> Plan | None:
        """Publish the command for an estimate of an age [s]; return the plan behind it, if there is one."""
        self.stamp = stamp = joints.stamp
        self.age.add(max(age, 0.0))
        sound = bool(np.isfinite(self.given).all())
        sound = sound and self.settle(joints)
        if not sound or age > self.settings["stale_after"]:
            self.hold()
            return None
        self.follow(joints)
        preview = self.reference(stamp)
        plan = self.controller.control(self.state, self.disturbance, self.input, preview)
        layer = LAYERS[plan.status]
        self.statuses[plan.status.value] += 1
        if layer not in STANDING_IN:
            self.sound = self.time()
        elif self.is_long():
            self.layers[ZEROED] += 1
            self.send(self.rest)
            return None
        self.layers[layer] += 1
        taken = perf_counter() - began
        self.send(plan.input)
        self.execution.add(taken)
        self.controller.prepare((stamp - self.answered) / SECOND if self.answered else 0.0)
        self.answered = stamp
        return plan

    def settle(self, joints: Joints) -> bool:
        """Remember where the outputs were found first; whether the tracked ones were numbers."""
        if not self.settled:
            found = self.entry.read(joints, self.outputs)
            self.home[:] = math.nan if found is None else found
            self.home[~self.tracked] = 0.0
            self.settled = bool(np.isfinite(self.home).all())
        return self.settled

    def follow(self, joints: Joints) -> None:
        """Tell a network with a correction the parameters that the estimator follows; NaN leaves one as it was."""
        if self.followed.names and self.network is not None:
            parameters = self.entry.read(joints, self.followed)
            if parameters is not None:
                self.network.adapt(dict(zip(self.followed.names, parameters, strict=True)))

    def reference(self, stamp: int) -> Array:
        """Reference for the preview of an estimate (horizon, outputs)."""
        if self.preview is None:
            self.layers[NO_REFERENCE] += 1
            return np.tile(self.home, (len(self.grid), 1))
        self.ended += not self.preview.covers(stamp)
        return self.preview.at(stamp + self.ahead + self.grid)

    def time(self) -> int:
        """Time that no clock can set [ns]; in lockstep that of the estimates."""
        return self.stamp if self.lockstep else monotonic_ns()

    def is_long(self) -> bool:
        """Whether there has been no sound answer for zero_after."""
        return not self.sound or self.time() - self.sound > self.settings["zero_after"] * SECOND

    def hold(self) -> None:
        """Without a sound estimate: the last command, and inputs at rest when that has lasted too long."""
        long = self.is_long()
        self.layers[ZEROED if long else HELD] += 1
        self.send(self.rest if long else self.input)

    def watch(self) -> None:
        """Let the inputs rest when estimates stop: not every drive has a timeout of its own."""
        if self.moves() and monotonic_ns() - self.acted > self.settings["zero_after"] * SECOND:
            self.layers[ZEROED] += 1
            self.send(self.rest)

    def moves(self) -> bool:
        """Whether the newest command is not at rest."""
        return bool((self.input != self.rest).any())

    def close(self) -> None:
        """Leave the inputs at rest."""
        if self.moves():
            self.send(self.rest)
        super().close()

    def send(self, inputs: Array) -> None:
        """Publish a command (m,) that answers the newest estimate."""
        self.acted = monotonic_ns()
        self.input[:] = inputs
        self.command = self.writer.pack(self.stamp, inputs.tolist())
        self.publish()

    def publish(self) -> None:
        """Publish the newest command."""
        if self.commands is not None:
            self.commands.publish(self.command)

    def show(self, plan: Plan, start: int) -> None:
        """Publish the predicted trajectory, if someone looks."""
        if not len(plan.states) or not self.predictions.get_subscription_count():
            return
        self.predictions.publish(self.plans.pack(start, np.hstack([plan.states, plan.inputs]).tolist()))

    def health(self) -> Sequence[Task]:
        layers, statuses = dict(self.layers), dict(self.statuses)
        answers = sum(count for name, count in layers.items() if name != NO_REFERENCE)
        loop = {
            "answers without a reference": layers.get(NO_REFERENCE, 0),
            "commands held": layers.get(HELD, 0),
            "commands at rest": layers.get(ZEROED, 0),
            "answers after the end of the reference": self.ended,
            "references beyond the travel": self.clipped,
            **{f"estimates {reason}": count for reason, count in self.dropped("state_estimate").items()},
            **{f"references {reason}": count for reason, count in self.dropped("reference").items()},
        }
        values = {
            "policy": self.settings["policy"],
            "commands": answers,
            **named("layer", layers),
            "dropped_estimates": sum(self.entry.dropped.values()),
            "dropped_references": sum(self.wishes.dropped.values()),
            "clipped_references": self.clipped,
            "repeated_estimates": self.repeated,
            **self.execution.report("execution"),
            **self.age.report("estimate_age"),
        }
        judged = self.silent(self.judged("loop", loop, answers, **values), "state_estimate")
        if not self.stamp and judged.level == OK:
            judged = replace(judged, message="waiting for estimates")
        plans = {f"plans {name}": count for name, count in statuses.items() if name not in SOUND}
        checked = named("check", dict(self.controller.reasons)) if isinstance(self.controller, Supervisor) else {}
        return [judged, self.judged("policy", plans, answers, **named("status", statuses), **checked)]


def named(prefix: str, counts: Mapping[str, int]) -> dict[str, int]:
    """Counts by a key of the diagnostics."""
    return {f"{prefix}_{name.replace(' ', '_')}": count for name, count in sorted(counts.items())}


main = partial(run, ControllerNode)

if __name__ == "__main__":
    sys.exit(main())
