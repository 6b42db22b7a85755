"""hybrid-sysid video: a film of a rig becomes a bag."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands.options import Json, Overwrite, RigName
from hybrid_sysid_ros.commands.terminal import console, print_table, status, typed
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.extensions.vision.camera.film import format_of, pictures
from hybrid_sysid_ros.extensions.vision.prediction import image_prediction
from hybrid_sysid_ros.extensions.vision.prediction.image_prediction import AHEAD, Judged, Summary
from hybrid_sysid_ros.extensions.vision.reading import video_record
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.film_check import FilmCheck, film_check
from hybrid_sysid_ros.extensions.vision.reading.film_quantity import film_quantities
from hybrid_sysid_ros.extensions.vision.reading.film_view import CLICKED, FilmView, squaring
from hybrid_sysid_ros.extensions.vision.reading.footage import Footage, followed, picked
from hybrid_sysid_ros.extensions.vision.reading.joint_reference import joint_reference
from hybrid_sysid_ros.extensions.vision.reading.layers import KIND, PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.learning import learn
from hybrid_sysid_ros.extensions.vision.reading.turning_point import with_turning_point
from hybrid_sysid_ros.extensions.vision.report.check_page import write_check
from hybrid_sysid_ros.extensions.vision.report.video_page import write_video
from hybrid_sysid_ros.extensions.vision.scene import has_scene, scene_of, with_pivot, with_scene
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file, check_folder, sha256


def command(
    video: Annotated[Path, typer.Argument(help="Film of the rig, in a format that FFmpeg reads, such as mp4 or mov.")],
    out: Annotated[Path | None, typer.Option("--out", help="Bag to write.")] = None,
    rig: RigName = "",
    check: Annotated[
        bool,
        typer.Option("--check", help="Say only what the film has and lacks, with a page to click on."),
    ] = False,
    scene_file: Annotated[
        Path | None,
        typer.Option("--scene", help="File with the scene of this film, in the place of the rig's."),
    ] = None,
    pivot: Annotated[str, typer.Option(help="Where the joint's axis is in the film: X,Y [its own pixels].")] = "",
    bag: Annotated[
        Path | None, typer.Option(help="Bag that was recorded during the film, to synchronise with.")
    ] = None,
    layers: Annotated[
        Path | None, typer.Option(help="Folder of learned layers; it is used if it exists, and written otherwise.")
    ] = None,
    again: Annotated[
        bool, typer.Option("--learn", help="Learn the layers again, and replace those in the folder.")
    ] = False,
    exposure: Annotated[float, typer.Option(help="Exposure time of a row [s].", min=0.0, max=1.0)] = 0.008,
    readout: Annotated[
        float,
        typer.Option(help="Readout time of the rolling shutter, from the first row to the last [s].", min=0.0, max=1.0),
    ] = 0.016,
    rate: Annotated[
        float,
        typer.Option(
            help="Positions per second in the bag, by a spline; 0: as often as the other bag's own samples.",
            min=0,
        ),
    ] = 0.0,
    model: Annotated[
        Path | None,
        typer.Option(
            help="Model folder: by it and the layers pictures are predicted from the bag's inputs. The layers are its "
            "own folder layers, where no other is named."
        ),
    ] = None,
    page: Annotated[Path | None, typer.Option("--report", help="HTML page to write.")] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Read a joint's angle out of a film, put it in a bag's time, and write a bag with both; predict its pictures."""
    described = load_rig(rig) if scene_file is None else with_scene(load_rig(rig), scene_file)
    if pivot:
        described = with_pivot(described, _pivot(pivot, video))
    view = FilmView(path=video)
    marks = _marks(described, video) if has_scene(described) else None
    if check:
        place = page or video.with_name(f"{video.stem}.check.html")
        clicked = scene_of(described).pivot if pivot or scene_file is not None else None
        _checked(view, described, marks, clicked, place, exposure=exposure, as_json=as_json)
        return
    if out is None:
        raise UserError("name the bag to write (--out), or look only at the film (--check)")
    if marks is not None:
        view, described = _squared(view, described, marks, scene_file or described.file)
    dynamics = None if model is None else _dynamics(model, bag, described, rig)
    layers = layers or (None if model is None else model / KIND)
    joint, tell = scene_of(described).joint, status if as_json else console
    check_folder(out, marker=bags.markers(out), replace=overwrite)
    if bag is not None:
        joint_reference(described, joint, bag)  # before the film is read, which may take a minute
    if page is not None:
        report.check_available()
        check_file(page, suffix=".html")
    record, found, ahead = _recorded(
        view, described, bag, layers, dynamics, again=again, readout=readout, exposure=exposure,
        searched=scene_file is None and not pivot, sized=not pivot,
    )  # fmt: skip
    written = video_record.at_rate(record, rate or video_record.usual_rate(record))
    video_record.write(written, described, joint, bag, out, replace=overwrite, made_by=typed())
    _print(record, ahead, as_json=as_json)
    lost = f", {record.footage.lost} of them without an angle" if record.footage.lost else ""
    tell.print(f"{out}: {len(written.stamps)} positions of {joint} from {len(record.stamps)} pictures{lost}")
    if bag is not None:
        signals = out.with_name(f"{out.name}.signals.yaml")
        video_record.write_signals(signals, described, joint)
        tell.print(f"{signals}: for hybrid-sysid identify {out} --signals {signals}")
    else:
        tell.print(f"{out} has no inputs, so no model comes of it: name the bag that was recorded meanwhile (--bag)")
    if page is not None:
        provenance = _provenance({"film": video} | ({"bag": bag} if bag is not None else {}))
        write_video(page, record, found, f"{described.name}: {video.name}", provenance, ahead=ahead)
        tell.print(f"report: {page}")


