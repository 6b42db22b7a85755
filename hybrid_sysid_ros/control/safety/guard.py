"""Guard: turns what a loop knows about its estimate, actuators and range into slower, held or resting inputs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.control.controller import Controller
from hybrid_sysid_ros.control.safety import commanding, guarding
from hybrid_sysid_ros.control.safety.failsafe import Evidence, Failsafe, Ladder, LoopState
from hybrid_sysid_ros.control.safety.governor import GovernedOutput, ReferenceGovernor, come_back, lead_from
from hybrid_sysid_ros.control.safety.guarding import GuardedInput, GuardMemory, GuardRecord, StateRange
from hybrid_sysid_ros.support.arrays import Array

REASONS = {
    "estimate": "measurements contradict the model",
    "actuator": "the actuator does not do what was commanded",
    "range": "the state is outside of the rig's travel or validity",
}
"""Kinds of evidence, in words."""
LEFT_OUT = "a sensor is missing or left out: it may show an actuator's fault"
REVERSED = "an input acts reversed, and is sent with the other sign"
CAUSES = (*REASONS.values(), LEFT_OUT, REVERSED)
"""Words of a guard's causes."""
OUTSIDE = 0.02  # of a state's range, by which it may be beyond the end without being evidence

PARALLEL = 0.99
"""Cosine from which on two rows of a stabiliser are parallel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GuardSettings:
    """Thresholds of a guard. n states, m inputs, p outputs."""

    act: bool
    """Whether the guard acts; otherwise it only says what it would do."""
    stabilised: bool = False
    """Whether the rig can't rest, and has a stabiliser that goes on with actuators that are off, weak or stuck."""
    ladder: Ladder
    slow_share: float
    """Of half an input's range, by which it may leave its rest while slowed, and of ``resume_rate``."""
    resume_rate: Array
    """(p,): by which the reference moves on when the loop comes back [output unit/s]."""
    reach: tuple[Array, Array]
    """Lowest and highest set-points (p,), NaN where there is no limit."""
    recent: float
    """Time [s] after which an actuator does not carry out a command any more that another one has replaced."""
    tolerance: float
    """Share of its range by which an actuator may differ from its commands."""
    low: Array
    """(m,), the lowest inputs."""
    high: Array
    """(m,), the highest."""
    rate: Array
    """(m,), the fastest changes [input unit/s], infinite where there is no limit."""
    state_low: Array
    """(n,), the lowest states that the rig's travel and validity allow, minus infinity where nothing is said."""
    state_high: Array
    """(n,)."""
    alike: Array
    """(m, m): by how much input i makes up for what input j lacks, 0 where it does not; see :func:`acting_alike`."""
    stops: Array
    """(n,), 1 where these are stops at which the rig has fallen, beyond what its stabiliser can lift; 0 elsewhere."""


def acting_alike(gains: Array, ranges: Array) -> Array:
    """By how much input i makes up for what input j lacks (m, m), from a stabiliser's gains K (m, n) and the inputs'
    ranges R (m,): R_i^2 k_j / (R_j^2 k_i) for parallel rows k, else 0; so 1 for i = j that the stabiliser uses.

    An LQR's row is k_i = r_i^-1 b_i' P, and Bryson's rule sets r_i^-1 to R_i^2: so b_i' P tells what an input does to
    its cost.
    """
    effects = gains / np.square(ranges)[:, None]
    products, sizes = effects @ effects.T, np.linalg.norm(effects, axis=1)
    across = np.outer(sizes, sizes)
    parallel = (across > 0.0) & (np.abs(products) > PARALLEL * across)
    return np.divide(products, np.square(sizes)[:, None], out=np.zeros_like(products), where=parallel)


