"""hybrid-sysid film: a film of a simulated experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Overwrite, RigName, Seed
from hybrid_sysid_ros.commands.terminal import console, status
from hybrid_sysid_ros.extensions.vision.camera.film import CRF
from hybrid_sysid_ros.extensions.vision.camera.filming import filmed
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import check_file


def command(
    kind: Annotated[str, typer.Argument(help="One of the rig's experiments, such as multisine.")],
    video: Annotated[Path, typer.Argument(help="Film to write, .mp4 or .mov.")],
    bag: Annotated[Path, typer.Option("--bag", help="Bag of the same experiment to write.")],
    rig: RigName = "",
    seed: Seed = 0,
    duration: Annotated[float, typer.Option(help="Length of the experiment [s].", min=1.0, max=3600.0)] = 40.0,
    rate: Annotated[float, typer.Option(help="Samples per second of the bag.", min=1.0)] = 200.0,
    width: Annotated[int, typer.Option(help="Width of a frame [pixels].")] = 640,
    height: Annotated[int, typer.Option(help="Height of a frame [pixels].")] = 360,
    pictures: Annotated[float, typer.Option(help="Frames per second.", min=1.0, max=1000.0)] = 30.0,
    exposure: Annotated[float, typer.Option(help="Exposure time of a row [s].")] = 0.008,
    noise: Annotated[float, typer.Option(help="Noise of a pixel, rms [counts].", min=0.0)] = 2.5,
    crf: Annotated[int, typer.Option(help="Quality of H.264, from 0 (lossless) to 51 (worst).", min=0, max=51)] = CRF,
    overwrite: Overwrite = False,
) -> None:
    """Simulate an experiment on a rig before a camera: write its bag and a film that begins a second before it."""
    check_file(video)
    camera = Camera(width=width, height=height, rate=pictures, exposure=exposure, noise=noise)
    with status.status("filming"):
        count = filmed(
            load_rig(rig), kind, bag, video, camera, seed=seed, duration=duration, rate=rate, crf=crf,
            overwrite=overwrite,
        )  # fmt: skip
    console.print(f"{video}: {count} pictures   {bag}")