def _recorded(
    view: FilmView,
    rig: Rig,
    bag: Path | None,
    layers: Path | None,
    dynamics: Model | None,
    *,
    again: bool,
    readout: float,
    exposure: float,
    searched: bool,
    sized: bool,
) -> tuple[video_record.VideoRecord, PictureLayers, list[Judged]]:
    """Positions of a film in a bag's time, the layers by which they were read, which are saved where they are new, and
    its pictures beside those that a model predicts.
    """
    with status.status("looking how the camera moves") as spinner, _named_in_errors(view.path, bag, layers):
        kept = layers if layers is not None and (layers / f"{KIND}.yaml").exists() and not again else None
        found, footage = _read(
            view, rig, kept, readout=readout, searched=searched, sized=sized, tell=spinner.update
        )  # fmt: skip
        spinner.update("synchronising")
        record = video_record.joined(footage, found, rig, bag, exposure=exposure)
        if layers is not None and kept is None:
            (found if bag is None else video_record.calibrated(found, record)).save(layers)
        if dynamics is None or bag is None:
            return record, found, []
        spinner.update("predicting")
        ahead = image_prediction.of_video(view.path, dynamics, rig, bag, record, found, exposure=exposure)
    return record, found, ahead


def _dynamics(model: Path, bag: Path | None, rig: Rig, name: str) -> Model:
    """The model by which pictures are predicted; name: of its rig, as it was given. Raises UserError without a bag, and
    for a model of another rig.
    """
    if bag is None:
        raise UserError("--model predicts by the inputs of a bag: name it, too (--bag)")
    found = load_model(model, rig=name)
    if found.rig != rig.name:
        raise UserError(f"{model}: is a model of {found.rig}, not of {rig.name}")
    return found


def _read(
    view: FilmView, rig: Rig, layers: Path | None, *, readout: float, searched: bool, sized: bool,
    tell: Callable[[str], object],
) -> tuple[PictureLayers, Footage]:  # fmt: skip
    """Layers of a folder, or else learned from the film, and what its pictures say by them. searched: whether the pivot
    is looked for, as nobody said where it is in this film. sized: whether the scene says how large the sprite is.
    """
    if layers is not None:
        found = PictureLayers.load(layers)
        view = view.steadied(found.background)
    else:
        view = view.steadied()
        film = picked(view)  # first, as it refuses a film that is too short or changes its size
        rig, far = with_turning_point(view, rig) if searched else (rig, 0.0)
        if far:
            status.print(
                f"note: what moves turns {far:.0%} of the width beside the scene's pivot: about there it is read"
            )
        found, angles = learn(
            film, rig, readout=readout, sized=sized, steadied=view.motion is not None, clicked=not searched,
            progress=lambda stage: tell(f"learning: {stage}"),
        )  # fmt: skip
        unsure = math.hypot(found.geometry.scale_deviation, view.scale_deviation(found.pivot, angles))
        found = replace(found, geometry=replace(found.geometry, scale_deviation=unsure))
    reader, lamp = AngleReader(found), scene_of(rig).lamp
    return found, followed(view, reader, lamp, progress=lambda count: tell(f"reading: {count} pictures"))


def _print(record: video_record.VideoRecord, ahead: Sequence[Judged], *, as_json: bool) -> None:
    """Print what is odd about a film, and what was found in it."""
    notes = [*record.footage.remarks(), *video_record.contradictions(record)]
    if as_json:
        found = [asdict(item) for item in film_quantities(record)]
        console.print(
            json.dumps({"notes": notes, "found": found, "ahead": [asdict(item) for item in summaries(ahead)]})
        )
        return
    for note in notes:
        console.print(f"note: {note}")
    print_table(table_of(record))
    if ahead:
        print_table(ahead_table(ahead))


