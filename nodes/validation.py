"""Message validation: each message is checked here, once, before a node uses it, and counted by reason where not."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from enum import Enum
from operator import le
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.nodes.cdr import JointForm, TrajectoryForm
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates, TrajectoryMessage, point_lists
from hybrid_sysid_ros.nodes.signal_layout import Slots
from hybrid_sysid_ros.nodes.timing import SET

LARGEST = 1 << 17
"""Bytes of a message: a preview of some 2000 points. A larger message is dropped before it is unpacked."""
FORMS = 8
"""Number of message forms that are remembered at a time, such as those of a sensor and of a camera."""
RESTART = SECOND
"""A stamp this far before the last one begins a new experiment, or is a fault [ns]."""


class Reason(Enum):
    """Why a message, or some of its numbers, are rejected."""

    TOO_LARGE = "too large"
    UNREADABLE = "unreadable"
    MALFORMED = "lists of other lengths than the names"
    NO_ORDER = "times that do not rise"
    UNNAMED = "names missing"
    UNRELATED = "of other joints"
    NO_NUMBER = "not a number"
    OUT_OF_RANGE = "out of range"
    AHEAD = "stamp ahead of the clock"
    LONG_PAST = "stamp long past"
    BACKWARDS = "stamp before the last one"
    OTHER = "from another publisher"


class StampOrder(Enum):
    """How a stamp follows the last one."""

    NEW = "new"
    DUPLICATE = "duplicate"
    LATE = "late"
    """It lies before the last one, by less than RESTART."""
    RESTART = "restart"
    """It lies before the last one because time has begun anew."""


class MessageValidator:
    """Checks the messages of one topic of a node and selects its publisher.

    A stamp is accepted if it lies at most ``ahead`` ahead of the clock and ``behind`` behind it [ns], and less than
    RESTART before the last accepted one. Time begins anew if the clock itself went back, by SET or more, and the stamps
    are near it again; without a clock, as in lockstep, at the very stamp at which it began, or if two messages in a row
    follow or repeat each other RESTART before the last one.
    The first publisher, as frame_id names it, is the selected one until it has been silent for ``silence`` [ns] of
    steady time.
    """

    def __init__(
        self,
        kind: type[Any],
        *,
        clock: Callable[[], int] | None = None,
        steady: Callable[[], int],
        ahead: float = math.inf,
        behind: float = math.inf,
        silence: float = 0.0,
        largest: int = LARGEST,
    ) -> None:
        """kind: type of the messages. largest: bytes of a message. clock: the one of the stamps [ns], if there is one.
        steady: a clock for silences [ns].
        """
        self.dropped: Counter[Reason] = Counter()
        self.stamp = 0
        """The newest accepted stamp [ns], 0 before the first."""
        self.heard = 0
        """When a message was accepted last, in steady time [ns]; 0 before the first."""
        self.source: str | None = None
        """frame_id of the selected publisher."""
        self._kind = kind
        self._largest = largest
        self._clock = clock
        self._steady = steady
        self._ahead, self._behind, self._silence = ahead, behind, silence
        self._first = self._back = self._offset = 0
        self._forms: dict[int, JointForm | TrajectoryForm] = {}

    def drop(self, reason: Reason) -> None:
        """Count a message that is rejected."""
        self.dropped[reason] += 1

    def unpack(self, data: bytes) -> Any | None:
        """Return the message in the bytes: Joints or a Trajectory, with a number for each name or none, or another
        kind; None if the bytes are no message of the kind.
        """
        form = self._forms.get(len(data))  # most messages are like one before
        if form is not None and (said := form.unpack(data)) is not None:
            return said
        if len(data) > self._largest:
            self.drop(Reason.TOO_LARGE)
            return None
        try:
            message = deserialize_message(data, self._kind)
        except Exception:  # whatever the middleware raises for bytes that are no message
            self.drop(Reason.UNREADABLE)
            return None
        if isinstance(message, JointState):
            return self._joints(message, len(data))
        return self._trajectory(message, len(data)) if isinstance(message, JointTrajectory) else message

    def _joints(self, message: JointState, size: int) -> JointStates | None:
        joints = JointStates.of(message)
        if not _fit(joints.names, joints.lists):
            self.drop(Reason.MALFORMED)
            return None
        self._keep(size, JointForm(joints.source, joints.names, [len(numbers) for numbers in joints.lists]))
        return joints

    def _trajectory(self, message: JointTrajectory, size: int) -> TrajectoryMessage | None:
        names, points = message.joint_names, message.points
        if not _fit(names, [values for point in points for values in point_lists(point)]):
            self.drop(Reason.MALFORMED)
            return None
        trajectory = TrajectoryMessage.of(message)
        counts = {tuple(map(len, (*point_lists(point), point.accelerations))) for point in points}
        if len(counts) == 1 and not (found := counts.pop())[-1]:
            self._keep(size, TrajectoryForm(trajectory.source, names, found[:-1], len(points)))
        return trajectory

    def _keep(self, size: int, form: JointForm | TrajectoryForm) -> None:
        """Remember the form of a message by its size, for the next ones."""
        if len(self._forms) >= FORMS:
            self._forms.clear()
        self._forms[size] = form

    def read(self, joints: JointStates, slots: Slots, *, optional: int = 0) -> list[float] | None:
        """Return a message's numbers, NaN where one is missing or beyond the bounds of its slot; None if the message
        names none of the slots' entries. What is missing or wrong is counted once a message. optional: how many of the
        last numbers may be NaN, which is to say unknown.
        """
        values = slots.read(joints.names, joints.lists)
        if all(map(le, slots.low, values)) and all(map(le, values, slots.high)):
            return values
        if not slots.named:
            self.drop(Reason.UNRELATED)
            return None
        needed = len(values) - optional
        wrong = [k for k, value in enumerate(values) if not slots.low[k] <= value <= slots.high[k]]
        wrong = [k for k in wrong if k < needed or not math.isnan(values[k])]
        if not wrong:
            return values
        if slots.named < len(slots):
            self.drop(Reason.UNNAMED)
        else:
            self.drop(Reason.NO_NUMBER if math.isnan(values[wrong[0]]) else Reason.OUT_OF_RANGE)
        for k in wrong:
            values[k] = math.nan
        return values

    def admit(self, joints: JointStates) -> StampOrder | None:
        """Return how a message follows the last one; None if its publisher or its stamp is not accepted."""
        found = self._order(joints.stamp) if self.accepts_source(joints.source) else None
        if found is not None:
            self.select_source(joints.source)
        return found

    def accepts_source(self, source: str) -> bool:
        """Whether a publisher, by its frame_id, is the selected one or may become it; else its message is counted."""
        if source != self.source and self.heard and self._steady() - self.heard < self._silence:
            self.drop(Reason.OTHER)
            return False
        return True

    def select_source(self, source: str) -> None:
        """Select a publisher: from here on only its messages are accepted."""
        self.source, self.heard = source, self._steady()

    def accepts_start(self, stamp: int) -> bool:
        """Whether a trajectory may begin at a stamp [ns], by the rules above; 0: when it comes. Else it is counted.
        Without a clock it may begin at any.
        """
        return not stamp or self._clock is None or self._order(stamp) is not None

    def is_near(self, stamp: int) -> bool:
        """Whether a stamp [ns] is near the clock, if there is one."""
        if self._clock is None:
            return True
        now = self._clock()
        return now - self._behind <= stamp <= now + self._ahead

    def _order(self, stamp: int) -> StampOrder | None:
        now = self._clock() if self._clock is not None else None
        if now is not None and not now - self._behind <= stamp <= now + self._ahead:
            self.drop(Reason.AHEAD if stamp > now else Reason.LONG_PAST)
            return None
        found = StampOrder.NEW
        if self.stamp and stamp <= self.stamp:
            found = StampOrder.DUPLICATE if stamp == self.stamp else StampOrder.LATE
            if stamp < self.stamp - RESTART:
                if not self._begins_anew(stamp, near=now is not None and math.isfinite(self._behind)):
                    self.drop(Reason.BACKWARDS)
                    return None
                found = StampOrder.RESTART
            elif now is not None and self._was_set_back(self.stamp - stamp, now):
                found = StampOrder.RESTART
        if found is not StampOrder.LATE:
            if not self.stamp or found is StampOrder.RESTART:
                self._first = stamp
            self.stamp, self._back = stamp, 0
            self._offset = 0 if now is None else now - self._steady()
        return found

    def _was_set_back(self, back: int, now: int) -> bool:
        """Whether a stamp is so far before the last one [ns] because the clock, whose time is now, was set."""
        return back > SET and self._offset - (now - self._steady()) > back - SET

    def _begins_anew(self, stamp: int, *, near: bool) -> bool:
        """Whether a stamp long before the last one begins anew and is no fault; near: the stamp is near the clock."""
        before, self._back = self._back, stamp
        return near or stamp == self._first or 0 < before <= stamp < before + RESTART

    def forget(self) -> None:
        """Wait for a first message again; what was counted stays."""
        self.stamp = self.heard = self._back = 0
        self.source = None


def _fit(names: Sequence[str], lists: Iterable[Sequence[float]]) -> bool:
    """Whether names are there once, and each list has a number for each or none."""
    return len(set(names)) == len(names) and all(len(values) in (0, len(names)) for values in lists)
