"""Samples: faults that one signal shows by itself, and the samples that they spoil."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.shared.sentinel import sentinel_of
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of, unit_of_wraps, wraps_of
from hybrid_sysid_ros.rigs.units import LARGEST
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import counted

MAINS = (50.0, 60.0)
"""Frequencies of the mains [Hz]."""
AROUND = 60
"""Lines of a spectrum on either side of the mains that give its floor; a record with fewer periods of the mains shows
none, since the signal's own power is near.
"""
LONGEST_HOLD = 200
"""Samples over which a signal may be held; a longer level is a step of the experiment."""
NEARBY = 50
"""Samples within which a spike stands out from what the signal does."""
STEP, SOON, RARE = 8.0, 12, 0.3
"""Change of an input, in its usual one, from which it is a step; samples within which an output rings from it; and
share of a record's samples, below which it is no chance that spikes are among them.
"""
AS_FAR, RINGING = 0.3, 12
"""Share of a spike that a sample on the other side has, and samples within which it has, where a resonance rings."""
FROZEN, FEW = 20, 0.01
"""Equal samples in a row of a sensor that froze, and least share of these; others are equal in at most that share."""


@dataclass(kw_only=True, eq=False)
class CheckedSignal:
    """One input or output of a record, and what its rig says of it."""

    name: str
    unit: str
    values: Array
    """(samples,)."""
    period: float
    """[s]."""
    is_input: bool
    limits: tuple[float, float] = (-np.inf, np.inf)
    """Where an actuator or a sensor ends."""
    noise: float = 0.0
    """Of the sensor, rms [unit]."""
    count: float = 0.0
    """Of its quantiser [unit]."""
    hum: float = 0.0
    """Of the mains that the rig declares, rms [unit]."""
    spoilt: NDArray[np.bool_] = field(init=False)
    """Samples that a fault spoils, (samples,)."""
    explained: bool = False
    """Whether a fault of the signal itself was found, of which a poor response would be a consequence."""
    rough: bool = False
    """Whether that is noise or quantisation, which weaken a relation, but leave it above chance."""

    def __post_init__(self) -> None:
        self.spoilt = np.zeros(len(self.values), dtype=bool)

    @property
    def span(self) -> float:
        return float(np.ptp(self.values))

    @property
    def usual_noise(self) -> float:
        """What the rig declares in all, rms."""
        return float(np.hypot(np.hypot(self.noise, self.count / np.sqrt(12.0)), self.hum))

    def at(self, sample: int) -> str:
        return f"sample {sample} ({sample * self.period:.4g} s)"

    def shown(self, value: float) -> str:
        """A value with its unit."""
        return f"{value:.4g} {'' if self.unit == '1' else self.unit}".rstrip()

    def resolution(self) -> float:
        """Least step between two values; 0 where they are not quantised."""
        steps = np.diff(np.unique(self.values))
        steps = steps[steps > 1e-9 * max(self.span, 1e-300)]
        if not len(steps):
            return 0.0
        least = float(np.percentile(steps, 2))
        whole = steps / least
        is_whole = np.mean(np.abs(whole - np.round(whole)) < 0.05) > 0.95
        return least if is_whole and len(steps) < 0.3 * len(self.values) else 0.0


def runs_of(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples and lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2] - edges[::2]


def sample_findings(signal: CheckedSignal, inputs: Sequence[Array] = ()) -> Iterator[RecordFinding]:
    """Faults of a signal by itself; they mark the samples that they spoil. inputs: (samples,) each, whose steps an
    output may answer at once.
    """
    if signal.span == 0.0:
        kind = "no excitation" if signal.is_input else "constant output"
        yield RecordFinding(
            kind=kind, cost=1.0, words=f"{signal.name} is {signal.shown(signal.values[0])} throughout",
            cure="name the right column, or " + ("drive the rig by it" if signal.is_input else "repair the sensor"),
        )  # fmt: skip
        return
    if beyond := list(_impossible(signal)) or list(_sentinel(signal)) or list(_wrapped(signal)):
        signal.explained = True
        yield from beyond
        return
    found = list(_clipped(signal)) + list(_held(signal))
    found += () if found else _frozen(signal)
    if not (signal.is_input or found):
        found += _spikes(signal, inputs)
        found += _hum(signal)
        found += _coarse(signal)
        found += () if found else _noise(signal)
    signal.explained = bool(found)
    signal.rough = bool(found) and all(item.kind in ("noise", "quantisation") for item in found)
    yield from found


def _impossible(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """Values that no rig reaches."""
    far = np.abs(signal.values) > LARGEST
    if far.any():
        worst = int(np.argmax(np.abs(signal.values)))
        yield RecordFinding(
            kind="impossible values", cost=0.98,
            words=f"{signal.name} has {counted(int(far.sum()), 'value')} that no rig reaches, such as "
            f"{signal.shown(signal.values[worst])} at {signal.at(worst)}",
            cure="bytes were read as another type, or a logger marks what is missing by such a number (guesses): make "
            "it an empty cell, or name another column",
        )  # fmt: skip


def _sentinel(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """A number that stands for missing values."""
    if (value := sentinel_of(signal.values)) is not None:
        is_it = signal.values == value
        signal.spoilt |= is_it
        yield RecordFinding(
            kind="sentinel value", cost=0.78,
            words=f"{signal.name} is {signal.shown(value)} in {counted(int(is_it.sum()), 'sample')}, far from all "
            f"others, the first at {signal.at(int(np.argmax(is_it)))}: so loggers mark what is missing (a guess)",
            cure="say missing: with that number, as its column has it, in import.yaml, and import the record anew",
        )  # fmt: skip


def _wrapped(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """An angle modulo a turn."""
    unit = unit_of_wraps(signal.values) if signal.unit in ("", "1") else signal.unit
    turn = turn_of(unit)
    if turn and len(places := wraps_of(signal.values, turn)):
        stated = "" if unit == signal.unit else f"make the rig anew with --unit {signal.name}={unit} (a guess), or "
        yield RecordFinding(
            kind="the angle wraps", cost=0.95,
            words=f"{signal.name} comes modulo a turn and jumps by one {counted(len(places), 'time')}, the first "
            f"behind {signal.at(int(places[0]))}",
            cure=f"{stated}say unwrap: true for its column in import.yaml, and import the record anew",
        )  # fmt: skip


def _clipped(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """Flat tops that the signal approaches in steps that are small beside them."""
    y, small = signal.values, 0.02 * signal.span
    usual = float(np.percentile(np.abs(np.diff(y)), 99)) + small
    for end, extreme in (("highest", y.max()), ("lowest", y.min())):
        first, length = runs_of(np.abs(y - extreme) <= 1e-6 * signal.span)
        flat = (length >= 4) & (first > 0)
        first, length = first[flat], length[flat]
        if len(first) < 3 or length.sum() < 0.004 * len(y):
            continue
        if signal.is_input and any(abs(extreme - limit) < 0.01 * signal.span for limit in signal.limits):
            continue  # an actuator's end is real
        approach = np.abs(y[first] - y[first - 1])
        if np.mean((approach < min(usual, 0.1 * signal.span)) & (approach > 0)) < 0.6:
            continue  # it jumps there: a level
        near = np.mean((np.abs(y - extreme) < 0.05 * signal.span) & (np.abs(y - extreme) > 1e-6 * signal.span))
        if length.sum() / len(y) < 1.5 * near and signal.resolution() > 0.0:
            continue  # a turning point of a coarse sensor
        signal.spoilt |= np.abs(y - extreme) <= 1e-6 * signal.span
        yield RecordFinding(
            kind="clipped", cost=min(0.79, 0.5 + 2.0 * length.sum() / len(y)),
            words=f"{signal.name} has {counted(len(first), 'flat top')} at its {end} value {signal.shown(extreme)}, "
            f"the first at {signal.at(int(first[0]))}, {length.sum() / len(y):.1%} of the samples",
            cure="enlarge the range of the converter or drive less; leave those parts out (--part)",
        )  # fmt: skip


def _held(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """A signal that changes at every k-th sample only, though it could change at each."""
    changes = np.flatnonzero(np.diff(signal.values)) + 1
    if len(changes) < 20:
        return
    for k in range(min(LONGEST_HOLD, int(np.median(np.diff(changes)))), 1, -1):
        regular = np.mean(np.bincount(changes % k, minlength=k).max() / len(changes))
        dense = len(changes) * k / (changes[-1] - changes[0] + 1)
        if regular > 0.95 and dense > 0.55:
            yield RecordFinding(
                kind="held", cost=0.6, samples=k if signal.is_input else 0, signal=signal.name,
                words=f"{signal.name} changes only every {k} samples, {1 / (k * signal.period):.4g} times a second",
                cure="record it at the rate of the others; if it was applied so, go on",
            )  # fmt: skip
            return


def _frozen(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """A sensor with noise, which never shows a value twice, that does so for long."""
    if signal.is_input:
        return
    y, same = signal.values, np.append(False, np.diff(signal.values) == 0.0)
    starts, lengths = runs_of(same)
    inside = (y[starts] < y.max()) & (y[starts] > y.min())
    long = inside & (lengths >= FROZEN)
    lost = float(lengths[long].sum()) / len(same)
    if lost < FEW or float(np.mean(same)) - lost > FEW:
        return
    for start, size in zip(starts[long].tolist(), lengths[long].tolist(), strict=True):
        signal.spoilt[start : start + size] = True
    first, seconds = int(starts[long][0]), float(lengths[long][0]) * signal.period
    yield RecordFinding(
        kind="frozen", cost=min(0.79, 0.55 + 0.5 * lost),
        words=f"{signal.name} stays at {signal.shown(y[first])} for {seconds:.3g} s from {signal.at(first)} on, "
        f"{lost:.1%} of the record, where it else never shows a value twice",
        cure="leave that part out (--part), and look for the sensor's cable or a full buffer",
    )  # fmt: skip


def _spikes(signal: CheckedSignal, inputs: Sequence[Array]) -> Iterator[RecordFinding]:
    """Samples far away from both neighbours, and far more than others are, unless each answers a step of an input."""
    y = signal.values
    away = np.abs(y - median_filter(y, 7, mode="nearest"))
    usual = float(np.percentile(away, 95))
    step = float(np.percentile(np.abs(np.diff(y)), 95))
    least = max(3.0 * step, 0.05 * _moves(y), 4.0 * max(signal.count, signal.resolution()))
    far = away > max(6.0 * usual, least, 8.0 * signal.noise)
    first, length = runs_of(far)
    back = np.abs(y[np.minimum(first + length, len(y) - 1)] - y[np.maximum(first - 1, 0)])
    first = first[(length <= 3) & (back < 0.5 * away[first])]
    first = first[[not _rings(y - median_filter(y, 7, mode="nearest"), k) for k in first.tolist()]]
    answers = any(_follow_steps(first, values) for values in inputs)
    if len(first) and not answers and far.mean() < 0.04:
        signal.spoilt |= far
        worst, same = int(np.argmax(away)), len(first) > 2 and np.ptp(y[far]) == 0.0
        marks = "if that one number marks what is missing (a guess), say missing: with it in import.yaml; or "
        yield RecordFinding(
            kind="spikes", cost=min(0.75, 0.4 + 20.0 * far.mean() + 0.1 * away[worst] / signal.span),
            words=f"{signal.name} has {counted(len(first), 'spike')}, the farthest to {signal.shown(y[worst])} at "
            f"{signal.at(worst)}",
            cure=f"{marks if same else ''}repair the wiring or the driver; leave those parts out (--part)",
        )  # fmt: skip


def _rings(away: Array, k: int) -> bool:
    """Whether a sample that is far away swings to the other side near by, as a resonance does."""
    near = away[max(k - RINGING, 0) : k + RINGING + 1]
    return bool((-np.sign(away[k]) * near > AS_FAR * abs(away[k])).any())


def _moves(values: Array) -> float:
    """How far a signal usually moves within NEARBY samples: what wanders has any span."""
    pieces = values[: len(values) // NEARBY * NEARBY].reshape(-1, NEARBY)
    return float(np.median(np.ptp(pieces, axis=1))) if len(pieces) else float(np.ptp(values))


def _follow_steps(samples: NDArray[np.intp], values: Array) -> bool:
    """Whether all samples come soon after a step of an input, farther than it usually moves, and few others do."""
    away = np.abs(np.diff(values))
    steps = np.flatnonzero(away > STEP * float(np.median(away)))
    since = np.arange(len(values)) - np.append(-SOON, steps)[np.searchsorted(steps, np.arange(len(values)))]
    soon = since < SOON
    return bool(soon[samples].all() and soon.mean() < RARE)


def _spectrum(signal: CheckedSignal) -> tuple[Array, Array]:
    """Frequencies [Hz] and amplitudes of the signal's differences."""
    y = np.diff(signal.values) * np.hanning(len(signal.values) - 1)
    return np.asarray(np.fft.rfftfreq(len(y), signal.period), dtype=np.float64), np.abs(np.fft.rfft(y))


