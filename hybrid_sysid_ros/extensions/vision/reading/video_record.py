"""Video record: a bag made of a film, beside the bag that was recorded meanwhile or alone."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.bag import opened
from hybrid_sysid_ros.bags.columns import MissingInMessageError
from hybrid_sysid_ros.bags.signals import Signal
from hybrid_sysid_ros.extensions.vision.reading.footage import Footage
from hybrid_sysid_ros.extensions.vision.reading.joint_reference import (
    JointReference,
    MotionSource,
    column,
    joint_reference,
)
from hybrid_sysid_ros.extensions.vision.reading.lamp import Onset, onset
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.synchronisation import Synchronisation, synchronise
from hybrid_sysid_ros.extensions.vision.reading.unused_pictures import Unused
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.rigs.joints import MEASUREMENTS
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import CAMERA
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_file

START = 1_000_000_000  # ns: the first stamp of a bag without another one to go by
MOST_FILLED = 3  # pictures in a row without an angle that are filled in between their neighbours
CLOCKS = 1e-3  # by which two clocks may differ in pace, at most
OFF_SCALE = 0.01  # of a sensor's scale that is no other one than the picture's: seen 8 degrees beside the axis
EARLY = 20  # of a picture's time, by which its last rows may be of an earlier moment than its rate says
BENT = math.radians(0.03)  # of a film's angles beside a sensor's, that is said
MARKS = "click four marks on the page of --check if the camera looks from the side"
APART = 5.0  # deviations, by which lamp and motion may tell other shifts


@dataclass(frozen=True, kw_only=True, eq=False)
class VideoRecord:
    """Positions that a camera has seen, in a bag's time."""

    footage: Footage
    onset: Onset | None
    """When the lamp went on, in the film's time; None where it was not seen."""
    synchronisation: Synchronisation | None
    """None without a bag."""
    reference: JointReference | None
    """The joint's motion as the bag has it."""
    stamps: NDArray[np.int64]
    """Of the positions (frames,) [ns]."""
    positions: Array
    """[rad]; those of lost pictures between their neighbours."""
    filled: NDArray[np.bool_]
    """Which those are."""
    unexplained: float = 0.0
    """By which film and sensor of the position differ beyond their noise, rms [rad], which the deviations hold."""

    @property
    def speeds(self) -> Array:
        """Of the joint at the stamps [rad/s], by a cubic spline."""
        seconds = (self.stamps - self.stamps[0]) * 1e-9
        return np.asarray(CubicSpline(seconds, self.positions)(seconds, 1))


def joined(footage: Footage, layers: PictureLayers, rig: Rig, bag: Path | None, *, exposure: float) -> VideoRecord:
    """The positions that a film shows; with a bag in its time, and by the zero and scale of its sensor of the position,
    or the scale of one of the speed. Where it has neither, the rig's inputs tell the time alone.

    Raises UserError where the bag has nothing of these, or film and bag do not go together.
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
        footage = footage.turned_unsurely(geometry.scale_deviation)
        positions = geometry.scale * (angles - geometry.zero)
        if layers.full_turn:  # a turn more or less looks alike: the film begins in the one about 0
            positions = positions - 2.0 * math.pi * round(float(positions[0]) / (2.0 * math.pi))
        stamps = START + np.round(1e9 * (footage.seen - footage.times[0])).astype(np.int64)
        return VideoRecord(
            footage=footage, onset=lamp, synchronisation=None, reference=None, stamps=stamps, positions=positions,
            filled=filled,
        )  # fmt: skip
    reference = joint_reference(rig, geometry.joint, bag)
    seen = footage.angles if reference.kind is MotionSource.POSITION else _speeds(footage)
    found = synchronise(footage.seen, seen, reference.times, reference.values, exposure=exposure)
    if reference.kind is not MotionSource.INPUT and found.contradicted.any():
        footage = footage.without(Unused.CONTRADICTED, found.contradicted)
        angles, filled = _filled(footage)
    scale = found.scale if _off_scale(found, reference) else geometry.scale
    by_position, unexplained = reference.kind is MotionSource.POSITION, 0.0
    late = math.hypot(float(found.deviations[0]), found.wander if by_position else 0.0)
    footage = footage.unsurer(late * np.gradient(angles, footage.seen))
    if scale == geometry.scale and not by_position:
        footage = footage.turned_unsurely(geometry.scale_deviation)
    if by_position:  # what is not linear beside the sensor is no angle that is known better
        footage = footage.unsurer(found.bend / abs(found.scale))
        unexplained = found.unexplained(footage.deviations)
        footage = footage.unsurer(unexplained / abs(found.scale))
    return VideoRecord(
        footage=footage,
        onset=lamp,
        synchronisation=found,
        reference=reference,
        stamps=reference.origin + np.round(1e9 * found.time(footage.seen)).astype(np.int64),
        positions=found.position(angles) if by_position else scale * (angles - geometry.zero),
        filled=filled,
        unexplained=unexplained,
    )


def _off_scale(found: Synchronisation, reference: JointReference) -> bool:
    """Whether a sensor of the speed says surely that the film's angles are of another scale: that of a picture is true
    where it is seen squarely, and that of noisy speeds is not as sure.
    """
    sure = OFF_SCALE + 3.0 * float(found.deviations[2])
    return reference.kind is MotionSource.SPEED and abs(found.scale - 1.0) > sure


def _speeds(footage: Footage) -> Array:
    """Speeds of the sprite (frames,) [rad/s], NaN where there is no angle."""
    known = np.isfinite(footage.angles)
    found = np.full(len(known), np.nan)
    found[known] = CubicSpline(footage.seen[known], footage.angles[known])(footage.seen[known], 1)
    return found


def calibrated(layers: PictureLayers, record: VideoRecord) -> PictureLayers:
    """Layers that tell positions by the zero and the scale of the bag's sensor; the same without a bag."""
    found, reference = record.synchronisation, record.reference
    if found is None or reference is None or reference.kind is MotionSource.INPUT:
        return layers
    if reference.kind is MotionSource.SPEED:
        scale = found.scale if _off_scale(found, reference) else layers.geometry.scale
        return replace(layers, geometry=replace(layers.geometry, scale=scale))
    geometry = replace(layers.geometry, scale=found.scale, zero=-found.offset / found.scale, scale_deviation=0.0)
    return replace(layers, geometry=geometry)


