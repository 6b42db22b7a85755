"""The record: speeds of top and bit and torque at the bit, read from the folder that the user names, and cleaned."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError
from scipy.ndimage import binary_dilation, label, mean, percentile_filter

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import sha256

FILE = Path("drillstring") / "175_completo_1.mat"
CHANNELS = {"time": "Time", "top": "Top_Speed", "bit": "Bit_Speed", "torque": "Bit_Torque"}
"""What each is called in the file, before ``_Sample_``."""
SAMPLING = Sampling(step=0.002, period=0.01)
LEARNT, KEPT = Part(stop=0.5), Part(start=0.5)
RPM = 2.0 * np.pi / 60.0
WINDOW, LEVEL, FLANK = 0.1, 80.0, 0.5
"""A spike reaches, about its samples below zero, as far as readings stay below FLANK times the LEVEL percentile of the
WINDOW [s] about them."""
ABOUT = 0.04
"""Time before and after a spike [s] over which the angle that it takes back is spread; spikes closer than twice that
are one piece.
"""
SHORTEST = 4.0
"""A record that can be parted in halves [s]."""
MOST, LONGEST = 0.15, 0.25
"""Share of the samples, and time on end [s], that cleaning may replace."""
APART = 0.2
"""Share of the angle by which top and bit may turn differently; in the record they turn alike to 4e-4."""
_UNREADABLE = (MatReadError, ValueError, TypeError, KeyError, IndexError, EOFError, OSError, struct.error, zlib.error)


@dataclass(frozen=True, kw_only=True)
class Cleaning:
    """What was done to the top's speed."""

    negative: int
    """Samples below zero, which a top that turns forward does not have."""
    spikes: int
    replaced: float
    """Share of the samples."""
    longest: float
    """Piece that was replaced [s]."""
    lowest: float
    """Reading [rad/s]."""
    returned: float
    """Angle by which the straight lines turn further than the readings, and which was taken off around them [rad]."""


def cleaned(top: Array, period: float, *, name: str = "top speed") -> tuple[Array, Cleaning]:
    """The speed of the top (samples,) with its negative spikes and their flanks replaced by straight lines, to which
    the angle that the spikes take back returns, spread evenly over the ABOUT around them.

    That angle is true, as the record shows: with it the top turns as far as the bit; while both stand for a second,
    readings of 30 rpm and more between spikes add up to nothing with them.

    Raises UserError where more than MOST of the samples or a piece longer than LONGEST would have to go.
    """
    below = top < 0.0
    usual = percentile_filter(top, LEVEL, size=round(WINDOW / period))
    pieces, _ = label(top < np.maximum(FLANK * usual, 0.0))
    bad = np.isin(pieces, np.setdiff1d(pieces[below], 0)) | below
    edges = np.diff(np.concatenate([[False], bad, [False]]).astype(int))
    starts, stops = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    lengths = (stops - starts) * period
    samples = np.arange(len(top))
    lines = np.interp(samples, samples[~bad], top[~bad]) if not bad.all() else top
    found = Cleaning(
        negative=int(below.sum()),
        spikes=int(np.sum(np.diff(np.concatenate([[0], below.astype(int)])) > 0)),
        replaced=float(np.mean(bad)),
        longest=float(lengths.max(initial=0.0)),
        lowest=float(top.min()),
        returned=float(np.sum(lines - top)) * period,
    )
    if found.replaced > MOST or found.longest > LONGEST:
        where = int(starts[np.argmax(lengths)])
        raise UserError(
            f"{name}: {found.spikes} negative spikes, {100 * found.replaced:.1f} % of the samples, the longest of "
            f"{found.longest:.3g} s at {where * period:.3f} s: at most {100 * MOST:g} % and {LONGEST:g} s can be "
            "replaced; take a better record"
        )
    about, pieces = label(binary_dilation(bad, iterations=round(ABOUT / period)))
    excess = mean(lines - top, about, np.arange(1, pieces + 1))
    return lines - np.concatenate([[0.0], excess])[about], found


def load(folder: Path) -> tuple[Record, Cleaning]:
    """The record of a folder, with the cleaned top as input and the bit's speed and torque as outputs.

    Raises UserError where the file is missing, unreadable or lacks a channel, for spikes beyond cleaning, and where top
    and bit don't turn alike.
    """
    path = next((place for place in (folder / FILE, folder / FILE.name, folder) if place.is_file()), None)
    if path is None:
        raise UserError(f"{folder}: no {FILE.name}, nor {FILE}: it is in the public repository thiagoritto/drillstring")
    try:
        content = loadmat(path)
    except _UNREADABLE as error:
        raise UserError(f"{path}: is no readable .mat file ({error}); fetch it again") from error
    arrays = {}
    for channel, called in CHANNELS.items():
        keys = [key for key in content if key.startswith(f"{called}_Sample")]
        if len(keys) != 1:
            raise UserError(f"{path}: has no {called}_Sample...: it is another record")
        arrays[channel] = _numbers(path, called, content[keys[0]])
    if len({len(array) for array in arrays.values()}) > 1:
        raise UserError(f"{path}: its channels have different numbers of samples; fetch it again")
    steps = np.diff(arrays["time"])
    period = float(np.median(steps)) if len(steps) else 0.0
    if len(steps) * period < SHORTEST or np.abs(steps - period).max() > 0.5 * period:
        raise UserError(
            f"{path}: {CHANNELS['time']} is no {SHORTEST:g} s in even steps, which the study needs; fetch it again"
        )
    top, found = cleaned(RPM * arrays["top"], period, name=f"{path}: {CHANNELS['top']}")
    turned, bit_turned = (period * float(speed.sum()) for speed in (top, RPM * arrays["bit"]))
    if abs(turned - bit_turned) > APART * max(abs(turned), abs(bit_turned)):
        raise UserError(
            f"{path}: {CHANNELS['top']} turns by {turned:.4g} rad, {CHANNELS['bit']} by {bit_turned:.4g} rad, and they "
            "are the ends of one shaft: one of them is not in rpm; convert it"
        )
    outputs = np.column_stack([RPM * arrays["bit"], arrays["torque"]])
    time = period * np.arange(len(top), dtype=np.float64)
    record = Record(
        name=path.stem, time=time, input=top[:, None], output=outputs, source=str(path), digest=sha256(path)
    )
    return record, found


def _numbers(path: Path, channel: str, value: Array) -> Array:
    """A channel as finite numbers, (samples,)."""
    if value.dtype.kind not in "fiub":
        raise UserError(f"{path}: {channel} holds no numbers; fetch it again")
    array = np.asarray(value, dtype=float).ravel()
    wrong = ~np.isfinite(array)
    if wrong.any():
        raise UserError(
            f"{path}: {channel} is not finite at sample {int(np.argmax(wrong))}, {int(wrong.sum())} of {len(array)} "
            "are not; fetch it again"
        )
    return array
