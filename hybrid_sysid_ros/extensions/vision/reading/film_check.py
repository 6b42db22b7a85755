"""Film check: what a film lacks to be read well, before anything is read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.film import FilmFormat, format_of, pictures
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.reading.focus import sharpness, soft_pictures
from hybrid_sysid_ros.extensions.vision.reading.footage import picked
from hybrid_sysid_ros.extensions.vision.reading.learning import BURNT, DARK_FILM, FEWEST, NARROWEST, WHITE
from hybrid_sysid_ros.extensions.vision.reading.regression import Film
from hybrid_sysid_ros.extensions.vision.reading.turning_point import ELSEWHERE, turning_point
from hybrid_sysid_ros.extensions.vision.reading.video_record import MOST_FILLED
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LOOKED_AT = 60  # pictures
SLOW = 20.0  # pictures a second
SQUEEZED = 0.02  # bits a pixel of each picture: a codec leaves little of edges that move
CHANGES = 0.3  # of the light, from picture to picture
FAINT, CLEAR = 5.0, 12.0  # times its noise by which the joint differs from what is behind it, at most pixels
MOVES = 6.0  # times the noise by which a pixel changes that the joint comes over
LITTLE = 2e-4  # share of the pixels that such pixels are at least
SMEARED = 6.0  # pixels of 640 in an exposure
SHAKES = 0.3  # pixels of 640, rms
UNSURE = 0.02  # widths: by which two halves of a film differ in the place about which it turns
NOWHERE = 0.1  # widths, the same: there is no such place
OBLIQUE = 0.02  # relative difference of opposite sides of the marks


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that a film needs, and what to do where it has it not."""

    what: str
    found: str
    advice: str = ""
    """Empty where it is good."""
    bad: bool = False
    """Whether the film can't be read as it is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FilmCheck:
    """What a film has and lacks."""

    findings: tuple[Finding, ...]
    picture: Picture
    """The median of its pictures."""
    moving: NDArray[np.bool_]
    """Pixels that something comes over."""
    features: NDArray[np.float32]
    """Places (features, 2) that stand still, by which the camera's motion is measured."""
    pivot: Array | None = None
    """Place (2,) about which something turns [widths]; None where none is found."""


def film_check(
    view: FilmView, *, exposure: float, marks: Array | None, clicked: tuple[float, ...] | None = None
) -> FilmCheck:
    """Look at a film. exposure: of a row [s]. marks: corners of a rectangle (4, 2) [pixels]. clicked: where somebody
    said that the pivot is (2,) [widths].

    Raises UserError where the film can't be read at all.
    """
    times, sizes, changes, sharp, before = list[float](), set[tuple[int, ...]](), list[float](), list[float](), None
    form = format_of(view.path)
    for time, picture in pictures(view.path):
        times.append(time)
        sizes.add(picture.shape)
        few = picture[::4, ::4].astype(np.float32)
        changes.append(float(np.abs(few - before).mean()) if before is not None and before.shape == few.shape else 0.0)
        sharp.append(sharpness(picture))
        before = few
    findings = [*_size_and_rate(view.path, form, np.array(times), sizes)]
    if any(finding.bad for finding in findings):
        nothing = np.zeros(next(iter(sizes)), dtype=np.uint8)
        return FilmCheck(
            findings=tuple(findings), picture=nothing, moving=nothing > 0, features=np.zeros((0, 2), dtype=np.float32)
        )
    try:
        steadied, refusal = view.steadied(), ""
    except UserError as error:
        steadied, refusal = view, str(error)
    film = picked(steadied, LOOKED_AT)
    median = np.median(film, axis=0).astype(np.uint8)
    findings += [*_light(film, median), *_focus(np.array(times), np.array(sharp)), *_tripod(steadied, refusal)]
    noise = max(float(np.median(np.abs(film[::5].astype(np.float32) - median))) / 0.6745, 0.7)
    spread = np.percentile(film[:, ::2, ::2], 95, axis=0) - np.percentile(film[:, ::2, ::2], 5, axis=0)
    moving = np.kron(spread > MOVES * noise, np.ones((2, 2), dtype=bool))[: median.shape[0], : median.shape[1]]
    turns = turning_point(steadied)
    joint = _joint(film, median, moving, noise, turns=turns is not None)
    unknown = Finding(what="exposure", found="unknown: nothing is seen to move", advice="let the joint be seen to move")
    if not refusal:  # a joint is not judged by pictures of a camera that was moved
        findings += [joint, *([unknown] if joint.bad else _blur(steadied, moving, changes, exposure))]
        findings += [_pivot(turns, clicked, round(median.shape[1] / form.scale)), _square(marks)]
    motion = steadied.motion
    return FilmCheck(
        findings=tuple(findings), picture=median, moving=moving,
        features=motion.features if motion is not None else np.zeros((0, 2), dtype=np.float32),
        pivot=turns[0] if turns is not None else None,
    )  # fmt: skip


