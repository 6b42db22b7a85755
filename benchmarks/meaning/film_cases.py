"""Film cases: 42 films by the second renderer, some of which are to be refused, each for its own reason."""

from __future__ import annotations

from typing import Any

from benchmarks.meaning.second_renderer import FilmCase

JOINT: dict[str, Any] = {"rig": "flexible_joint", "pivot": (0.5, 0.281)}
WHEEL: dict[str, Any] = {"rig": "wheel_motor", "pivot": (0.5, 0.281)}
SOUND = (
    FilmCase(name="tripod"),
    FilmCase(name="one pixel of shake", jitter=1.0),
    FilmCase(name="one pixel of shake, office", jitter=1.0, wall="office", seed=1),
    FilmCase(name="held by hand", sway=4.0, roll=0.3, wall="foliage"),
    FilmCase(name="held by hand, bricks", sway=2.0, roll=0.2, seed=2),
    FilmCase(name="drone", sway=6.0, roll=0.4, jitter=0.3, wall="foliage", rate=60.0, seconds=6.0),
    FilmCase(name="nearer than the wall", sway=2.0, roll=0.1, parallax=0.3, wall="office"),
    FilmCase(name="creeping tripod", drift=6.0),
    FilmCase(name="slow pan", drift=80.0),
    FilmCase(name="from the side", tilt=12.0),
    FilmCase(name="walkers behind", walkers=2, wall="office"),
    FilmCase(name="walkers before", walkers=1, in_front=True),
    FilmCase(name="even wall", wall="even"),
    FilmCase(name="even wall, dim", wall="even", light=0.35, noise=3.0),
    FilmCase(name="portrait", width=480, height=854, pivot=(0.5, 0.9)),
    FilmCase(name="smaller, clicked", pivot=(0.42, 0.36), size=0.7, clicked=True),
    FilmCase(name="HEVC", codec="libx265", crf=26),
    FilmCase(name="motion JPEG", codec="mjpeg", crf=16),
    FilmCase(name="MPEG-4", codec="mpeg4", crf=16),
    FilmCase(name="strong compression, long rest", crf=34, rest=3.0),
    FilmCase(name="24 pictures a second", rate=24.0),
    FilmCase(name="120 pictures a second", rate=120.0, seconds=5.0, exposure=0.003, readout=0.006),
    FilmCase(name="240 pictures a second", rate=240.0, seconds=4.0, exposure=0.002, readout=0.003),
    FilmCase(name="noise", noise=8.0),
    FilmCase(name="little contrast", bright=0.45, dark=0.3),
    FilmCase(name="pivot elsewhere", pivot=(0.49, 0.33), size=0.9),
    FilmCase(name="lens", lens=0.02),
    FilmCase(name="rolled camera", turned=4.0),
    FilmCase(name="1280x720", width=1280, height=720, seconds=6.0),
    FilmCase(name="joint", **JOINT),
    FilmCase(name="joint, held by hand", sway=3.0, roll=0.2, wall="office", **JOINT),
    FilmCase(name="wheel", rate=60.0, exposure=0.003, seconds=6.0, **WHEEL),
)
SPOILT = (
    FilmCase(name="shake before an even wall", wrong="the camera shakes", wall="even", jitter=1.0),
    FilmCase(name="by hand before an even wall", wrong="the camera shakes", wall="even", sway=3.0, roll=0.3),
    FilmCase(name="camera swings away", wrong="camera was moved", drift=200.0),
    FilmCase(name="frozen", wrong="stands still, frozen", frozen=(4.0, 5.0), crf=18),
    FilmCase(name="black part", wrong="is black", black=(4.0, 4.6)),
    FilmCase(name="black", wrong="black|dark|nothing that turns", light=0.0),
    FilmCase(name="another rig", wrong="is it", read_as="cam_beam", **JOINT),
    FilmCase(name="too short", wrong="pictures: 40 at least|less than", seconds=1.2, rest=0.1),
    FilmCase(name="small", wrong="too small", width=160, height=90),
    FilmCase(name="half as fast", wrong="times as fast", pace=2.0),
)
