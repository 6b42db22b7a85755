"""Pictures ahead: what a camera will see some seconds on, by an identified motion and a renderer of its picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.vision import camera_loop
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.prediction.motion_prediction import DRIFTS, MotionAhead
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.reading.layers import KIND, PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.likeness import structural_similarity
from hybrid_sysid_ros.extensions.vision.reading.renderer import LayerRenderer, Renderer
from hybrid_sysid_ros.extensions.vision.reading.video_record import VideoRecord, calibrated
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

AHEAD = (0.5, 1.0, 2.0)
"""s, how far pictures are looked at."""
SETTLED = 2.0  # s of a film that are watched before the first prediction
APART = 1.0  # s between two predictions
SHUTTER = 0.03  # s, within which a picture's last row is exposed


@dataclass(frozen=True, kw_only=True, eq=False)
class PictureModel:
    """A model that predicts pictures: a model's folder with a folder ``layers`` in it, or any other renderer."""

    model: Model
    renderer: Renderer

    @classmethod
    def load(cls, folder: Path | str, *, exposure: float, rig: str = "") -> PictureModel:
        """Read the folder; exposure: of a row of the camera [s]. Raises UserError where model or layers are missing,
        or are of two rigs.
        """
        model, layers = load_model(folder, rig=rig), PictureLayers.load(Path(folder) / KIND)
        if layers.geometry.rig != model.rig:
            raise UserError(f"{folder}: the model is of {model.rig}, its layers are of {layers.geometry.rig}")
        return cls(model=model, renderer=LayerRenderer(layers, exposure=exposure))


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenMotion:
    """What a camera saw of a record: (frames,) each."""

    times: Array
    """Middle of the exposure of the middle row, in the record's time [s]."""
    seen: Array
    """When the joint was where it was read [s]."""
    positions: Array
    """[rad]; NaN where the joint was not found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictedFrame:
    """A frame that was predicted."""

    frame: int
    newest: int
    """The last frame that the prediction knew."""
    ahead: float
    """From that to the frame [s]."""
    position: float
    """Predicted [rad]."""
    deviation: float
    """Its standard deviation [rad]."""
    drift: float
    """Share of the rig's own drift of the inputs' offsets that was used."""
    picture: Picture


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A predicted frame beside what came."""

    look: PredictedFrame
    came: Picture
    likeness: float
    """Structural similarity in the band that the sprite comes over; see :func:`.structural_similarity`."""
    mean: float
    """That of the mean picture,"""
    still: float
    """and of the newest picture that was known."""
    error: float
    """Of the predicted position against the one that the frame shows [rad]."""
    shown: float
    """Of the position that the predicted picture shows [rad]; NaN where it shows none."""


def looks(
    model: PictureModel, rig: Rig, record: Record, watched: SeenMotion, *, noise: float, ahead: Sequence[float] = AHEAD,
    drifts: Sequence[float] = DRIFTS, seed: int = 0,
) -> Iterator[PredictedFrame]:  # fmt: skip
    """Frames that a model predicts ``ahead`` [s] from what the camera had shown before, and the inputs on the way.

    Filters with the rig's own tuning, one for each of ``drifts``, follow the frames alone and not the record's outputs.
    record: sampled at the model's step. noise: deviation of a frame, in the unit of the first output; see
    :func:`.camera_loop.frame_noise`. drifts: shares of the tuning's drift of the inputs' offsets; the share is used
    whose farthest predictions have been the likeliest so far. seed: that of the motions that make the band.
    """
    system, step, settings = model.model.system, record.sampling_time, configuration.defaults(rig, "estimator")
    tuning = configuration.estimator_tuning({**settings, "camera_noise": noise}, rig, system)
    motions = [MotionAhead(system, tuning, drift=drift, step=step, seed=seed) for drift in drifts]
    place = [item.name for item in system.states].index(rig.system.outputs[0].name)
    used, due, steps = int(np.searchsorted(watched.seen, -step)), SETTLED, math.ceil((max(ahead) + SHUTTER) / step)
    following: Array = step * np.arange(steps + 1, dtype=np.float64)
    past = math.ceil(system.delay / step) + 1
    for k in range(record.samples - steps):
        time = float(record.time[k])
        for motion in motions:
            motion.move(time, record.input[max(k - 1, 0)])
        while used < len(watched.seen) and watched.seen[used] <= time:
            if math.isfinite(watched.positions[used]):
                for motion in motions:
                    motion.see(used, watched.seen[used], watched.positions[used])
            used += 1
        if motions[0].estimate is None or time < due or not used:
            continue
        due += APART
        inputs = record.input[np.clip(np.arange(k - past, k + steps), 0, None)]
        frames = np.searchsorted(watched.times, watched.times[used - 1] + np.array(ahead) - 0.5 * step)
        shown = {
            wanted: int(frame)
            for wanted, frame in zip(ahead, frames, strict=True)
            if frame < len(watched.times) and watched.times[frame] - time <= following[-1]
        }
        likeliest = max(motions, key=lambda motion: motion.likelihood)
        for motion in motions:
            states, deviations = motion.run_on(inputs, past)
            for wanted, frame in shown.items():
                there = watched.seen[frame] - time
                position = float(np.interp(there, following, states[:, place]))
                deviation = float(np.interp(there, following, deviations[:, place]))
                if wanted == max(shown):
                    motion.expect(frame, position, deviation)
                if motion is likeliest:
                    yield PredictedFrame(
                        frame=frame,
                        newest=used - 1,
                        ahead=wanted,
                        position=position,
                        deviation=deviation,
                        drift=motion.drift,
                        picture=model.renderer.take(watched.times[frame] - time, following, states[:, place]),
                    )