def _filled(footage: Footage) -> tuple[Array, NDArray[np.bool_]]:
    """Angles (frames,) without gaps, and where they were filled in. Raises UserError for a gap that is too long."""
    lost = np.isnan(footage.angles)
    run = 0
    for k, missing in enumerate(lost):
        run = run + 1 if missing else 0
        if run > MOST_FILLED:
            why = footage.why(k)
            raise UserError(
                f"the film {why.said} from {footage.times[k - run + 1]:.3g} s on for more than {MOST_FILLED} pictures: "
                f"{why.advice}"
            )
    at = np.flatnonzero(~lost)
    if len(at) < 2:
        raise UserError("fewer than two pictures of the film have an angle")
    inside = np.clip(footage.seen, footage.seen[at[0]], footage.seen[at[-1]])
    return np.where(lost, CubicSpline(footage.seen[at], footage.angles[at])(inside), footage.angles), lost


def contradictions(record: VideoRecord) -> Iterator[str]:
    """What is odd about the film's time: its pace, or a lamp that goes on at another time than the bag begins."""
    if record.onset is None:
        yield "no lamp goes on in the film: its time follows from the motion alone"
    if (found := record.synchronisation) is None:
        yield from _alone(record)
        return
    assert record.reference is not None
    if (kind := record.reference.kind) is not MotionSource.POSITION:
        how = f"film and bag are put together by its {kind.value}, and the zero is free"
        yield f"the bag has no position of the joint: {how}"
    yield from _beside_the_axis(record, found, kind)
    if record.unexplained:
        yield (
            f"film and sensor differ by {math.degrees(record.unexplained):.2g} degrees, rms, beyond their noise: one "
            "of them is off, perhaps the film by its compression, which its deviation holds"
        )
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


def _squared(record: VideoRecord) -> bool:
    """Whether marks put the film's view right."""
    return record.footage.view is not None and record.footage.view.square is not None


def _alone(record: VideoRecord) -> Iterator[str]:
    """What is said where no sensor tells how large a film's angles are."""
    if not _squared(record):
        yield f"the film alone tells how large angles are, as if it looked along the axis: {MARKS}"


def _beside_the_axis(record: VideoRecord, found: Synchronisation, kind: MotionSource) -> Iterator[str]:
    """What speaks for a camera that does not look along the joint's axis: seen from the side by an angle s, angles are
    up to 1 / cos s times as large, and bend where they are large.
    """
    if _squared(record):
        return
    if kind is MotionSource.INPUT:
        yield from _alone(record)
        return
    off = abs(found.scale - 1.0)
    if off > OFF_SCALE + 3.0 * float(found.deviations[2]):
        seen = math.degrees(math.acos(min(found.scale, 1.0 / found.scale)))
        yield (
            f"the sensor's angles are {found.scale:.4g} times the film's, as a view from {seen:.0f} degrees beside the "
            f"axis may make them, or a pivot that is off along the joint: the sensor's count; {MARKS}"
        )
    if kind is MotionSource.POSITION and found.bend > BENT:
        yield (
            f"the film's angles bend by {math.degrees(found.bend):.2g} degrees, rms, beside the sensor's, as a view "
            f"from the side, a lens or the sensor makes them, which their deviation holds: {MARKS}"
        )


