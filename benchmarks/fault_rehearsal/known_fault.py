"""Known fault: what a loop sends and reads that knows a fault from its first sample on. No loop can know more, so what
such a loop loses says how much a failsafe can be asked for.
"""

from __future__ import annotations

import numpy as np

from benchmarks.fault_rehearsal.signal_faults import Acting, Fault, Moment
from hybrid_sysid_ros.support.arrays import Array

GRID = 33
"""Commands of each input that are tried, from its lowest to its highest, beside those of GAINS."""
GAINS = (1.0, -1.0, 0.5, 2.0, 4.0)
"""Multiples of the wanted input that are tried as commands."""


class KnownActuators:
    """Commands whose effects are those wanted, as near as a fault lets them be; inputs that act alike make up for the
    rest. It replays what the fault remembers.

    sent: commands since the fault began.
    """

    def __init__(self, fault: Fault, limits: tuple[Array, Array], alike: Array) -> None:
        """limits: lowest and highest inputs (m,). alike (m, m): of a guard's settings."""
        self.fault, self.alike = fault, alike
        self.low, self.high = limits
        self._random = np.random.default_rng(0)
        self.sent: list[tuple[Moment, Array]] = []

    def command(self, moment: Moment, wanted: Array) -> Array:
        """(m,)."""
        found = wanted.copy()
        acted = self._acted(moment, found)
        off = ~np.isclose(acted, wanted, rtol=0.0, atol=1e-3 * (self.high - self.low))
        for j in np.flatnonzero(off):
            tried = np.append(np.linspace(self.low[j], self.high[j], GRID), np.multiply(GAINS, wanted[j]))
            acts = [self._acted(moment, np.where(np.arange(len(found)) == j, u, found))[j] for u in tried]
            found[j] = tried[np.argmin(np.abs(np.array(acts) - wanted[j]))]
        lacks = np.where(off, wanted - self._acted(moment, found), 0.0)
        found = np.clip(np.where(off, found, found + self.alike @ lacks), self.low, self.high)
        self.sent.append((moment, found))
        return found

    def _acted(self, moment: Moment, inputs: Array) -> Array:
        """What acts of inputs (m,) that are sent now."""
        assert self.fault.acts is not None
        acts: Acting = self.fault.acts()
        acted = inputs
        for then, sent in (*self.sent, (moment, inputs)):
            acted = acts(Moment(then.since, then.number, self._random), sent.copy())
        return np.clip(acted, self.low, self.high)


def sound_readings(true: Array, shown: Array) -> Array:
    """Readings (p,) without those that a fault has changed."""
    return np.where(shown == true, true, np.nan)
