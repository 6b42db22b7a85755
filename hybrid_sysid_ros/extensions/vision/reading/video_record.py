"""Video record: a bag made of a film, beside the bag that was recorded meanwhile or alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.bag import opened
from hybrid_sysid_ros.bags.columns import MissingInMessageError, TopicColumns
from hybrid_sysid_ros.extensions.vision.reading.footage import Footage
from hybrid_sysid_ros.extensions.vision.reading.lamp import Onset, onset
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.synchronisation import Synchronisation, synchronise
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.rigs.joints import MEASUREMENTS
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import CAMERA
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

START = 1_000_000_000  # ns: the first stamp of a bag without another one to go by
MOST_FILLED = 3  # pictures in a row without an angle that are filled in between their neighbours
CLOCKS = 1e-3  # by which two clocks may differ in pace, at most
APART = 5.0  # deviations, by which lamp and motion may tell other shifts


@dataclass(frozen=True, kw_only=True, eq=False)
class VideoRecord:
    """Positions that a camera has seen, in a bag's time."""

    footage: Footage
    onset: Onset | None
    """When the lamp went on, in the film's time; None where it was not seen."""
    synchronisation: Synchronisation | None
    """None without a bag."""
    encoder: tuple[Array, Array] | None
    """Times [s] and positions [rad] of the bag's own sensor, where it has one."""
    stamps: NDArray[np.int64]
    """Of the positions (frames,) [ns]."""
    positions: Array
    """[rad]; those of lost pictures between their neighbours."""
    filled: NDArray[np.bool_]
    """Which those are."""


def joined(footage: Footage, layers: PictureLayers, rig: Rig, bag: Path | None, *, exposure: float) -> VideoRecord:
    """The positions that a film shows; with a bag in its time, and by its sensor's zero and scale.

    Raises UserError where the bag has no position of the joint, or film and bag do not go together.
    """
    lamp: Onset | None = None
    lit = np.isfinite(footage.lamp)
    if lit.any():
        scene = scene_of(rig)
        assert scene.lamp is not None
        row = scene.lamp.at[1] * layers.background.shape[1] - 0.5
        with suppress(UserError):
            lamp = onset(footage.times[lit] + layers.row_time(row), footage.lamp[lit], exposure=exposure)
    geometry = layers.geometry
    angles, filled = _filled(footage)
    if bag is None:
        positions = geometry.scale * (angles - geometry.zero)
        stamps = START + np.round(1e9 * (footage.seen - footage.times[0])).astype(np.int64)
        return VideoRecord(
            footage=footage, onset=lamp, synchronisation=None, encoder=None, stamps=stamps, positions=positions,
            filled=filled,
        )  # fmt: skip
    origin, times, encoder = encoder_of(rig, geometry.joint, bag)
    found = synchronise(footage.seen, footage.angles, times, encoder)
    return VideoRecord(
        footage=footage,
        onset=lamp,
        synchronisation=found,
        encoder=(times, encoder),
        stamps=origin + np.round(1e9 * found.time(footage.seen)).astype(np.int64),
        positions=found.position(angles),
        filled=filled,
    )


def calibrated(layers: PictureLayers, record: VideoRecord) -> PictureLayers:
    """Layers that tell positions by the zero and the scale of the bag's sensor; the same without a bag."""
    found = record.synchronisation
    if found is None:
        return layers
    return replace(layers, geometry=replace(layers.geometry, scale=found.scale, zero=-found.offset / found.scale))


def encoder_of(rig: Rig, joint: str, bag: Path) -> tuple[int, Array, Array]:
    """First stamp [ns], times from there on [s] and positions [rad] of a joint as a bag has them."""
    topic, stamps, values = f"/{rig.namespace}/{MEASUREMENTS}", list[NDArray[np.int64]](), list[Array]()
    field = f"position[{joint}]"
    with opened(bag) as found:
        if topic not in found.topics:
            raise UserError(f"{bag}: no topic {topic}: the bag has {found.listing}")
        for block in found.blocks({topic}):
            columns = TopicColumns(block)
            try:
                values.append(columns.values(field))
                stamps.append(columns.stamps(field))
            except MissingInMessageError as error:
                raise UserError(
                    f"{bag}: topic {topic}: field {field} is missing in {error}: a film is put in a bag's time by a "
                    "position that was measured; leave out --bag"
                ) from error
    known = np.isfinite(np.concatenate(values))
    when, where = np.concatenate(stamps)[known], np.concatenate(values)[known]
    if len(when) < 10 or not (np.diff(when) > 0).all():
        raise UserError(f"{bag}: {topic} has no position of {joint} at times that rise: nothing to synchronise with")
    return int(when[0]), (when - when[0]) * 1e-9, where


