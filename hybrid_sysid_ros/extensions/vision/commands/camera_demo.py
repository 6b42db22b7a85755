"""The demo by a camera: a film, positions out of it, the loop closed by pictures alone, some predicted, a report."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands.terminal import print_lines, print_table, status, typed
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.extensions.shared.demo_loop import OUT, run_loop, tracked
from hybrid_sysid_ros.extensions.shared.demo_recipe import DemoRecipe
from hybrid_sysid_ros.extensions.vision import camera_loop
from hybrid_sysid_ros.extensions.vision.camera.film import CRF
from hybrid_sysid_ros.extensions.vision.camera.filming import filmed
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera
from hybrid_sysid_ros.extensions.vision.commands.video import ahead_table, table_of
from hybrid_sysid_ros.extensions.vision.companion import Vision
from hybrid_sysid_ros.extensions.vision.prediction import image_prediction
from hybrid_sysid_ros.extensions.vision.prediction.image_prediction import AHEAD, Judged, Summary
from hybrid_sysid_ros.extensions.vision.reading import video_record
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.reading.footage import followed, picked
from hybrid_sysid_ros.extensions.vision.reading.layers import KIND, PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.learning import learn
from hybrid_sysid_ros.extensions.vision.reading.video_record import VideoRecord, calibrated
from hybrid_sysid_ros.extensions.vision.report.video_page import write_video
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.report import RunSummary, closed_loop_section
from hybrid_sysid_ros.rigs.rig import Rig, default
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import configuration, processes
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file, check_folder, make_folder, sha256, write_text

SECONDS = 40.0
"""Of the film that is learned from."""
CAMERA = Camera()
NOT_READ = ("lost", "displaced", "frozen", "unreadable")
"""Pictures that say nothing, as the vision node counts them."""


def instead(
    camera: Annotated[
        bool,
        typer.Option("--camera", help="Film the rig, learn to read its picture, and close the loop by that alone."),
    ] = False,
    rig: str = "",
    out: Path | None = None,
    train: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    as_json: bool = False,
) -> Callable[[], dict[str, Any]] | None:
    """This demo instead of the usual one, where it is asked for."""
    if not camera:
        return None
    if train:
        raise UserError("--train and --camera are two demos: leave one out")
    described = load_rig(rig or default())
    name = "demo_camera" if described.name == default() else f"demo_camera_{described.name}"

    def run() -> dict[str, Any]:
        place = out or OUT.with_name(name)
        return camera_demo(place, described.source, seed=seed, overwrite=overwrite, quiet=as_json)

    return run


def camera_demo(
    out: Path, rig: str = "", *, seed: int = 0, overwrite: bool = False, quiet: bool = False
) -> dict[str, Any]:
    """Film a rig, learn to read its picture, close the loop by that, and report.

    Leaves report.html, summary.json, the film, the layers, the bag with the positions and the bag of the loop in
    ``out``. rig: name or path, by default the one that is meant where none is named.

    seed: of the sensors' noise. overwrite: whether the results of another demo are replaced. quiet: whether none are
    printed.

    Raises UserError where the rig has no picture of its first output, for missing extras, for results that may not be
    replaced, and where a node fails.
    """
    described = load_rig(rig or default())
    scene, plan = scene_of(described), DemoRecipe.of(described)
    camera_loop.frame_noise(described, CAMERA.width)
    report.check_available()
    processes.check_ros()
    make_folder(out)
    film, recorded, seen, layers_folder = out / "film.mp4", out / "recorded", out / "seen", out / KIND
    for file in (film, out / "report.html", out / "summary.json"):
        check_file(file, replace=overwrite)
    for folder in (recorded, seen, out / "loop"):
        check_folder(folder, marker=bags.markers(folder), replace=overwrite)
    check_folder(layers_folder, marker=f"{KIND}.yaml", replace=overwrite)
    model_folder = configuration.shipped(described.name, "model")
    model = load_model(model_folder)
    kind = next(iter(described.experiments.excitations))
    status.print(f"1 filming {described.name}, {kind}, {SECONDS:g} s")
    filmed(
        described, kind, recorded, film, CAMERA, seed=seed, duration=SECONDS, rate=1.0 / model.sampling.step, crf=CRF,
        overwrite=True,
    )  # fmt: skip
    status.print("2 learning the layers of the picture, and reading positions by them")
    record, layers = _learned(film, described, recorded, layers_folder)
    made_by = "hybrid-sysid demo --camera"
    video_record.write(record, described, scene.joint, recorded, seen, replace=True, made_by=made_by)
    if not quiet:
        print_table(table_of(record))
    status.print("3 running the loop as ROS 2 processes, its sensor out: a camera takes its place")
    bag, diagnostics = run_loop(
        out / "loop",
        described,
        plan.reference,
        model=model_folder,
        companions=[Vision(layers=layers_folder)],
        seed=seed,
    )
    loop = closed_loop_section(LoopRecord.from_bag(bag, described), described)
    run = RunSummary.of(diagnostics, described, bag=bag, section=loop)
    status.print("4 predicting the pictures of the film")
    ahead = image_prediction.of_video(film, model, described, recorded, record, layers, exposure=CAMERA.exposure)
    if not quiet:
        print_table(ahead_table(ahead))
    summary = {
        "camera": _seen(record),
        "closed_loop": tracked(loop, plan) | {"of": "the true position", "sensor": "camera"},
        "frames": {key: int(diagnostics["vision"][f"{key}_frames"]) for key in NOT_READ}
        | {"read": int(diagnostics["vision"]["frames"])},
        "run": run.content,
        "pictures_ahead": {f"{seconds:g} s": _ahead(ahead, seconds) for seconds in AHEAD},
    }
    write_text(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    called = typed()
    sources = {f"film, {film.name}": sha256(film), f"bag, {recorded.name}": sha256(recorded)}
    provenance = report.provenance(model, called, hashes=sources)
    write_video(out / "report.html", record, layers, f"{described.name} by camera", provenance, ahead=ahead, loop=loop)
    if not quiet:
        print_table(_table(summary))
        print_lines(run.lines | {"report": str(out / "report.html"), "numbers": str(out / "summary.json")}, run.alarms)
    return summary


def _learned(film: Path, rig: Rig, bag: Path, folder: Path) -> tuple[VideoRecord, PictureLayers]:
    """Positions of a film in a bag's time, and the layers that were learned to read them, saved in a folder."""
    with status.status("looking at the film") as spinner:
        view = FilmView(path=film)
        layers, _ = learn(picked(view), rig, readout=CAMERA.readout, progress=spinner.update)
        footage = followed(view, AngleReader(layers), scene_of(rig).lamp)
        record = video_record.joined(footage, layers, rig, bag, exposure=CAMERA.exposure)
        layers = calibrated(layers, record)
        layers.save(folder)
    return record, layers


