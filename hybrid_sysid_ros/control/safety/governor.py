"""Reference governor: leads a reference from where the rig is to where it should be, at a stated rate."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.support.arrays import Array


class ReferenceGovernor:
    """g+ = clip(r, g - rate dt, g + rate dt); the preview is clip(r(t), g - rate t, g + rate t), t from now on.

    Free, it lets references pass as they are. It is no longer free from :meth:`begin` on, until it has met the
    reference. Source of the idea: Garone, Di Cairano, Kolmanovsky (2017), Reference and command governors, Automatica.
    """

    def __init__(self, outputs: int) -> None:
        self.free = True
        self.reference: Array = np.zeros(outputs)
        """g (outputs,)."""

    def begin(self, outputs: Array) -> None:
        """Lead the reference on from here (outputs,)."""
        self.free = False
        self.reference[:] = outputs

    def release(self) -> None:
        """Let references pass again."""
        self.free = True

    def follow(self, now: Array, preview: Array, times: Array, rate: Array, elapsed: float, *, keep: bool) -> Array:
        """The governed preview (points, outputs).

        now: the reference at this moment (outputs,). preview: at ``times`` (points,) [s] from now. rate (outputs,): by
        which it may move [output unit/s]. keep: it goes on to govern where it has met the reference.
        """
        if self.free:
            return preview
        reach = rate * elapsed
        g = self.reference[:] = np.clip(now, self.reference - reach, self.reference + reach)
        self.free = not keep and bool((g == now).all())
        reach = times[:, None] * rate
        return np.clip(preview, g - reach, g + reach)
