"""Changes: sign, scale, delay, noise or zero of a signal that are others in a part of the record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hybrid_sysid_ros.extensions.record_check.alignment import CLEAR, SHARE, SHORTEST_LAG, Alignment, best_alignment
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal, noise_rms
from hybrid_sysid_ros.support.arrays import Array

PIECES, FEWEST = 12, 40
"""Pieces of a record that are compared, and fewest samples of each."""
LAWFUL, CERTAIN = 0.8, 0.95
"""Correlation of most pieces with the rig's physics from which another scale or delay is not the law's own fault, and
the same of a guessed law.
"""
OTHER_SCALE, OTHER_NOISE, OTHER_ZERO = 1.35, 2.5, 0.01
"""Ratios from which a part of a record has another scale, or another noise, and share of the span from which it has
another zero.
"""
NEAR_SCALE, SHARP = 1.2, 0.95
"""The same where the parts follow the physics that sharply."""
ALIKE, BETTER = 0.2, 0.25
"""Scatter about two levels, in their distance, and squares about them, in those about a line, below which a part is
another one: friction scatters, and a clock that is fast makes a line.
"""
JUMP, MOST_JUMPS, LASTING = 4.0, 3, 0.6
"""Jump of a zero in the largest usual change, most of such jumps in a record, and share of a jump that lasts."""
OUTSTANDS = 4.0
"""Another zero, in the deviation from the physics within a piece, from which it is one."""
AROUND = 5
"""Samples before and after a jump that show whether it lasts."""
LEFT = 0.1
"""Squared error that a fault leaves once it is undone, in that before, where the law is a guess: an error of the law
stays.
"""


@dataclass(frozen=True, kw_only=True)
class OtherStretch:
    """Pieces from ``first`` up to ``stop`` whose level is another one than that of the rest."""

    first: int
    stop: int
    inside: float
    outside: float

    def rest(self) -> OtherStretch:
        """The pieces before or behind a stretch that lies at an end."""
        first, stop = (self.stop, PIECES) if self.first == 0 else (0, self.first)
        return OtherStretch(first=first, stop=stop, inside=self.outside, outside=self.inside)

    def beyond(self, away: Array, parts: Sequence[slice]) -> bool:
        """Whether the step is larger than what a signal (samples,) otherwise varies by within the pieces."""
        inner = [float(np.std(away[part])) for part in parts]
        return abs(self.inside - self.outside) > OUTSTANDS * float(np.median(inner))


def other_stretch(values: Array, least: float) -> OtherStretch | None:
    """The stretch whose level differs by ``least`` at least, and clearly; values (pieces,), NaN where unknown."""
    places = np.flatnonzero(np.isfinite(values))
    known, count = values[places], len(places)
    if count < PIECES // 2:
        return None
    best, found = np.inf, None
    for first in range(count):
        for stop in range(first + 2, count + 1):
            inside = np.arange(count)[first:stop]
            if 2 <= stop - first <= count - 2:
                levels = known[inside].mean(), np.delete(known, inside).mean()
                squares = float(np.var(known[inside]) * len(inside))
                squares += float(np.var(np.delete(known, inside)) * (count - len(inside)))
                if squares < best:
                    best = squares
                    found = OtherStretch(
                        first=int(places[first]), stop=int(places[stop - 1]) + 1, inside=levels[0], outside=levels[1]
                    )
    if found is None:
        return None
    step = abs(found.inside - found.outside)
    line = known - np.polyval(np.polyfit(places, known, 1), places)
    return found if step > least and best < min(count * (ALIKE * step) ** 2, BETTER * float(line @ line)) else None


def is_undone(measured: Array, expected: Array, spoilt: Array) -> bool:
    """Whether what is expected with a fault (samples,) is far nearer to what was measured than without."""
    before, after = (float(np.var(measured - values)) for values in (expected, spoilt))
    return after < LEFT * before


def later_by(values: Array, lag: float) -> Array:
    """A signal (samples,) that is late by ``lag`` samples."""
    at = np.arange(len(values), dtype=np.float64)
    return np.interp(at - lag, at, values)


def changes_of(
    signal: CheckedSignal, expected: Array, inputs: Sequence[Array], apart: int, *, guessed: bool
) -> Iterator[RecordFinding]:
    """What changes along a record; expected: by the rig's physics, (samples,); apart: samples in which it changes;
    guessed: whether that law is a guess, whose own errors change along a record, too.
    """
    length = len(expected) // PIECES
    if length < max(FEWEST, 4 * apart):
        return
    compared = _Comparison(signal=signal, expected=expected, apart=apart, length=length, guessed=guessed)
    if turned := list(compared.changes_of_sign()):
        yield from turned
        return
    scales = compared.other_scale()
    lags = None if signal.rough else compared.other_delay()  # noise moves the lag at which a piece fits best
    if scales is not None:
        ratio = float(np.exp(scales.inside - scales.outside))
        yield RecordFinding(
            kind="change of scale", cost=0.79,
            words=f"{signal.name} moves {ratio:.3g} times as far as elsewhere {compared.where(scales)}",
            cure="was its unit, range or gain changed there? leave that part out (--part), or import the parts apart",
        )  # fmt: skip
    if lags is not None:
        late = (lags.inside - lags.outside) * signal.period
        way = "later" if late > 0.0 else "earlier"
        yield RecordFinding(
            kind="change of delay", cost=0.77,
            words=f"{signal.name} is {abs(late):.3g} s {way} than elsewhere {compared.where(lags)}",
            cure="samples were lost or a clock was set there: import the parts before and behind apart",
        )  # fmt: skip
    if scales is None and lags is None:
        jumps = list(_jumps(signal, expected, inputs))
        yield from jumps or compared.changes_of_zero()
    if scales is None:
        yield from compared.changes_of_noise()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Comparison:
    """A signal beside what physics expects of it, in pieces of so many samples."""

    signal: CheckedSignal
    expected: Array
    apart: int
    length: int
    guessed: bool

    @cached_property
    def parts(self) -> list[slice]:
        return [slice(k * self.length, (k + 1) * self.length) for k in range(PIECES)]

    @cached_property
    def pieces(self) -> list[Alignment | None]:
        return [self._aligned(part) for part in self.parts]

    def _aligned(self, part: slice) -> Alignment | None:
        good = ~self.signal.spoilt[part]
        if np.ptp(self.expected[part]) == 0.0 or good.mean() < 0.5:
            return None
        return best_alignment(self.signal.values[part], self.expected[part], good, self.apart, self.length // 3)

    @property
    def certain(self) -> float:
        return CERTAIN if self.guessed else LAWFUL

    @cached_property
    def lawful(self) -> bool:
        """Whether most pieces follow the physics."""
        return float(np.median([piece.correlation if piece else 0.0 for piece in self.pieces])) > self.certain

    def following(self, least: float) -> list[Alignment | None]:
        """The pieces that follow the physics of a lawful record so closely."""
        return [piece if self.lawful and piece and piece.correlation > least else None for piece in self.pieces]

    def where(self, stretch: OtherStretch) -> str:
        """A stretch in times of the record."""
        first, last = self.signal.at(stretch.first * self.length), self.signal.at(stretch.stop * self.length)
        if stretch.stop == PIECES:
            return f"from about {first} on"
        return f"from about {first} to {last}" if stretch.first else f"until about {last}"

    def undone(self, stretch: OtherStretch, spoilt: Array) -> OtherStretch | None:
        """A stretch of a guessed law, if the fault that is in it explains it."""
        part = slice(stretch.first * self.length, stretch.stop * self.length)
        explained = not self.guessed or is_undone(self.signal.values[part], self.expected[part], spoilt[part])
        return stretch if explained else None

    def changes_of_sign(self) -> Iterator[RecordFinding]:
        """Pieces that go the other way."""
        sure = [piece if piece and abs(piece.correlation) > self.certain else None for piece in self.pieces]
        turned = [np.sign(piece.correlation) if piece else np.nan for piece in sure]
        signs = _later_stretch(turned, 1.0)
        if signs is not None and _at_once(self.pieces, turned, self.apart):
            yield RecordFinding(
                kind="change of sign", cost=0.96,
                words=f"{self.signal.name} goes the other way than elsewhere {self.where(signs)}",
                cure="was a plug or a sensor turned round there? import the parts apart, one with sign: -1 in "
                "import.yaml",
            )  # fmt: skip

    def other_scale(self) -> OtherStretch | None:
        """Where logarithms of the scale are others."""
        found = None
        for least, sure in ((OTHER_SCALE, CLEAR), (NEAR_SCALE, SHARP)):
            sharp = [np.log(piece.scale) if piece else np.nan for piece in self.following(sure)]
            found = found or _later_stretch(sharp, float(np.log(least)))
        return found and self.undone(found, np.exp(found.inside - found.outside) * self.expected)

    def other_delay(self) -> OtherStretch | None:
        """Where delays are others [samples]."""
        lags = [piece.lag if piece else np.nan for piece in self.following(CLEAR)]
        found = _later_stretch(lags, max(SHORTEST_LAG, SHARE * self.apart))
        return found and self.undone(found, later_by(self.expected, found.inside - found.outside))

    def changes_of_zero(self) -> Iterator[RecordFinding]:
        """A zero that is another one."""
        away = self.signal.values - self.expected
        medians = [float(np.median(away[part])) for part in self.parts]
        zeros = _later_stretch(medians, OTHER_ZERO * self.signal.span) if self.lawful else None
        if zeros is not None and zeros.beyond(away, self.parts):
            step = self.signal.shown(zeros.inside - zeros.outside)
            yield RecordFinding(
                kind="jump", cost=0.6,
                words=f"{self.signal.name} is {step} above elsewhere {self.where(zeros)}",
                cure="was its zero set anew there? import the parts before and behind apart",
            )  # fmt: skip

    def changes_of_noise(self) -> Iterator[RecordFinding]:
        """Noise that is larger than elsewhere."""
        usual = max(float(np.hypot(self.signal.noise, self.signal.count)), 2e-3 * self.signal.span)
        sizes = [float(np.hypot(noise_rms(self.signal.values[part]), usual)) for part in self.parts]
        noises = other_stretch(np.log(sizes), float(np.log(OTHER_NOISE)))
        if noises is not None and noises.inside < noises.outside and (noises.first == 0 or noises.stop == PIECES):
            noises = noises.rest()
        if noises is not None and noises.inside > noises.outside:
            ratio = float(np.exp(noises.inside - noises.outside))
            yield RecordFinding(
                kind="change of noise", cost=0.6,
                words=f"{self.signal.name} has {ratio:.3g} times the noise of the rest {self.where(noises)}",
                cure="look for what was switched on then; leave that part out (--part)",
            )  # fmt: skip


def _later_stretch(values: Sequence[float], least: float) -> OtherStretch | None:
    """The other stretch, or what is behind it where it begins the record."""
    found = other_stretch(np.array(values), least)
    return found if found is None or found.first else found.rest()


def _at_once(pieces: Sequence[Alignment | None], signs: Sequence[float], apart: int) -> bool:
    """Whether pieces of either sign are as late: a swing that is half a period late looks turned round, too."""
    pairs = list(zip(pieces, signs, strict=True))
    ahead, back = ([piece.lag for piece, sign in pairs if piece and sign == way] for way in (1.0, -1.0))
    return abs(float(np.median(ahead) - np.median(back))) <= max(SHORTEST_LAG, apart)


def _jumps(signal: CheckedSignal, expected: Array, inputs: Sequence[Array]) -> Iterator[RecordFinding]:
    """A zero that jumps: changes far beyond the usual ones, that last, and that no input or physics makes."""
    y = signal.values
    away = np.abs(np.diff(y))
    least = max(JUMP * float(np.percentile(away, 99.5)), 8.0 * signal.noise, 4.0 * signal.count)
    places = [k for k in np.flatnonzero(away > least).tolist() if AROUND <= k < len(y) - AROUND - 1]
    kept = []
    for k in places:
        before, after = np.median(y[k - AROUND + 1 : k + 1]), np.median(y[k + 1 : k + 1 + AROUND])
        near = slice(max(k - AROUND, 0), k + AROUND)
        driven = any(
            np.abs(np.diff(u[near])).max() >= JUMP * max(np.median(np.abs(np.diff(u))), 1e-300) for u in inputs
        )
        lasts = abs(after - before) > LASTING * away[k] and not signal.spoilt[k - 1 : k + 3].any()
        if lasts and np.ptp(expected[near]) < 0.5 * away[k] and not driven:
            kept.append(k)
    if kept and len(places) <= MOST_JUMPS:
        yield RecordFinding(
            kind="jump", cost=0.72,
            words=f"{signal.name} jumps by {signal.shown(float(y[kept[0] + 1] - y[kept[0]]))} at "
            f"{signal.at(kept[0] + 1)}, and no input does",
            cure="was its zero set anew there, or did samples get lost? import the parts before and behind apart",
        )  # fmt: skip