def _seen(record: VideoRecord) -> dict[str, Any]:
    """What the summary says of the film."""
    found = record.synchronisation
    assert found is not None
    shift, rate, scale, offset = found.deviations.tolist()
    return {
        "pictures": len(record.footage.times),
        "lost": record.footage.lost,
        "camera_less_encoder_degrees": round(math.degrees(found.residual), 5),
        "shift_s": [found.shift, shift],
        "rate_ppm": [1e6 * found.rate, 1e6 * rate],
        "scale": [found.scale, scale],
        "offset_degrees": [math.degrees(found.offset), math.degrees(offset)],
    }


def _ahead(rows: list[Judged], seconds: float) -> dict[str, float]:
    """What it says of predicted pictures."""
    found = Summary.of(rows, seconds)
    return {
        "likeness": round(found.likeness, 4),
        "likeness_of_mean_picture": round(found.mean, 4),
        "likeness_of_newest_picture": round(found.still, 4),
        "error_degrees": round(math.degrees(found.error), 4),
        "shown_error_degrees": round(math.degrees(found.shown), 4),
        "within_two_deviations": round(found.inside, 3),
    }


def _table(summary: Mapping[str, Any]) -> Table:
    table = Table("quantity", "value", title="demo by camera")
    frames = summary["frames"]
    lost = sum(frames[key] for key in NOT_READ)
    table.add_row("frames lost", f"{lost} of {frames['read']}")
    farthest = summary["pictures_ahead"][f"{max(AHEAD):g} s"]
    table.add_row(f"likeness of pictures {max(AHEAD):g} s ahead", f"{farthest['likeness']:.3f}")
    return table
