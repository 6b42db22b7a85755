"""Film quantity: a number that was read out of a film, with its standard deviation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.extensions.vision.reading.video_record import VideoRecord


@dataclass(frozen=True)
class FilmQuantity:
    """A number, as terminal, JSON and page show it; value and deviation are None where there are none."""

    name: str
    value: float | None
    deviation: float | None
    unit: str
    digits: int
    """Behind the point."""

    @property
    def texts(self) -> tuple[str, str]:
        """Value and deviation."""
        value, deviation = (
            "" if number is None else f"{number:.{self.digits}f}" for number in (self.value, self.deviation)
        )
        return value, deviation


def film_quantities(record: VideoRecord) -> list[FilmQuantity]:
    """Numbers of a film: its pictures, and how it was put in a bag's time."""
    footage, found = record.footage, record.synchronisation
    finite = footage.deviations[np.isfinite(footage.deviations)]
    rows = [
        FilmQuantity("pictures", len(footage.times), None, "", 0),
        FilmQuantity("rate", footage.rate, None, "1/s", 4),
    ]
    if len(finite):
        usual = math.degrees(float(np.sqrt(np.mean(finite**2))))
        rows.append(FilmQuantity("angle of a picture, rms", None, usual, "degrees", 4))
    if record.onset is not None:
        rows.append(FilmQuantity("lamp on", record.onset.time, record.onset.deviation, "s of the film", 5))
    if found is not None:
        shift, rate, scale, offset = found.deviations.tolist()
        rows += [
            FilmQuantity("shift", found.shift, shift, "s", 6),
            FilmQuantity("clock", 1e6 * found.rate, 1e6 * rate, "ppm", 2),
            FilmQuantity("scale", found.scale, scale, "", 5),
            FilmQuantity("offset", math.degrees(found.offset), math.degrees(offset), "degrees", 4),
            FilmQuantity("camera less encoder, rms", math.degrees(found.residual), None, "degrees", 4),
        ]
    return rows