def _hum(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """A sharp line of the mains, or its mirror image below half the sampling rate."""
    if signal.is_input:
        return
    rate = 1.0 / signal.period
    frequencies, size = _spectrum(signal)
    width = frequencies[1]
    for mains in (*MAINS, 100.0, 120.0):
        seen = abs((mains + rate / 2) % rate - rate / 2)
        if not (AROUND * width < seen < rate / 2 - 4 * width) or seen < 1.0:
            continue
        away = np.abs(frequencies - seen)
        near = away < 0.002 * mains + 3 * width
        around = (away < AROUND * width) & (away >= 0.002 * mains + 6 * width)
        if not around.any():
            continue
        line, floor = float(size[near].max()), float(np.median(size[around]))
        gain = 2.0 * np.sin(np.pi * seen / rate)
        amplitude = line * 4.0 / len(signal.values) / max(gain, 1e-9)
        rms = amplitude / np.sqrt(2.0)
        least = max(1.6 * signal.hum, 0.15 * signal.noise, 0.3 * signal.count, 2e-3 * signal.span)
        if line > 25.0 * floor and rms > least:
            alias = mains > rate / 2
            yield RecordFinding(
                kind="aliasing" if alias else "hum", cost=min(0.65, 0.3 + 2.0 * amplitude / signal.span),
                words=f"{signal.name} has a line of {signal.shown(amplitude)} at {seen:.4g} Hz, "
                + (f"the mirror image of {mains:g} Hz at {rate:.4g} samples/s" if alias else "that of the mains"),
                cure="put a low-pass before the converter, and sample faster" if alias else "shield the sensor's cable",
            )  # fmt: skip
            return


def noise_rms(values: Array) -> float:
    """Of white noise on a smooth signal, by the median of its third differences."""
    return float(np.median(np.abs(np.diff(values, 3)))) / 0.6745 / float(np.sqrt(20.0))


def _noise(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """Noise far above what the rig's sensor has."""
    if signal.is_input or not (signal.noise or signal.count):
        return
    rms = noise_rms(signal.values)
    usual = signal.usual_noise
    if rms > 2.5 * usual and rms > 2e-3 * signal.span:
        yield RecordFinding(
            kind="noise", cost=min(0.65, 0.3 + 3.0 * rms / signal.span),
            words=f"{signal.name} has noise of {signal.shown(rms)} rms, the rig's sensor {usual:.3g}",
            cure="look for a loose contact or a cable beside the drive's; or correct sensors in rig.yaml",
        )  # fmt: skip


def _coarse(signal: CheckedSignal) -> Iterator[RecordFinding]:
    """Steps between values that are larger than the rig's sensor has them."""
    step = signal.resolution()
    if signal.is_input or step <= max(1.5 * signal.count, 0.5 * signal.noise):
        return
    if step > 0.004 * signal.span:
        yield RecordFinding(
            kind="quantisation", cost=min(0.65, 0.3 + 5.0 * step / signal.span),
            words=f"{signal.name} comes in steps of {signal.shown(step)}, {signal.span / step:.0f} in all",
            cure="use more bits or a smaller range, and keep all digits when exporting",
        )  # fmt: skip
