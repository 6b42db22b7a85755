"""Response: how the outputs follow the inputs, beside what the rig's own physics make of the same inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import coherence, welch

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.alignment import (
    BEYOND,
    CLEAR,
    RELATED,
    SHARE,
    SHORTEST_LAG,
    Alignment,
    best_alignment,
    beyond_chance,
    changes,
    time_of_change,
)
from hybrid_sysid_ros.extensions.record_check.changes import CERTAIN, LEFT, changes_of, is_undone, later_by
from hybrid_sysid_ros.extensions.record_check.correction import is_turned, scale_finding, straightness_of_offsets
from hybrid_sysid_ros.extensions.record_check.expectation import expected_outputs, is_guessed
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.record_check.hysteresis import hysteresis_of
from hybrid_sysid_ros.extensions.record_check.relation import answers, is_early
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal, runs_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

PIECES = 8
"""Pieces of a record whose delays show a drift."""
LONGEST_LAG, CHANGES = 80, 8
"""Longest delay that is looked for, in samples and in times of a change: the longer one."""
SHORTEST_FROZEN = 8
"""Samples from which a sensor that stays where it is counts as frozen."""
COHERENT = 0.5
"""Coherence from which an output follows the inputs, whatever the rig's parameters are."""
DRIFTS, STRAIGHT = 0.04, 0.9
"""Rise of a sensor's drift, in the motion that is expected, and share of the error along its line, that show it."""
DOUBTFUL = 0.55
"""Cost of an output that hardly follows: a recorder that holds an input costs more, and is a cause of it."""
LESS = 0.5
"""Error that a play must leave, in that of the rig's physics, which may know of it; LEFT where these are a guess."""
FOLLOWED = 0.005
"""Squared error of the physics, in the output's variance, below which nothing is left for a play to explain."""
EXCHANGED = 0.25
"""Squared errors of two outputs that are left once they are exchanged, from which they are swapped."""