class Guard:
    """Stands between estimate, controller and actuator: judges, governs the reference and limits the command.

    The evidence: ``doubt`` of the estimator; the distance of the applied inputs from the hull of the recent commands,
    over the tolerance or, squared, over the mean square of the commands; the distance of the state from its range over
    OUTSIDE of that range, where a stop counts as two of these beyond. memory: of the kernels of :mod:`~.guarding`,
    which do all that.
    """

    def __init__(self, settings: GuardSettings) -> None:
        self.settings = settings
        self.begin()

    def begin(self) -> None:
        """Forget the past."""
        settings = self.settings
        low, high = settings.state_low, settings.state_high
        end = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high, 0.0))
        width = np.where(np.isfinite(high - low), high - low, np.maximum(1.0, np.abs(end)))
        ends = zip(settings.low.tolist(), settings.high.tolist(), settings.rate.tolist(), strict=True)
        outside = OUTSIDE * width
        room = 2.0 * outside * settings.stops  # so that evidence is 2 at a stop, which nothing passes
        ranges = np.stack([low + room, high - room, outside, settings.stops], axis=1).tolist()
        outputs = np.stack([settings.resume_rate, *settings.reach], axis=1).tolist()
        inputs = [GuardedInput(a, b, c, settings.tolerance * (b - a), min(max(0.0, a), b)) for a, b, c in ends]
        self.memory = GuardMemory(
            core=[GuardRecord(bool(settings.act), settings.stabilised, settings.slow_share, settings.recent)],
            failsafe=[Failsafe(*settings.ladder)],
            governor=[ReferenceGovernor()],
            kinds=[Evidence() for _ in REASONS],
            inputs=inputs,
            states=[StateRange(*item) for item in ranges],
            outputs=[GovernedOutput(*item) for item in outputs],
            sent=[item.middle for item in inputs] * guarding.REMEMBERED,
            replaced=[-math.inf] + [math.inf] * (guarding.REMEMBERED - 1),
            alike=settings.alike.ravel().tolist(),
        )

    def go_on(self, other: Guard) -> None:
        """Go on where another guard of the loop is, which this one replaces."""
        own, old = self.memory, other.memory
        core, failsafe = old.core[0], old.failsafe[0]
        own.core[0].share, own.core[0].tried, own.core[0].row = core.share, core.tried, core.row
        own.core[0].reversed, own.core[0].cause = core.reversed, core.cause
        own.core[0].doubted, own.core[0].found = core.doubted, core.found
        own.failsafe[0].level, own.failsafe[0].cause = failsafe.level, failsafe.cause
        own.governor[0].free, own.governor[0].slow = old.governor[0].free, old.governor[0].slow
        for output, before in zip(own.outputs, old.outputs, strict=True):
            output.reference = before.reference
        for item, last in zip(own.inputs, old.inputs, strict=True):
            item.missed, item.asked, item.trim, item.opposes = last.missed, last.asked, last.trim, last.opposes
        self.memory = own._replace(kinds=old.kinds, sent=old.sent, replaced=old.replaced)

    def judge(
        self, doubt: float, without: float, reversed: float, applied: Array, disturbance: Array, state: Array,
        elapsed: float,
    ) -> LoopState:  # fmt: skip
        """The level from an estimate. doubt, without, reversed: of the estimator, NaN where it says nothing. applied
        (m,): inputs that acted, NaN where that is not known. disturbance (m,), of these, in place: what the controller
        has to take into account; see :func:`.guarding.report`. state (n,). elapsed: since the last estimate [s].
        """
        acted, disturbances = applied.tolist(), disturbance.tolist()
        guarding.report(self.memory, acted, disturbances)
        disturbance[:] = disturbances
        given = acted, state.tolist(), elapsed
        return LoopState(guarding.judge(self.memory, doubt, without, reversed, *given))

    def turned(self, inputs: Array) -> Array:
        """See :func:`.commanding.turn`."""
        found = inputs.tolist()
        commanding.turn(self.memory, found)
        return np.array(found)

    def lead_from(self, outputs: Array) -> None:
        """Lead the reference on from here (p,)."""
        lead_from(self.memory.governor[0], self.memory.outputs, outputs.tolist())

    def come_back(self, outputs: Array) -> None:
        """See :func:`.governor.come_back`."""
        come_back(self.memory.governor[0], self.memory.outputs, outputs.tolist())

    def rest_of(self, controller: Controller, state: Array, rest: Array) -> Array:
        """Inputs (m,) while the loop rests: ``rest``, or those of the stabiliser below the controller for a state (n,),
        without which an unstable rig diverges.
        """
        if not isinstance(controller, Cascade) or not np.isfinite(state).all() or not self.may_stabilise:
            return rest
        inputs = controller.held(state).tolist()
        commanding.put_on_trial(self.memory, inputs)
        return np.array(inputs)

    @property
    def may_stabilise(self) -> bool:
        """See :func:`.guarding.may_stabilise`."""
        return guarding.may_stabilise(self.memory)

    @property
    def level(self) -> LoopState:
        """What the evidence asks for, whether the guard acts or not."""
        return LoopState(self.memory.failsafe[0].level)

    @property
    def evidence(self) -> dict[str, float]:
        """Evidence of each kind, as a multiple of its threshold."""
        return {name: item.value for name, item in zip(REASONS, self.memory.kinds, strict=True)}

    @property
    def suspicion(self) -> float:
        """The largest of all [s]."""
        return max(item.seconds for item in self.memory.kinds)

    @property
    def reason(self) -> str:
        """Why the level is what it is, in words, "" where it is driving."""
        return (*CAUSES, "")[self.memory.core[0].cause]  # the last one is NOTHING

    @property
    def doubts(self) -> tuple[int, str]:
        """How many estimates have left a level above driving, and why the last one did, in words."""
        core = self.memory.core[0]
        return core.doubted, (*CAUSES, "")[core.found]

    @property
    def is_free(self) -> bool:
        """Whether references pass as they are."""
        return self.memory.governor[0].free

    def reference(
        self, level: LoopState, now: Array, found: Array, preview: Array, times: Array, elapsed: float
    ) -> Array:
        """The preview (points, p) that the controller gets, for one at ``times`` (points,) [s] from now on. now (p,):
        the reference at this moment. found (p,): where the rig is, NaN where that is unknown.
        """
        if level is LoopState.DRIVING and self.is_free:
            return preview
        governed = preview.ravel().tolist()
        commanding.govern(self.memory, level, now.tolist(), found.tolist(), governed, times.tolist(), elapsed)
        return np.array(governed).reshape(preview.shape)

    @property
    def slows(self) -> bool:
        """Whether inputs must stay near rest, now or still."""
        return self.memory.core[0].share < 1.0 or self.memory.core[0].tried < 1.0

    def slowed(self, inputs: Array, rest: Array) -> Array:
        """A command (m,) that stays as near to the inputs at rest (m,) as it must."""
        found = inputs.tolist()
        commanding.slow(self.memory, found, rest.tolist())
        return np.array(found)

    def followed(self, inputs: Array, before: Array, elapsed: float) -> Array:
        """What the actuators can follow of a command (m,), ``elapsed`` [s] after another one (m,), and make up for."""
        found = inputs.tolist()
        commanding.make_up(self.memory, found)
        commanding.limit_rates(self.memory, found, before.tolist(), elapsed)
        return np.array(found)

    def commanded(self, inputs: Array) -> None:
        """Remember a command (m,) that was sent."""
        commanding.remember(self.memory, inputs.tolist())