def judged(
    found: PredictedFrame, film: Mapping[int, Picture], mean: Picture, reader: AngleReader, watched: SeenMotion
) -> Judged:
    """A predicted frame beside what came. film: its pictures by number; mean: of them; reader: of the film's layers."""
    came, band = film[found.frame], reader.swept
    reading, true = reader.read(found.picture), float(watched.positions[found.frame])
    shown = reader.layers.position(reading.angle) if reading.found else math.nan
    return Judged(
        look=found,
        came=came,
        likeness=structural_similarity(found.picture, came, band),
        mean=structural_similarity(mean, came, band),
        still=structural_similarity(film[found.newest], came, band),
        error=found.position - true,
        shown=shown - true,
    )


def foreseen(
    view: FilmView, model: PictureModel, rig: Rig, record: Record, watched: SeenMotion, reader: AngleReader
) -> list[Judged]:
    """Frames of a film that a model predicts, beside what came; the mean picture is that of the whole film. Raises
    UserError where the film can't be read, or is too short to predict anything.
    """
    noise = camera_loop.frame_noise(rig, reader.layers.background.shape[1])
    found = list(looks(model, rig, record, watched, noise=noise))
    if not found:
        raise UserError(f"{view.path}: is too short to predict {max(AHEAD):g} s of it")
    wanted = {number for look in found for number in (look.frame, look.newest)}
    film, total, count = dict[int, Picture](), np.zeros(reader.layers.background.shape), 0
    for count, (_, picture) in enumerate(view.pictures(), start=1):
        total += picture
        if count - 1 in wanted:
            film[count - 1] = picture
    mean = np.round(total / count).astype(np.uint8)
    return [judged(look, film, mean, reader, watched) for look in found]


def of_video(
    video: Path, model: Model, rig: Rig, bag: Path, film: VideoRecord, layers: PictureLayers, *, exposure: float
) -> list[Judged]:
    """Frames of a film that a model and the film's layers predict from the inputs in its bag; see :func:`foreseen`.

    Raises UserError where film and bag were not synchronised, too.
    """
    time = film.synchronisation
    if time is None:
        raise UserError(f"{video}: without a bag there are no inputs to predict by: give the bag, too")
    positions = np.where(film.filled, np.nan, film.positions)
    watched = SeenMotion(times=time.time(film.footage.times), seen=time.time(film.footage.seen), positions=positions)
    known = calibrated(layers, film)
    drawn = PictureModel(model=model, renderer=LayerRenderer(known, exposure=exposure))
    record = bags.read(bag, rig.signals, period=model.sampling.step)
    return foreseen(film.footage.view or FilmView(path=video), drawn, rig, record, watched, AngleReader(known))


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Predicted frames some seconds ahead, together; likenesses are means, errors rms [rad]."""

    ahead: float
    count: int
    likeness: float
    mean: float
    still: float
    error: float
    shown: float
    inside: float
    """Share of the positions within twice the deviation that was predicted."""

    @classmethod
    def of(cls, rows: Sequence[Judged], ahead: float) -> Summary:
        """Those so far ahead [s]."""
        chosen = [row for row in rows if row.look.ahead == ahead]
        errors = np.array([row.error for row in chosen])
        shown = np.array([row.shown for row in chosen])
        known = np.isfinite(errors)
        inside = np.abs(errors) <= 2.0 * np.array([row.look.deviation for row in chosen])
        return cls(
            ahead=ahead,
            count=len(chosen),
            likeness=float(np.mean([row.likeness for row in chosen])),
            mean=float(np.mean([row.mean for row in chosen])),
            still=float(np.mean([row.still for row in chosen])),
            error=float(np.sqrt(np.mean(errors[known] ** 2))),
            shown=float(np.sqrt(np.mean(shown[known] ** 2))),
            inside=float(np.mean(inside[known])),
        )