def response_findings(
    record: Record, rig: Rig, signals: Sequence[CheckedSignal], expected: Array
) -> Iterator[RecordFinding]:
    """Sign, delay and its change, scale, swapped channels, frozen sensors, and outputs that no input moves. expected:
    by the rig's physics, (samples, outputs).
    """
    inputs, outputs = ([item for item in signals if item.is_input is kind] for kind in (True, False))
    period, guessed = record.sampling_time, is_guessed(rig)
    if len(outputs) > 1 and (swap := _swapped(outputs, expected)):
        yield swap
        return
    if record.input.shape[1] == len(outputs) == 1 and (swap := _exchanged(record, rig, outputs[0], expected[:, 0])):
        yield swap
        return
    for k, signal in enumerate(outputs):
        if np.ptp(expected[:, k]) == 0.0 or signal.span == 0.0:
            continue
        if not signal.explained:
            yield from _frozen(signal, expected[:, k])
        apart = time_of_change(expected[:, k])
        longest = min(max(LONGEST_LAG, CHANGES * apart), record.samples // 6)
        parts = list(changes_of(signal, expected[:, k], record.input.T, apart, guessed=guessed))
        yield from parts
        if any(item.kind != "jump" for item in parts):
            continue
        found = best_alignment(signal.values, expected[:, k], ~signal.spoilt, apart, longest)
        if found.correlation < CERTAIN and is_turned(record, rig, k, expected[:, k]):
            yield _sign(signal, found)
            continue
        judged = list(_judged(record, signal, found, expected[:, k], apart, longest, rig))
        if found.correlation > CLEAR and not signal.explained and not rig.system.contacts:  # friction turns round alike
            delays = (rig.system.input_delays / period).tolist()
            less = LEFT if guessed else LESS
            if play := _hysteresis(inputs, delays, signal, expected[:, k], found.lag, less):
                judged = [item for item in judged if item.kind != "delay"] + [play]  # which a play looks like
        yield from (item for item in judged if not parts or item.kind == "no relation")


def _coherence(record: Record, output: Array) -> float:
    """Coherence of an output with the inputs, weighted by their power: the largest of all inputs."""
    length = int(np.clip(record.samples // 8, 16, 1024))
    found = [0.0]
    for values in record.input.T:
        if np.ptp(values) > 0.0:
            _, power = welch(np.diff(values), nperseg=length)
            _, shared = coherence(np.diff(values), np.diff(output), nperseg=length)
            found.append(float(np.nansum(shared * power) / max(power.sum(), 1e-300)))
    return max(found)


def _is_answered(record: Record, output: Array) -> bool:
    """Whether an output answers the inputs, whatever the rig's law says."""
    return _coherence(record, output) > COHERENT or answers(record.input, output)


def _judged(
    record: Record, signal: CheckedSignal, found: Alignment, expected: Array, apart: int, longest: int, rig: Rig
) -> Iterator[RecordFinding]:
    """What one output shows, once it has been aligned with what the physics make of the inputs."""
    good = ~signal.spoilt
    drift = _drift(signal, expected, good, apart, longest)
    if drift is not None and abs(drift) * len(good) > max(3.0, 0.15 * apart):
        yield RecordFinding(
            kind="clock drift", cost=min(0.79, 0.7 + 0.002 * abs(drift) * len(good)),
            words=f"{signal.name} gets {'later' if drift > 0.0 else 'earlier'} by {1e3 * abs(drift):.3g} ms a second: "
            f"two clocks, {abs(drift):.2%} apart",
            cure=f"say so in import.yaml: drift: {drift:.3g} of the output's column, or stamp both with one clock",
        )  # fmt: skip
        return
    ratio = float(np.std(changes(signal.values, apart)) / max(np.std(changes(expected, apart)), 1e-300))
    guessed, follows = is_guessed(rig), abs(found.correlation)
    if follows < CLEAR and ratio > BEYOND and not (signal.explained or guessed):
        yield RecordFinding(
            kind="scale", cost=0.78,
            words=f"{signal.name} moves {ratio:.3g} times as far as the rig's physics make of these inputs",
            cure="correct the scale or unit of the input or the sensor (import.yaml, --signals), or the rig's law, if "
            "it is a guess",
        )  # fmt: skip
        return
    if follows < CLEAR and signal.explained and not signal.rough:
        return
    answered = follows > CLEAR or _is_answered(record, signal.values)
    if signal.rough and follows < CLEAR and (answered or beyond_chance(signal.values, expected, good, apart, longest)):
        return  # noise or quantisation explains why it follows no better
    if answered and follows < (CLEAR if guessed else RELATED):
        yield RecordFinding(
            kind="another law", cost=0.3 if guessed else 0.7,
            words=f"{signal.name} answers the inputs, but not as the rig's law says (correlation "
            f"{found.correlation:.2f}, {ratio:.3g} times as far)",
            cure=f"{'the law is a guess of rig from: put physics into system.py' if guessed else 'correct the law'}, "
            "or take --structure state_space; or is a column another one?",
        )  # fmt: skip
        return
    if not answered:
        yield RecordFinding(
            kind="no relation", cost=0.79 if follows < RELATED else DOUBTFUL,
            words=f"{signal.name} does not follow the inputs as the rig's law says (correlation "
            f"{found.correlation:.2f}), nor their squares and products, at any lag",
            cure="is it the right column, of the same experiment? a law with memory of its own may hide an answer",
        )  # fmt: skip
        return
    if follows < (CERTAIN if guessed else CLEAR):
        scaled = found.correlation > CLEAR and not 0.72 < found.scale < 1.38
        if scaled and is_undone(signal.values, expected, found.scale * expected):
            yield scale_finding(signal, found.scale)
        return
    if found.correlation < 0.0:
        yield _sign(signal, found)
        return
    yield from _differences(signal, found, expected, record, apart, rig)


def _sign(signal: CheckedSignal, found: Alignment) -> RecordFinding:
    return RecordFinding(
        kind="sign", cost=0.97,
        words=f"{signal.name} goes the other way than the inputs drive it (correlation {found.correlation:.2f})",
        cure="turn the sensor or the input round: sign: -1 in import.yaml, or a negative scale in --signals",
    )  # fmt: skip


def _differences(
    signal: CheckedSignal, found: Alignment, expected: Array, record: Record, apart: int, rig: Rig
) -> Iterator[RecordFinding]:
    """Delay, drift and scale of an output that clearly is the one of the physics."""
    late, guessed = found.lag * signal.period, is_guessed(rig)
    shortest = max(SHORTEST_LAG, SHARE * apart, rig.step / signal.period if guessed else 0.0)
    early = late < 0.0 and is_early(record.input, signal.values)
    if guessed and not early and (late < 0.0 or not is_undone(signal.values, expected, later_by(expected, found.lag))):
        shortest = np.inf  # a guess may be slower than the rig, or of too low an order
    if abs(found.lag) > shortest and found.correlation > 0.75:
        way = "later" if late > 0 else "earlier"
        shown = f"{1e3 * abs(late):.3g} ms" if abs(late) < 1.0 else f"{abs(late):.3g} s"
        yield RecordFinding(
            kind="delay", cost=min(0.79, 0.5 + 0.3 * abs(found.lag) / (10 * apart)),
            words=f"{signal.name} answers {shown} {way} than the rig's physics say"
            + (", before the inputs move" if early else ""),
            cure=f"shift: {round(found.lag)} of its column in import.yaml; or give the rig that delay, if it is real"
            if late > 0
            else f"shift: {round(-found.lag)} of the inputs' columns in import.yaml, if these are late; or "
            + ("a loop makes the input" if early else "the law is slower than the rig: correct its numbers"),
        )  # fmt: skip
    apart_from, at = signal.values - expected, np.arange(len(expected))
    line = np.polyfit(at, apart_from, 1)
    alike = float(np.corrcoef(at, expected)[0, 1]) ** 2  # of a slow ramp a line says nothing: laws err along it
    rise = abs(float(line[0])) * len(expected)
    straight = np.var(np.polyval(line, at)) > STRAIGHT * np.var(apart_from)
    drifts = straight and rise > max(DRIFTS, alike) * float(np.ptp(expected)) and found.correlation > 0.7
    if drifts and not (guessed and straightness_of_offsets(record, rig, signal.name) > STRAIGHT):
        yield RecordFinding(
            kind="sensor drift", cost=0.6,
            words=f"{signal.name} leaves what the rig's physics say by {signal.shown(rise)}, along a straight line",
            cure="let the sensor warm up, or take the line away; in a rig that integrates, an offset looks alike",
        )  # fmt: skip
    if not 0.72 < found.scale < 1.38 and found.correlation > 0.75:
        yield scale_finding(signal, found.scale)


def _hysteresis(
    inputs: Sequence[CheckedSignal], delays: Sequence[float], signal: CheckedSignal, expected: Array, lag: float,
    less: float,
) -> RecordFinding | None:  # fmt: skip
    """A play that explains an output by far better than the rig's physics do, be they late or early. delays: of the
    inputs in the rig, in samples. less: squared error that it may leave, in that of the physics.
    """
    at, y = np.arange(len(expected), dtype=np.float64), signal.values
    acted = [np.interp(at - max(delay + lag, 0.0), at, u.values) for u, delay in zip(inputs, delays, strict=True)]
    aligned = np.interp(at - lag, at, expected)
    error = float(np.var(y - np.polyval(np.polyfit(aligned, y, 1), aligned)) / np.var(y))
    play = hysteresis_of(acted, y) if error > FOLLOWED else None
    if play is None or play.left > less * error:
        return None
    place = signal if play.input is None else inputs[play.input]
    return RecordFinding(
        kind="hysteresis", cost=0.55,
        words=f"{signal.name} answers otherwise on the way up than on the way down, as if {place.name} turned round "
        f"within a play of {place.shown(play.width)}",
        cure="look for a valve, gear or sensor that sticks (a guess); or put a play into the law (backlash)",
    )  # fmt: skip


def _drift(signal: CheckedSignal, expected: Array, good: NDArray[np.bool_], apart: int, longest: int) -> float | None:
    """Change of the delay [samples per sample], where it is clear."""
    length = len(good) // PIECES
    if length < 4 * apart or length < 40:
        return None
    lags, middles = [], []
    for piece in range(PIECES):
        part = slice(piece * length, (piece + 1) * length)
        if np.ptp(expected[part]) == 0.0 or good[part].mean() < 0.5:
            continue
        one = best_alignment(signal.values[part], expected[part], good[part], apart, min(longest, length // 3))
        if one.correlation > CLEAR:
            lags.append(one.lag)
            middles.append((piece + 0.5) * length)
    if len(lags) < 5:
        return None
    slope, level = np.polyfit(middles, lags, 1)
    left = np.array(lags) - np.polyval([slope, level], middles)
    error = float(np.sqrt(left @ left / (len(lags) - 2) / np.sum((np.array(middles) - np.mean(middles)) ** 2)))
    return float(slope) if abs(slope) > 4.0 * error + 1e-12 else None


def _frozen(signal: CheckedSignal, expected: Array) -> Iterator[RecordFinding]:
    """Values that stay exactly the same while the physics move on."""
    same = np.append(False, np.diff(signal.values) == 0.0)
    first, length = runs_of(same)
    long = length >= SHORTEST_FROZEN
    count = max(signal.resolution(), signal.count)
    usual = float(np.median(np.abs(changes(expected, 1)))) or 1e-300
    found = []
    for start, size in zip(first[long], length[long], strict=True):
        moved = float(np.ptp(expected[start : start + size]))
        if moved > max(0.08 * float(np.ptp(expected)), 6.0 * count) and moved > 3.0 * usual:
            found.append((int(start), int(size)))
    if found:
        for start, size in found:
            signal.spoilt[start : start + size] = True
        lost = sum(size for _, size in found)
        value = float(signal.values[found[0][0]])
        at_end = min(abs(value - signal.values.max()), abs(value - signal.values.min())) <= 1e-6 * signal.span
        yield RecordFinding(
            kind="clipped" if at_end else "frozen", cost=min(0.79, 0.55 + 0.5 * lost / len(expected)),
            words=f"{signal.name} stays at {signal.shown(value)} for "
            f"{max(size for _, size in found) * signal.period:.3g} s from {signal.at(found[0][0])} on, "
            f"{lost / len(expected):.1%} of the record, while the inputs drive it on",
            cure="leave that part out (--part), and "
            + ("enlarge the range or drive less" if at_end else "look for the sensor's cable or a full buffer"),
        )  # fmt: skip


def _swapped(outputs: Sequence[CheckedSignal], expected: Array) -> RecordFinding | None:
    """Two outputs, each of which follows what is expected of the other."""
    table, errors = np.zeros((len(outputs), len(outputs))), np.zeros((len(outputs), len(outputs)))
    for i, signal in enumerate(outputs):
        for j in range(len(outputs)):
            if signal.span > 0.0 and np.ptp(expected[:, j]) > 0.0:
                apart = time_of_change(expected[:, j])
                found = best_alignment(signal.values, expected[:, j], ~signal.spoilt, apart, 4 * apart)
                table[i, j] = abs(found.correlation)
                errors[i, j] = np.var(signal.values - expected[:, j]) / np.var(signal.values)
    for i in range(len(outputs)):
        for j in range(i):
            other = min(table[i, j], table[j, i]) > max(table[i, i], table[j, j], 0.5) + 0.1
            if other or errors[i, j] + errors[j, i] < EXCHANGED * (errors[i, i] + errors[j, j]):
                return RecordFinding(
                    kind="swapped channels", cost=0.96,
                    words=f"{outputs[i].name} moves as {outputs[j].name} should, and the other way round",
                    cure="exchange the two columns in import.yaml or in --signals",
                )  # fmt: skip
    return None


def _exchanged(record: Record, rig: Rig, output: CheckedSignal, expected: Array) -> RecordFinding | None:
    """An output that is the input: the input's column follows what the output's column would drive."""
    if output.span == 0.0 or np.ptp(expected) == 0.0 or np.ptp(record.input) == 0.0:
        return None
    apart = time_of_change(expected)
    straight = best_alignment(output.values, expected, ~output.spoilt, apart, 8 * apart)
    if straight.correlation > CLEAR and (straight.lag > -1.5 or is_guessed(rig)):
        return None  # a stable guess of what is unstable in a loop answers early
    low, high = rig.limits
    driving = (record.output - record.output.mean()) / np.ptp(record.output) * (high - low) + 0.5 * (high + low)
    other = expected_outputs(replace(record, input=driving, output=record.input), rig)
    if other is None or np.ptp(other) == 0.0:
        return None
    apart = time_of_change(other[:, 0])
    back = best_alignment(record.input[:, 0], other[:, 0], np.ones(record.samples, dtype=bool), apart, 4 * apart)
    if back.correlation < max(CLEAR, straight.correlation + (0.2 if straight.correlation < CLEAR else 0.0)):
        return None
    return RecordFinding(
        kind="swapped channels", cost=0.96,
        words=f"the input's column moves as {output.name} should, and that of {output.name} as an input",
        cure="exchange the two columns in import.yaml or in --signals",
    )  # fmt: skip