def _filled(footage: Footage) -> tuple[Array, NDArray[np.bool_]]:
    """Angles (frames,) without gaps, and where they were filled in. Raises UserError for a gap that is too long."""
    lost = np.isnan(footage.angles)
    run = 0
    for k, missing in enumerate(lost):
        run = run + 1 if missing else 0
        if run > MOST_FILLED:
            what = "stands still, frozen to the last bit," if footage.frozen[k] else "is black, or shows no joint,"
            raise UserError(
                f"the film {what} from {footage.times[k - run + 1]:.3g} s on for more than {MOST_FILLED} pictures"
                ": cut it there"
            )
    at = np.flatnonzero(~lost)
    return np.interp(footage.seen, footage.seen[at], footage.angles[at]), lost


def contradictions(record: VideoRecord) -> Iterator[str]:
    """What is odd about the film's time: its pace, or a lamp that goes on at another time than the bag begins."""
    if record.onset is None:
        yield "no lamp goes on in the film: its time is told by the motion alone"
    if (found := record.synchronisation) is None:
        return
    if abs(found.rate) > CLOCKS:
        yield (
            f"the film's times run {abs(found.rate):.2%} {'slow' if found.rate > 0.0 else 'fast'} beside the bag's, as "
            "no clock does: they are of another rate than it was taken at, which is put right"
        )
    if record.onset is not None:
        late = float(found.time(np.array([record.onset.time]))[0])
        most = APART * float(np.hypot(record.onset.deviation, found.deviations[0]))
        if abs(late) > most:
            when = f"{abs(late):.3f} s {'after' if late > 0.0 else 'before'}"
            yield f"the lamp goes on {when} the bag begins, as the motion has it: the time is that of the motion"


def at_rate(record: VideoRecord, rate: float) -> VideoRecord:
    """The same with positions at a rate of its own [Hz], between frames by a cubic spline, as the inputs that a model
    needs between them are told more often than there are frames; what is faster than half the frames' rate is not
    there.

    Raises UserError for a rate below that of the frames.
    """
    if rate < record.footage.rate:
        raise UserError(f"--rate {rate:g}: the film has {record.footage.rate:.4g} pictures a second: give that or more")
    period = round(1e9 / rate)
    stamps = np.arange(record.stamps[0], record.stamps[-1] + 1, period)
    begin = record.stamps[0]
    spline = CubicSpline((record.stamps - begin) * 1e-9, record.positions)
    positions = np.asarray(spline((stamps - begin) * 1e-9))
    return replace(record, stamps=stamps, positions=positions)


def write(
    record: VideoRecord, rig: Rig, joint: str, bag: Path | None, out: Path, *, replace: bool, made_by: str
) -> None:
    """Write a bag: all topics of the other one, where there is one, and the camera's joint states beside them.

    Raises UserError where it can't be written.
    """
    topic = f"/{rig.namespace}/{CAMERA}/{MEASUREMENTS}"
    series = bags.joint_states(topic, record.stamps, [f"{joint}_{CAMERA}"], position=record.positions[:, None])
    with bags.BagWriter(out, replace=replace, notes={"made_by": made_by}) as writer:
        seen = zip(record.stamps.tolist(), series.messages(), strict=True)
        following = next(seen, None)
        if bag is not None:
            with opened(bag) as other:
                for name, logged, data in other.messages(other.topics):
                    while following is not None and following[0] <= logged:
                        writer.write_raw(topic, series.type, *following)
                        following = next(seen, None)
                    if name != topic:
                        writer.write_raw(name, other.topics[name].type, logged, data)
        while following is not None:
            writer.write_raw(topic, series.type, *following)
            following = next(seen, None)
