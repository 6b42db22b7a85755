"""A record: the measurements of one experiment on one uniform time grid."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.support.errors import UserError, shown

UNIFORMITY = 1e-6  # largest deviation from the uniform grid, in sampling times


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Input and output of one experiment.

    name: its name in tables and reports (the bag's name).
    time: (samples,) s, uniform, starts at 0.
    input: (samples, inputs), in the drive's unit; input[k] holds over [time[k], time[k+1]) (its mean there).
    output: (samples, outputs), SI units, measured at time[k].
    channels: further signals by name, each (samples,), measured at time[k]; NaN where unknown.
    measured: which samples were measured, (samples,), the others being filled in; None for all.
    source: its path; digest: SHA-256 of the content there. rig: name of its rig, where that is known.

    Raises UserError, naming record and sample, when shapes disagree, time is not uniform or input or output not finite.
    """

    name: str
    time: NDArray[np.float64]
    input: NDArray[np.float64]
    output: NDArray[np.float64]
    channels: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    measured: NDArray[np.bool_] | None = None
    source: str = ""
    digest: str = ""
    rig: str = ""

    def __post_init__(self) -> None:
        for key in ("time", "input", "output"):
            object.__setattr__(self, key, self._numbers(key, getattr(self, key)))
        if not isinstance(self.channels, Mapping):
            raise UserError(f"record {self.name}: channels is {shown(self.channels)}; give a mapping of arrays by name")
        channels = {key: self._numbers(f"channel {key}", value) for key, value in self.channels.items()}
        object.__setattr__(self, "channels", channels)
        self._check_shapes()
        self._check_time()
        for key in ("input", "output"):
            self._check_finite(key)

    def __repr__(self) -> str:
        of, columns = f" of {self.rig}" if self.rig else "", (self.input.shape[1], self.output.shape[1])
        return (
            f"Record({self.name}{of}: {self.duration:g} s, {self.samples} samples, "
            f"{columns[0]} input{'s' * (columns[0] > 1)}, {columns[1]} output{'s' * (columns[1] > 1)})"
        )

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)

    @property
    def sampling_time(self) -> float:
        """Time between two samples [s]."""
        return float(self.time[-1] / (self.samples - 1))

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1])

    @property
    def fingerprint(self) -> str:
        """Digest of the samples of time, input and output, since one bag can be read by other signals, or in part."""
        digest = hashlib.sha256()
        for array in (self.time, self.input, self.output):
            digest.update(array.tobytes())
        return digest.hexdigest()[:16]

    def part(self, start: float, stop: float, *, every: int = 1) -> Record:
        """The samples from fraction `start` to fraction `stop` of the record (0 to 1); its time starts at 0 again.

        Parts that share a limit share no sample: part(0, .5) and part(.5, 1) together are the whole record. Cuts are at
        multiples of `every` samples.

        Raises UserError where the fractions are not 0 <= start < stop <= 1, or fewer than two samples are left.
        """
        if (
            not all(isinstance(end, int | float | np.integer | np.floating) for end in (start, stop))
            or not 0 <= start < stop <= 1
        ):
            given = f"{shown(start)} to {shown(stop)}"
            raise UserError(f"record {self.name}: a part needs two numbers 0 <= start < stop <= 1, not {given}")
        if not isinstance(every, int | np.integer) or every < 1:
            raise UserError(f"record {self.name}: every is {shown(every)}; give a whole number from 1 on")
        chosen = slice(self.cut(start, every), self.cut(stop, every))
        if chosen.stop - chosen.start < 2:
            raise UserError(f"record {self.name}: no samples from {start:g} to {stop:g} of {self.samples} samples")
        return self.between(chosen.start, chosen.stop)

    def between(self, first: int, stop: int) -> Record:
        """The samples from `first` up to but without `stop`, at least two. Time starts at 0 again."""
        chosen = slice(first, stop)
        changes: dict[str, Any] = {
            "time": self.time[: stop - first],
            "input": self.input[chosen],
            "output": self.output[chosen],
            "channels": {key: value[chosen] for key, value in self.channels.items()},
            "measured": None if self.measured is None or self.measured[chosen].all() else self.measured[chosen],
        }
        return replace(self, **changes)

    def cut(self, fraction: float, every: int = 1) -> int:
        """The sample at a fraction of the record, a multiple of `every`, or the number of samples for 1."""
        return self.samples if fraction == 1.0 else every * round(fraction * self.samples / every)

    def _numbers(self, key: str, value: object) -> NDArray[np.float64]:
        try:
            return np.ascontiguousarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise UserError(f"record {self.name}: {key} is {shown(value)}; give an array of numbers") from error

    def _check_shapes(self) -> None:
        if self.time.ndim != 1 or len(self.time) < 2:
            raise UserError(f"record {self.name}: time has shape {self.time.shape}: it needs (samples,), 2 or more")
        for key in ("input", "output"):
            shape = getattr(self, key).shape
            if len(shape) != 2 or shape[0] != self.samples or shape[1] < 1:
                raise UserError(f"record {self.name}: {key} has shape {shape}: it needs ({self.samples}, {key}s)")
        named: dict[str, NDArray[Any]] = {f"channel {key}": value for key, value in self.channels.items()}
        if self.measured is not None:
            named["measured"] = self.measured
        for key, value in named.items():
            if np.shape(value) != (self.samples,):
                raise UserError(f"record {self.name}: {key} has shape {np.shape(value)}, not ({self.samples},)")

    def _check_time(self) -> None:
        if not np.isfinite(self.time).all():
            raise UserError(f"record {self.name}: time is not finite at sample {_first(~np.isfinite(self.time))}")
        step = self.time[-1] / (self.samples - 1)
        if self.time[0] != 0.0 or step <= 0.0:
            raise UserError(
                f"record {self.name}: time must start at 0 and rise: {self.time[0]:g} to {self.time[-1]:g} s"
            )
        deviation = np.abs(self.time - step * np.arange(self.samples)) > UNIFORMITY * step
        if deviation.any():
            k = _first(deviation)
            raise UserError(
                f"record {self.name}: time is not uniform at sample {k} ({self.time[k]:g} s, step {step:g} s)"
            )

    def _check_finite(self, key: str) -> None:
        wrong = ~np.isfinite(getattr(self, key)).all(axis=1)
        if wrong.any():
            k = _first(wrong)
            raise UserError(f"record {self.name}: {key} is not finite at sample {k} ({self.time[k]:g} s)")


def _first(mask: NDArray[np.bool_]) -> int:
    return int(np.argmax(mask))
