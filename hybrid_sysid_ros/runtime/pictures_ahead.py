"""Pictures ahead: what a camera will see some seconds on, by an identified motion and a renderer of its picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import Generator

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.camera.film import pictures
from hybrid_sysid_ros.camera.imager import Picture
from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.estimation import Estimate, ExtendedKalmanFilter
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration, sight
from hybrid_sysid_ros.runtime.configuration import CAMERA
from hybrid_sysid_ros.runtime.video_record import VideoRecord, calibrated
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.vision.angle_reader import AngleReader
from hybrid_sysid_ros.vision.layers import KIND, Layers
from hybrid_sysid_ros.vision.likeness import structural_similarity
from hybrid_sysid_ros.vision.renderer import LayerRenderer, Renderer

AHEAD = (0.5, 1.0, 2.0)
"""s, how far pictures are looked at."""
SETTLED = 2.0  # s of a film that are watched before the first prediction
APART = 1.0  # s between two predictions
SHUTTER = 0.03  # s, within which a picture's last row is exposed
MEMBERS = 32
"""Motions that a band is told by."""


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
        model, layers = load_model(folder, rig=rig), Layers.load(Path(folder) / KIND)
        if layers.geometry.rig != model.rig:
            raise UserError(f"{folder}: the model is of {model.rig}, its layers are of {layers.geometry.rig}")
        return cls(model=model, renderer=LayerRenderer(layers, exposure=exposure))


@dataclass(frozen=True, kw_only=True, eq=False)
class Watched:
    """What a camera saw of a record: (frames,) each."""

    times: Array
    """Middle of the exposure of the middle row, in the record's time [s]."""
    seen: Array
    """When the joint was where it was read [s]."""
    positions: Array
    """[rad]; NaN where the joint was not found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
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
    picture: Picture


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A predicted frame beside what came."""

    look: Look
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
    model: PictureModel, rig: Rig, record: Record, watched: Watched, *, noise: float, ahead: Sequence[float] = AHEAD,
    seed: int = 0,
) -> Iterator[Look]:  # fmt: skip
    """Frames that a model predicts ``ahead`` [s] from what the camera had shown before, and the inputs on the way.

    An extended Kalman filter with the rig's own tuning follows the frames alone; the record's outputs are not looked
    at. record: sampled at the model's step. noise: deviation of a frame, in the unit of the first output; see
    :func:`.sight.frame_noise`. seed: of the motions that the band is told by.
    """
    system, step, settings = model.model.system, record.sampling_time, configuration.defaults(rig, "estimator")
    tuning = configuration.estimator_tuning({**settings, "camera_noise": noise}, rig, system)
    estimator = ExtendedKalmanFilter(system, tuning, period=step)
    unmeasured, random = np.full(len(system.outputs), np.nan), np.random.default_rng(seed)
    place = [item.name for item in system.states].index(rig.system.outputs[0].name)
    used, due, steps = int(np.searchsorted(watched.seen, -step)), SETTLED, math.ceil((max(ahead) + SHUTTER) / step)
    following: Array = step * np.arange(steps + 1, dtype=np.float64)
    begun = False
    for k in range(record.samples - steps):
        time = float(record.time[k])
        estimate: Estimate | None = None
        if begun:
            estimate = estimator.update(time, unmeasured, record.input[max(k - 1, 0)])
        while used < len(watched.seen) and watched.seen[used] <= time:
            if math.isfinite(watched.positions[used]):
                estimate, begun = estimator.correct(watched.seen[used], watched.positions[used], CAMERA), True
            used += 1
        if estimate is None or time < due or not used:
            continue
        due += APART
        past = math.ceil(system.delay / step) + 1
        inputs = record.input[np.clip(np.arange(k - past, k + steps), 0, None)]
        paths = _paths(system, estimate, tuning, inputs, past, step, random)[:, :, place]
        deviations = np.sqrt(np.mean((paths[1:] - paths[0]) ** 2, axis=0))
        for wanted in ahead:
            frame = int(np.searchsorted(watched.times, watched.times[used - 1] + wanted - 0.5 * step))
            if frame == len(watched.times) or watched.times[frame] - time > following[-1]:
                continue
            yield Look(
                frame=frame,
                newest=used - 1,
                ahead=wanted,
                position=float(np.interp(watched.seen[frame] - time, following, paths[0])),
                deviation=float(np.interp(watched.seen[frame] - time, following, deviations)),
                picture=model.renderer.take(watched.times[frame] - time, following, paths[0]),
            )


