"""Operation: what users have asked a control loop to do, and whether it may move at all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from enum import Enum

from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.support.errors import UserError


class ControllerMode(Enum):
    """What the services have asked for last."""

    DRIVE = "drive"
    HOLD = "hold"
    STOP = "stop"


class Operation:
    """ControllerMode, arming and the emergency stop, which stays until it is reset, and needs arming after that.

    reason: why the loop may not move, "" where it may. stops: how often one was asked for. reached, times: the state in
    which the loop is, and how often it came to each. tell: receives "at rest: WHY" and "may move: HOW", for the
    operator, and for whoever starts the controller again: one that died at rest stays there, and one that died holding,
    which has no place to hold any more, comes to rest.
    """

    def __init__(self, *, armed: bool, tell: Callable[[str], object] = str) -> None:
        self.armed, self.emergency = armed, False
        self.reason, self.stops = "" if armed else "not armed yet", 0
        self._tell = tell
        self.begin()
        if not armed:
            self._say("at rest")

    def begin(self) -> None:
        """Drive, where the loop is armed, and count anew."""
        self.mode, self.times = ControllerMode.DRIVE, Counter[LoopState]()
        self.reached = self.state(LoopState.DRIVING)

    def become(self, state: LoopState) -> None:
        """Count a change of state."""
        if state is not self.reached:
            self.reached = state
            self.times[state] += 1

    def turn_to(self, mode: ControllerMode) -> None:
        """Take another mode. Raises UserError where the loop is not armed and would have to move, and where a stopped
        one would have to hold: only :attr:`ControllerMode.DRIVE` ends a stop.
        """
        if mode is not ControllerMode.STOP and not self.armed:
            raise UserError(f"the loop is disarmed ({self.reason}): {self._way_back}")
        if mode is ControllerMode.HOLD and self.mode is ControllerMode.STOP:
            raise UserError("the loop is stopped, which a hold would end: call the service enable")
        self.mode, self.stops = mode, self.stops + (mode is ControllerMode.STOP)
        self._say("may move" if mode is ControllerMode.DRIVE else "at rest")

    def _say(self, which: str) -> None:
        self._tell(f"{which}: {self.words or 'the loop drives'}")

    @property
    def _way_back(self) -> str:
        return "call the services reset and arm" if self.emergency else "call the service arm"

    def arm(self, unready: Sequence[str]) -> None:
        """Let the loop move. unready: which checks fail, and why. Raises UserError where one fails, and after an
        emergency stop that has not been reset.
        """
        if self.emergency:
            raise UserError(f"{self.reason} is latched: call the service reset before")
        if unready:
            raise UserError(f"not ready to be armed: {'; '.join(unready)}")
        self.armed, self.mode, self.reason = True, ControllerMode.DRIVE, ""
        self._say("may move")

    def disarm(self) -> None:
        """Let the loop come to rest and stay there until it is armed."""
        self.armed = False
        self.reason = self.reason or "by the service disarm"
        self._say("at rest")

    def emergency_stop(self, why: str) -> None:
        """Rest at once, and stay there until it is reset and armed."""
        if not self.emergency:
            self.armed, self.emergency, self.reason = False, True, f"emergency stop by {why}"
            self._say("at rest")

    def reset(self) -> None:
        """Unlatch the emergency stop; the loop stays disarmed."""
        if self.emergency:
            self.emergency = False
            self._say("at rest")

    def state(self, level: LoopState) -> LoopState:
        """What the loop does where its failsafe allows a level."""
        if not self.armed:
            return LoopState.DISARMED
        if self.mode is ControllerMode.STOP:
            return LoopState.STOPPED
        return max(level, LoopState.HOLDING) if self.mode is ControllerMode.HOLD else level

    @property
    def words(self) -> str:
        """What to do to go on, "" where the loop drives."""
        if not self.armed:
            return f"disarmed ({self.reason}): {self._way_back}"
        if self.mode is ControllerMode.DRIVE:
            return ""
        state = "stopped" if self.mode is ControllerMode.STOP else "holding the outputs"
        return f"{state} until the service enable is called"