def _size_and_rate(path: Path, form: FilmFormat, times: Array, sizes: set[tuple[int, ...]]) -> Iterator[Finding]:
    rows, columns = next(iter(sizes))
    small = columns < NARROWEST
    yield Finding(
        what="size", bad=small or len(sizes) > 1,
        found=f"{columns / form.scale:.0f}x{rows / form.scale:.0f} pixels"
        + (f", read as {columns}x{rows}" if form.scale < 1.0 else ""),
        advice="its pictures change their size: cut it there" if len(sizes) > 1
        else f"take {NARROWEST} columns at least, better 640" if small
        else "",
    )  # fmt: skip
    apart = np.diff(times)
    rate = 1.0 / float(np.median(apart)) if len(apart) else 0.0
    seconds = float(times[-1] - times[0])
    long, slow = len(times) >= FEWEST, rate < SLOW
    yield Finding(
        what="rate", found=f"{rate:.4g} pictures/s, {len(times)} in {seconds:.3g} s", bad=not long,
        advice=f"what is faster than {rate / 4:.2g} Hz is not seen: film at 30 pictures/s or more" if long and slow
        else f"film for ten seconds at least; {FEWEST} pictures are needed" if len(times) < 2 * LOOKED_AT
        else "",
    )  # fmt: skip
    bits = 8.0 * path.stat().st_size / (len(times) * form.height * form.width)
    yield Finding(
        what="compression", found=f"{form.codec}, {bits:.2g} bits a pixel",
        advice="a codec that saves so much blurs what moves: record with more bits a second" if bits < SQUEEZED else "",
    )  # fmt: skip


def _light(film: Film, median: Picture) -> Iterator[Finding]:
    mean, burnt = float(median.mean()), float((median >= WHITE).mean())
    lights = film[:, ::8, ::8].reshape(len(film), -1).mean(axis=1)
    change = float(np.ptp(lights)) / max(mean, 1.0)
    advice = ""
    if mean < DARK_FILM:
        advice = "it is dark: more light, or a longer exposure as far as the motion allows it"
    elif burnt > BURNT:
        advice = f"{burnt:.0%} of the pixels are white: less light, or a shorter exposure"
    elif change > CHANGES:
        advice = f"the light changes by {change:.0%}: lock the exposure of the camera"
    yield Finding(what="light", found=f"{mean:.0f} of 255 counts", advice=advice, bad=mean < DARK_FILM / 4)


def _focus(times: Array, sharp: Array) -> Iterator[Finding]:
    """By how sharp pictures (pictures,) at times [s] are; of a film that is all blurred only reading it tells."""
    soft = times[soft_pictures(sharp)]
    if len(soft):
        yield Finding(
            what="focus", found=f"{len(soft)} pictures from {soft[0]:.3g} to {soft[-1]:.3g} s are out of it",
            advice="lock the focus of the camera, and cut the film there", bad=len(soft) > MOST_FILLED,
        )  # fmt: skip


def _tripod(view: FilmView, refusal: str) -> Iterator[Finding]:
    motion = view.motion
    if refusal:
        yield Finding(what="tripod", found="moved", advice=refusal, bad=True)
    elif motion is None:
        yield Finding(
            what="tripod", found="unknown: too little that stands still has contrast",
            advice="a tripod, or a wall with a pattern: a shaking camera can't be told from the joint",
        )  # fmt: skip
    else:
        shakes = motion.shake > SHAKES * motion.width / 640.0
        yield Finding(
            what="tripod", found=f"moves by {motion.shake:.2g} pixels, rms ({len(motion.features)} features)",
            advice="it is taken out, at the cost of sharpness: a tripod is better" if shakes else "",
        )  # fmt: skip