def _paths(
    system: System, estimate: Estimate, tuning: Tuning, inputs: Array, past: int, step: float, random: Generator
) -> Array:
    """States (1 + MEMBERS, samples, states) from an estimate on: as it says, then as it may be: states and offset of
    the input by its covariance, the offset drifting and the input as noisy as the tuning says.
    """
    n, m, count = len(system.states), len(system.inputs), 1 + MEMBERS
    size, steps = n + m, len(inputs)
    covariance = estimate.covariance[:size, :size]
    values, vectors = np.linalg.eigh(covariance)
    spread = random.standard_normal((count, size)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    spread[0] = 0.0
    begins = estimate.state + spread[:, :n]
    drift = np.sqrt(step) * np.array(tuning.disturbance_noise) * random.standard_normal((count, steps, m))
    rough = np.array(tuning.input_noise) / np.sqrt(step) * random.standard_normal((count, steps, m))
    drift[0] = rough[0] = 0.0
    drift[:, :past] = rough[:, :past] = 0.0
    offset = estimate.disturbance + spread[:, None, n:] + np.cumsum(drift, axis=1)
    given = (inputs + offset + rough).reshape(count * steps, m)
    samples = 1 + steps - past
    starts = np.array([[j * steps, j * steps + past, samples, j * samples] for j in range(count)])
    states, _ = rollouts(system, starts, begins, np.ascontiguousarray(given), step=step)
    return states.reshape(count, samples, n)


def judged(found: Look, film: Mapping[int, Picture], mean: Picture, reader: AngleReader, watched: Watched) -> Judged:
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
    video: Path, model: PictureModel, rig: Rig, record: Record, watched: Watched, reader: AngleReader
) -> list[Judged]:
    """Frames of a film that a model predicts, beside what came; the mean picture is that of the whole film. Raises
    UserError where the film can't be read, or is too short to predict anything.
    """
    noise = sight.frame_noise(rig, reader.layers.background.shape[1])
    found = list(looks(model, rig, record, watched, noise=noise))
    if not found:
        raise UserError(f"{video}: is too short to predict {max(AHEAD):g} s of it: {SETTLED + max(AHEAD) + APART:g} s")
    wanted = {number for look in found for number in (look.frame, look.newest)}
    film, total, count = dict[int, Picture](), np.zeros(reader.layers.background.shape), 0
    for count, (_, picture) in enumerate(pictures(video), start=1):
        total += picture
        if count - 1 in wanted:
            film[count - 1] = picture
    mean = np.round(total / count).astype(np.uint8)
    return [judged(look, film, mean, reader, watched) for look in found]


def of_video(
    video: Path, model: Model, rig: Rig, bag: Path, film: VideoRecord, layers: Layers, *, exposure: float
) -> list[Judged]:
    """Frames of a film that a model and the film's layers predict from the inputs in its bag; see :func:`foreseen`.

    Raises UserError where film and bag were not synchronised, too.
    """
    time = film.synchronisation
    if time is None:
        raise UserError(f"{video}: without a bag there are no inputs to predict by: give the bag, too")
    positions = np.where(film.filled, np.nan, film.positions)
    watched = Watched(times=time.time(film.footage.times), seen=time.time(film.footage.seen), positions=positions)
    known = calibrated(layers, film)
    drawn = PictureModel(model=model, renderer=LayerRenderer(known, exposure=exposure))
    record = bags.read(bag, rig.signals, period=model.sampling.step)
    return foreseen(video, drawn, rig, record, watched, AngleReader(known))


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
    """Share of the positions within twice the deviation that was told."""

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