def _provenance(sources: Mapping[str, Path]) -> report.Provenance:
    """Of a page about files, by what each is: the command as it was typed, and the files' hashes."""
    hashes = {f"{kind}, {path.name}": sha256(path) for kind, path in sources.items()}
    return report.Provenance(command=typed(), hashes=hashes, versions=versions())


def _pivot(text: str, video: Path) -> tuple[float, float]:
    """Widths of the picture by pixels. Raises UserError for what is no place in it."""
    columns, rows = (round(side / format_of(video).scale) for side in _size(video))
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise UserError(f"--pivot {text}: give two numbers of pixels, such as --pivot 320,180") from None
    if not (-columns < x < 2 * columns and -rows < y < 2 * rows):
        raise UserError(f"--pivot {text}: is far outside of the pictures of {columns}x{rows} pixels")
    return (x + 0.5) / columns, (y + 0.5) / columns


def _size(video: Path) -> tuple[int, int]:
    """Columns and rows of a film's pictures as they are read."""
    _, picture = next(pictures(video))
    return picture.shape[1], picture.shape[0]


def _marks(rig: Rig, video: Path) -> Array | None:
    """Corners (4, 2) of the scene's rectangle [pixels]; None without one."""
    marks = scene_of(rig).marks
    return np.reshape(marks, (4, 2)) * _size(video)[0] - 0.5 if marks else None


def _squared(view: FilmView, rig: Rig, marks: Array, named: Path) -> tuple[FilmView, Rig]:
    """The film as if it were seen squarely, by a homography from its marks, and the rig with its pivot there; named:
    the file that marks and rectangle are from.
    """
    scene, columns = scene_of(rig), _size(view.path)[0]
    with _named_in_errors(named):
        square = squaring(marks, scene.rectangle)
        beside = CLICKED * np.eye(marks.size).reshape(-1, *marks.shape)
        squares = tuple(squaring(marks + off, scene.rectangle) for off in beside)
    x, y = (np.array(scene.pivot) * columns - 0.5).tolist()
    there = square @ np.array([x, y, 1.0])
    x, y = ((there[:2] / there[2] + 0.5) / columns).tolist()
    return FilmView(path=view.path, square=square, squares=squares), with_pivot(rig, (x, y))


def _checked(
    view: FilmView, rig: Rig, marks: Array | None, clicked: tuple[float, ...] | None, page: Path, *, exposure: float,
    as_json: bool,
) -> None:  # fmt: skip
    """Print what a film has and lacks, and write the page."""
    report.check_available()
    check_file(page, suffix=".html")
    with status.status("looking at the film"), _named_in_errors(view.path):
        found = film_check(view, exposure=exposure, marks=marks, clicked=clicked)
    if as_json:
        console.print(json.dumps([asdict(finding) for finding in found.findings], indent=2))
    else:
        print_table(_check_table(found, view.path.name))
    written = write_check(page, found, view.path, rig, _provenance({"film": view.path}))
    (status if as_json else console).print(f"page to click pivot, tip and marks on: {written}")


def _check_table(found: FilmCheck, name: str) -> Table:
    table = Table("", "found", "what to do", title=name)
    for finding in found.findings:
        style = "red" if finding.bad else "yellow" if finding.advice else ""
        advice = f"can't be read as it is: {finding.advice}" if finding.bad else finding.advice or "good"
        table.add_row(finding.what, finding.found, advice, style=style)
    return table


@contextmanager
def _named_in_errors(file: Path, *others: Path | None) -> Iterator[None]:
    """A refusal names a file, where it does not name that or another one already."""
    try:
        yield
    except UserError as error:
        if str(error).startswith(tuple(str(place) for place in (file, *others) if place)):
            raise
        raise UserError(f"{file}: {error}") from error


def table_of(record: video_record.VideoRecord) -> Table:
    """Table of what was found."""
    table = Table("", "value", "standard deviation", "unit", title="camera")
    for item in film_quantities(record):
        table.add_row(item.name, *item.texts, item.unit)
    return table


def ahead_table(rows: Sequence[Judged]) -> Table:
    """Predicted pictures beside what came, by how far ahead they were."""
    table = Table(
        "ahead", "pictures", "likeness", "of the mean picture", "of the newest one", "error [degrees]",
        "as the picture shows it", "within 2 deviations",
        title="pictures ahead: structural similarity in the band that the joint comes over",
    )  # fmt: skip
    for item in summaries(rows):
        cells = [f"{value:.3f}" for value in (item.likeness, item.mean, item.still)]
        errors = [f"{math.degrees(value):.3f}" for value in (item.error, item.shown)]
        table.add_row(f"{item.ahead:g} s", str(item.count), *cells, *errors, f"{item.inside:.0%}")
    return table


def summaries(rows: Sequence[Judged]) -> list[Summary]:
    """Predicted pictures, together for each time ahead."""
    return [Summary.of(rows, ahead) for ahead in AHEAD] if rows else []
