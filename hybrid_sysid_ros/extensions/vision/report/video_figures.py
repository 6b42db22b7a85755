"""Figures of a film: positions beside the bag's own, what is left between them, the lamp; and pictures."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.shared.report.charts import (
    BOUND,
    ERROR,
    MEASURED,
    MODEL,
    REFERENCE,
    line,
    panels,
    timed,
)
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.prediction.image_prediction import Judged
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReading
from hybrid_sysid_ros.extensions.vision.reading.film_check import FilmCheck
from hybrid_sysid_ros.extensions.vision.reading.joint_reference import MotionSource
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.synchronisation import low_passed
from hybrid_sysid_ros.extensions.vision.reading.video_record import VideoRecord

STRETCHED = 6.0  # times that what is left of a picture is shown


def positions(record: VideoRecord) -> go.Figure:
    """Positions by the camera and by the bag's sensor, and below them their difference [degrees], which is that of the
    synchronisation: what is faster than its low-pass (a hum, which frames would show as an offset) is left out.
    """
    figure = panels(heights=[0.65, 0.35], height=480)
    seconds = (record.stamps - record.stamps[0]) * 1e-9
    reference = record.reference
    if reference is not None and reference.kind is MotionSource.POSITION and record.synchronisation is not None:
        times, encoder = reference.times, reference.values
        begin = float(record.synchronisation.time(record.footage.seen[:1])[0])
        line(figure, 1, times - begin, np.degrees(encoder), "encoder", REFERENCE)
        smooth = low_passed(encoder, float(np.median(np.diff(times))))
        left = record.positions - np.interp(seconds + begin, times, smooth, left=np.nan, right=np.nan)
        line(figure, 2, seconds, np.degrees(left), "camera less encoder", ERROR)
    line(figure, 1, seconds, np.degrees(record.positions), "camera", MODEL)
    line(figure, 2, seconds, np.degrees(record.footage.deviations), "standard deviation", BOUND)
    figure.update_yaxes(title="position [°]", row=1, col=1, secondary_y=False)
    figure.update_yaxes(title="[°]", row=2, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, secondary_y=True)
    return timed(figure, 2)


def lamp(record: VideoRecord) -> go.Figure:
    """Brightness of the lamp over the film's time."""
    figure = panels(heights=[1.0], height=220)
    line(figure, 1, record.footage.times, record.footage.lamp, "lamp", MEASURED)
    if record.onset is not None:
        figure.add_vline(x=record.onset.time, line={"color": BOUND, "width": 1})
        figure.update_xaxes(range=[record.onset.time - 0.5, record.onset.time + 0.5])
    figure.update_yaxes(title="[counts]", row=1, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, secondary_y=True)
    return timed(figure, 1)


def checked(check: FilmCheck) -> str:
    """The median picture of a film, what moves in it red and what stands by which the camera is known green, as a PNG
    for a page.
    """
    colours = np.repeat(check.picture[:, :, None], 3, axis=2)
    colours[check.moving, 0] = np.maximum(colours[check.moving, 0], 160)
    for x, y in np.rint(check.features).astype(int):
        colours[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2] = (24, 160, 88)
    return png(colours)


def overlaid(picture: Picture, reading: AngleReading, layers: PictureLayers) -> str:
    """A picture with the outline of the sprite where it was found, as a PNG for a page."""
    return _outlined(picture, layers, [reading.angle] if reading.found else [])


def expected(picture: Picture, row: Judged, layers: PictureLayers) -> str:
    """A picture with the outline of the sprite where it was predicted, as a PNG for a page."""
    return _outlined(picture, layers, [float(layers.angle(np.float64(row.look.position)))])


def banded(picture: Picture, row: Judged, layers: PictureLayers) -> str:
    """A picture with the outlines of the sprite two deviations off, as a PNG for a page."""
    ends = row.look.position + 2.0 * row.look.deviation * np.array([-1.0, 1.0])
    return _outlined(picture, layers, layers.angle(ends).tolist())


def _outlined(picture: Picture, layers: PictureLayers, angles: Sequence[float]) -> str:
    colours = np.repeat(picture[:, :, None], 3, axis=2)
    down, across = np.nonzero(_edge(layers.alpha))
    u, v = across + layers.first[0], down + layers.first[1]
    for angle in angles:
        c, s = math.cos(angle), -math.sin(angle)
        x = np.rint(layers.pivot[0] + u * c - v * s).astype(int)
        y = np.rint(layers.pivot[1] + u * s + v * c).astype(int)
        inside = (x >= 0) & (y >= 0) & (x < picture.shape[1]) & (y < picture.shape[0])
        colours[y[inside], x[inside]] = (232, 113, 10)
    return png(colours)


def left(picture: Picture, reading: AngleReading, layers: PictureLayers) -> str:
    """What the layers do not explain of a picture, STRETCHED about grey, as a PNG for a page."""
    angle = reading.angle if reading.found else layers.geometry.low
    drawn = layers.drawn(angle)
    light = float(np.median(picture[drawn > 8.0] / drawn[drawn > 8.0]))
    shown = np.clip(128.0 + STRETCHED * (picture - light * drawn), 0.0, 255.0).astype(np.uint8)
    return png(np.repeat(shown[:, :, None], 3, axis=2))


def _edge(alpha: NDArray[np.float32]) -> NDArray[np.bool_]:
    inside = alpha > 0.5
    core = inside.copy()
    for axis in (0, 1):
        core &= np.roll(inside, 1, axis) & np.roll(inside, -1, axis)
    return np.asarray(inside & ~core)


def png(colours: NDArray[np.uint8]) -> str:
    """Colours (rows, columns, 3) as the address of a PNG that carries itself (W3C PNG, 2003)."""
    rows, columns, _ = colours.shape
    raw = b"".join(b"\0" + row.tobytes() for row in colours)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0))
    content = b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(raw, 6)) + chunk(b"IEND", b"")
    return "data:image/png;base64," + base64.b64encode(content).decode()
