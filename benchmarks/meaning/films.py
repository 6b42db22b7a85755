"""Films: 42 of the second renderer, read as ``hybrid-sysid video`` does.

A run lasts a quarter of an hour; the next one goes on from the answers in out/meaning_films.json, unless the code that
films or reads has changed since. Films that are not read yet count as read wrongly.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.meaning.film_cases import SOUND, SPOILT
from benchmarks.meaning.rows import Row
from benchmarks.meaning.second_renderer import FilmCase, SecondRenderer, write
from benchmarks.resumed import digest, resumed
from hybrid_sysid_ros.extensions.vision.camera.filming import experiment
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.reading.footage import followed, picked
from hybrid_sysid_ros.extensions.vision.reading.learning import learn
from hybrid_sysid_ros.extensions.vision.reading.turning_point import with_turning_point
from hybrid_sysid_ros.extensions.vision.reading.video_record import VideoRecord, joined
from hybrid_sysid_ros.extensions.vision.scene import scene_of, with_pivot
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.errors import UserError

PART = Path("out/meaning_films.json")
READING = tuple(f"hybrid_sysid_ros/extensions/vision/{place}" for place in ("reading", "camera", "scene.py"))
CODE = (*READING, *(f"benchmarks/meaning/{name}.py" for name in ("films", "film_cases", "second_renderer")))
"""What sets the answers."""
CLICK = 0.006
"""Widths that a clicked pivot is off."""
RIGHTLY, WORST, LEVEL, INSIDE, SHAKE = 0.95, 0.03, 1.645, (0.85, 0.95), "one pixel of shake"
"""Asked: share of the films that are read or refused rightly; error of an accepted one [degrees rms]; share of the
pictures inside their 90 % intervals; the names of those with a pixel of shake begin so."""


def read(film: Path, rig: Rig, bag: Path | None, case: FilmCase) -> VideoRecord:
    """As the command does, without layers. Raises UserError as it does."""
    view = FilmView(path=film).steadied()
    if case.clicked:
        rig = with_pivot(rig, (case.pivot[0] + CLICK, case.pivot[1] - CLICK))
    else:
        rig, _ = with_turning_point(view, rig)
    layers, _ = learn(picked(view), rig, readout=case.readout, sized=not case.clicked, steadied=view.motion is not None)
    footage = followed(view, AngleReader(layers), None)
    return joined(footage, layers, rig, bag, exposure=case.exposure)


def answer(case: FilmCase) -> dict[str, Any]:
    """Errors of a film that is accepted [degrees], or why it is refused."""
    rig = load(case.rig)
    reach = max(patch.reach for patch in scene_of(rig).sprite)
    with TemporaryDirectory() as folder:
        bag, film = Path(folder) / "bag", Path(folder) / "film.mp4"
        motion = experiment(rig, case.kind, bag, seed=case.seed, duration=case.seconds, rate=200.0)
        renderer = SecondRenderer(case, motion.times, motion.angles, reach)
        write(film, renderer)
        try:
            record = read(film, load(case.read_as or case.rig), None if case.read_as else bag, case)
        except UserError as refusal:
            return {"refused": str(refusal)}
    footage = record.footage
    known = np.isfinite(footage.angles)
    error = np.degrees(record.positions - renderer.truth(footage.seen))[known]
    error -= error.mean()  # the zero is a gauge
    deviation = np.degrees(footage.deviations[known])
    return {
        "rms": float(np.sqrt(np.mean(error**2))),
        "stated": float(np.sqrt(np.mean(deviation**2))),
        "inside": float(np.mean(np.abs(error) <= LEVEL * deviation)),
        "lost": float(1.0 - known.mean()),
    }


def rightly(case: FilmCase, found: Mapping[str, Any]) -> bool:
    """Whether a film was refused for its reason, or read well."""
    if case.wrong:
        return re.search(case.wrong, found.get("refused", "")) is not None
    return bool(found.get("rms", np.inf) <= WORST)


def measured() -> tuple[Mapping[str, Any], list[Row]]:
    """All films, as far as they are read."""
    cases, code = (*SOUND, *SPOILT), digest(*CODE)
    found = resumed(PART, (("films", case.name, partial(answer, case)) for case in cases), code)["films"]
    accepted = {name: item for name, item in found.items() if "rms" in item}
    inside = [item["inside"] for item in accepted.values()]
    shaken = [item.get("rms", 0.0) for name, item in found.items() if name.startswith(SHAKE)]
    wrongly = [case.name for case in cases if not rightly(case, found.get(case.name, {}))]
    rows = [
        Row(name=f"films not read yet, of {len(cases)}", asked=0, measured=len(cases) - len(found), at_most=True),
        Row(
            name=f"films read or refused rightly, share of {len(cases)}", asked=RIGHTLY,
            measured=1.0 - len(wrongly) / len(cases),
        ),
        Row(
            name="largest error of an accepted film [degrees rms]", asked=WORST, at_most=True,
            measured=max((item["rms"] for item in accepted.values()), default=0.0),
        ),
        Row(name="pictures inside their 90 % intervals, mean of the films", asked=INSIDE[0], measured=_mean(inside)),
        Row(name="the same, at most", asked=INSIDE[1], measured=_mean(inside), at_most=True),
        Row(
            name="error under a pixel of shake [degrees rms]", asked=WORST, at_most=True,
            measured=max(shaken, default=np.nan),
        ),
    ]  # fmt: skip
    return {"code": code, "films": found, "wrongly": [name for name in wrongly if name in found]}, rows


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else np.nan