def _joint(film: Film, median: Picture, moving: NDArray[np.bool_], noise: float, *, turns: bool) -> Finding:
    """How clearly the joint is seen to move. turns: whether anything does; a codec changes faint pixels at rest."""
    differences = np.abs(film[:, moving].astype(np.float32) - median[moving]).max(axis=0)
    contrast = float(np.median(differences)) / noise if moving.any() else 0.0
    if moving.mean() < LITTLE or (contrast < CLEAR and not turns):
        return Finding(
            what="motion", found="nothing moves that can be seen", bad=True,
            advice="move the rig, and let the joint differ from what is behind it",
        )  # fmt: skip
    return Finding(
        what="contrast", found=f"{contrast:.0f} times the noise of {noise:.2g} counts", bad=contrast < FAINT,
        advice="a joint of another brightness than the wall, more light" if contrast < CLEAR else "",
    )  # fmt: skip


def _blur(view: FilmView, moving: NDArray[np.bool_], changes: list[float], exposure: float) -> Iterator[Finding]:
    """How far the joint moves in an exposure, by the dense flow between the pictures that differ most."""
    import cv2

    wanted = set(np.argsort(changes)[-5:].tolist())
    flows, before, rate, last = list[float](), None, 0.0, 0.0
    for number, (time, picture) in enumerate(view.pictures()):
        if number in wanted and before is not None and moving.any():
            scale = max(picture.shape[1] // 480, 1)
            small = [np.ascontiguousarray(item[::scale, ::scale]) for item in (before, picture)]
            nothing = np.zeros((*small[0].shape, 2), dtype=np.float32)
            flow = cv2.calcOpticalFlowFarneback(small[0], small[1], nothing, 0.5, 4, 21, 3, 5, 1.1, 0)
            inside = moving[::scale, ::scale]
            flows.append(scale * float(np.percentile(np.hypot(flow[..., 0], flow[..., 1])[inside], 98)))
            rate = 1.0 / max(time - last, 1e-6)
        before, last = picture, time
    if not flows:
        return
    moved = float(np.median(flows))
    smear = moved * min(exposure * rate, 1.0)
    smeared = smear > SMEARED * moving.shape[1] / 640.0
    yield Finding(
        what="exposure", found=f"up to {moved:.2g} pixels from one picture to the next, {smear:.2g} in {exposure:g} s",
        advice="a shorter exposure, with more light" if smeared else "",
    )  # fmt: skip


def _pivot(turns: tuple[Array, Array] | None, clicked: tuple[float, ...] | None, columns: int) -> Finding:
    if turns is None:
        advice = "the scene's pivot is used: say where it is (--pivot X,Y), or click it"
        return Finding(what="pivot", found="unknown: too little turns", advice=advice)
    (x, y), apart = turns[0] * columns - 0.5, float(np.hypot(*turns[1])) * columns
    if apart > NOWHERE * columns:
        advice = "is it the rig? The scene's pivot is used: say where it is (--pivot X,Y), or click it"
        return Finding(what="pivot", found="unknown: halves of the film turn about places far apart", advice=advice)
    advice = "say where it is (--pivot X,Y), or click it" if apart > UNSURE * columns else ""
    if clicked is not None:  # which counts
        beside = float(np.hypot(*(turns[0] - clicked))) * columns
        other = beside > max(ELSEWHERE * columns, 4.0 * apart)
        advice = f"{beside:.0f} pixels beside what was said: let nothing else move in the film" if other else ""
    return Finding(
        what="pivot", found=f"turns about {x:.0f},{y:.0f} pixels; halves of the film differ by {apart:.1f}",
        advice=advice,
    )  # fmt: skip


def _square(marks: Array | None) -> Finding:
    if marks is None:
        return Finding(
            what="square view", found="unknown: no marks",
            advice="look along the joint's axis, or click the four corners of a rectangle in the plane of the motion",
        )  # fmt: skip
    sides = np.hypot(*(np.roll(marks, -1, axis=0) - marks).T)
    apart = float(np.max(np.abs(sides[:2] - sides[2:]) / (0.5 * (sides[:2] + sides[2:]))))
    return Finding(
        what="square view", found=f"opposite sides of the marks differ by {apart:.1%}",
        advice="it is put right by the marks" if apart > OBLIQUE else "",
    )  # fmt: skip