def at_rate(record: VideoRecord, rate: float) -> VideoRecord:
    """The same with positions at a rate of its own [Hz], between frames by a cubic spline, as the inputs that a model
    needs between them are given more often than there are frames; what is faster than half the frames' rate is not
    there.

    Raises UserError for a rate below that of the frames.
    """
    if rate < record.footage.rate:
        raise UserError(f"--rate {rate:g}: the film has {record.footage.rate:.4g} pictures a second: give that or more")
    period = round(1e9 / rate)
    stamps = np.arange(record.stamps[0], record.stamps[-1] + period // EARLY, period)  # the last one, too
    begin = record.stamps[0]
    spline = CubicSpline((record.stamps - begin) * 1e-9, record.positions)
    positions = np.asarray(spline((stamps - begin) * 1e-9))
    return replace(record, stamps=stamps, positions=positions)


def usual_rate(record: VideoRecord) -> float:
    """The rate of the bag's own samples, where it is above that of the pictures, or else theirs [Hz]: inputs change
    between two pictures, and a model is identified at a uniform rate.
    """
    rate = record.footage.rate
    if record.reference is None or record.reference.kind is MotionSource.INPUT:
        return rate
    return max(round(1.0 / float(np.median(np.diff(record.reference.times))), 6), rate)


def write(
    record: VideoRecord, rig: Rig, joint: str, bag: Path | None, out: Path, *, replace: bool, made_by: str
) -> None:
    """Write a bag: all topics of the other one, where there is one, and the camera's joint states beside them. These
    have what other joints the bag has of the rig's outputs, and of an earlier film, too, between their samples, and end
    where those of the outputs do: a model needs all of them. No bag has a time before 0.

    Raises UserError where it can't be written, or where film and bag have no time in common.
    """
    topic = f"/{rig.namespace}/{CAMERA}/{MEASUREMENTS}"
    names, columns = [f"{joint}_{CAMERA}"], {"position": [record.positions], "velocity": [record.speeds]}
    needed = {rig.joints.place(item.name) for item in rig.system.outputs}
    whole = record.stamps >= 0
    for name, fields in _others(record, rig, joint, bag):
        names.append(name)
        for field, values in columns.items():
            values.append(fields.get(field, np.full(len(record.stamps), np.nan)))
        for field in fields:
            whole &= np.isfinite(fields[field]) | ((name, field) not in needed)
    if not whole.any():
        raise UserError(f"{bag}: it has no samples while the film was taken: give the bag of that time")
    known = slice(int(np.argmax(whole)), len(whole) - int(np.argmax(whole[::-1])))
    stamps = record.stamps[known]
    position, velocity = (np.column_stack(columns[field])[known] for field in ("position", "velocity"))
    series = bags.joint_states(topic, stamps, names, position=position, velocity=velocity)
    with bags.BagWriter(out, replace=replace, notes={"made_by": made_by}) as writer:
        seen = zip(stamps.tolist(), series.messages(), strict=True)
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


def _others(record: VideoRecord, rig: Rig, joint: str, bag: Path | None) -> Iterator[tuple[str, dict[str, Array]]]:
    """Entries of further joints at the record's stamps: of the rig's other outputs, and of an earlier film's."""
    if bag is None:
        return
    wanted = {place[0]: MEASUREMENTS for place in map(rig.joints.place, (item.name for item in rig.system.outputs))}
    wanted |= {f"{name}_{CAMERA}": f"{CAMERA}/{MEASUREMENTS}" for name in rig.joints.names}
    for name, topic in wanted.items():
        fields = {}
        for field in ("position", "velocity"):
            with suppress(MissingInMessageError, UserError):
                when, values = column(rig, bag, f"{field}[{name}]", topic)
                inside = (record.stamps >= when[0]) & (record.stamps <= when[-1])
                fields[field] = np.where(inside, np.interp(record.stamps, when, values), np.nan)
        if fields and name not in (joint, f"{joint}_{CAMERA}"):
            yield name, fields


def write_signals(path: Path, rig: Rig, joint: str) -> None:
    """Write a file of signals by which a written bag is read with the camera in the place of the joint's sensor.

    Raises UserError where it can't be written.
    """
    outputs = {}
    for name, signal in rig.signals.outputs.items():
        place, field = rig.joints.place(name)
        seen = f"{place}_{CAMERA}" if place == joint else place
        outputs[name] = {**_stated(signal), "topic": f"{CAMERA}/{MEASUREMENTS}", "field": f"{field}[{seen}]"}
    inputs = {name: _stated(signal) for name, signal in rig.signals.inputs.items()}
    content = {"namespace": rig.namespace, "signals": {"inputs": inputs, "outputs": outputs}}
    with written_file(path) as place_of:
        place_of.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _stated(signal: Signal) -> dict[str, Any]:
    """A signal as a file has it, without what is usual."""
    usual = Signal(topic="", field="x")
    return {key: value for key, value in vars(signal).items() if value != getattr(usual, key)}
