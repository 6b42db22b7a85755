"""The pictures of docs/tutorials/bag-to-controller.md, of the same bags, models and loops as its commands.

.venv/bin/python -m docs.story      # no clock is read, so they repeat
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import hybrid_sysid_ros as hs
from docs.lines import Line, Panel, draw
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.library.loops import Loop

HERE = Path(__file__).parent / "tutorials"
TRAINED, SHOWN = 0.5, 20.0
"""Part of each record that is trained on; seconds of the free run that are drawn."""
WEIGHTS = (1.0, 20.0)  # on changes of the input


def record_picture(rig: hs.Rig, record: Record) -> None:
    """What a bag holds, with the half that a fit sees shaded."""
    half = (0.0, TRAINED * record.duration)
    position = Line(name="output", values=rig.display[0].shown(record.output[::4, 0]))
    drive = Line(name="input", values=record.input[::4, 0], colour="input")
    draw(
        HERE / "record.svg",
        record.time[::4],
        [
            Panel(label="position [V]", lines=[position], shaded=half),
            Panel(label="drive [V]", lines=[drive], height=90, shaded=half),
        ],
        title="Random steps: what the fit sees is shaded",
    )


def free_run_picture(rig: hs.Rig, record: Record, models: dict[str, hs.Model]) -> None:
    """Free runs of models beside an unseen record, and what they are off by."""
    runs = {name: model.free_run(record) for name, model in models.items()}
    time = next(iter(runs.values())).time
    rows = time <= SHOWN
    measured = rig.display[0].shown(next(iter(runs.values())).measured[rows, 0])
    found = {name: rig.display[0].shown(run.outputs[rows, 0]) for name, run in runs.items()}
    colours = dict(zip(found, ("other", "found"), strict=True))
    over = [Line(name=name, values=values, colour=colours[name]) for name, values in found.items()]
    off = [Line(name=name, values=values - measured, colour=colours[name]) for name, values in found.items()]
    draw(
        HERE / "free_run.svg",
        time[rows],
        [
            Panel(label="position [V]", lines=[Line(name="measured", values=measured, colour="wanted"), *over]),
            Panel(label="error [V]", lines=off, height=90),
        ],
        title="Free runs over a record that no fit has seen",
    )


def _wanted(loop: Loop) -> Line:
    return Line(name="reference", values=loop.rig.display[0].shown(loop.reference[:, 0]), colour="wanted")


def loop_picture(loop: Loop) -> None:
    """A loop under the exact MPC."""
    found = Line(name="output", values=loop.rig.display[0].shown(loop.outputs[:, 0]))
    drive = Line(name="input", values=loop.inputs[:, 0], colour="input")
    panels = [
        Panel(label="position [V]", lines=[_wanted(loop), found]),
        Panel(label="drive [V]", lines=[drive], height=90),
    ]
    draw(HERE / "exact_loop.svg", loop.time, panels, title="Steps under the exact MPC")


def weights_picture(loops: dict[float, Loop]) -> None:
    """The same loop with two weights on the changes of its input."""
    shown = next(iter(loops.values())).rig.display[0].shown
    pairs = zip(loops.items(), ("found", "input"), strict=True)
    names = {f"weight {weight:g}": (loop, colour) for (weight, loop), colour in pairs}
    outputs = [Line(name=name, values=shown(loop.outputs[:, 0]), colour=c) for name, (loop, c) in names.items()]
    inputs = [Line(name=name, values=loop.inputs[:, 0], colour=c) for name, (loop, c) in names.items()]
    loop = next(iter(loops.values()))
    panels = [
        Panel(label="position [V]", lines=[_wanted(loop), *outputs]),
        Panel(label="drive [V]", lines=inputs, height=90),
    ]
    draw(HERE / "weights.svg", loop.time, panels, title="Steps with two weights on changes of the input")


if __name__ == "__main__":
    rig = hs.load_rig("cam_beam")
    training = [hs.read_bag(f"bags/beam_{kind}", rig) for kind in ("multisine", "random_steps")]
    models = {kind: hs.identify(training, rig, kind, part=(0.0, TRAINED)) for kind in ("linear", "hybrid")}
    record_picture(rig, training[1])
    free_run_picture(rig, hs.read_bag("bags/beam_swept_sine", rig), models)
    loop_picture(hs.simulate(rig, models["hybrid"], controller="exact", reference="steps", seconds=20.0))
    loops = {
        weight: hs.simulate(
            rig,
            models["hybrid"],
            controller="exact",
            reference="steps",
            seconds=4.0,
            parameters={"controller.rate_weight": [weight]},
        )
        for weight in WEIGHTS
    }
    for weight, loop in loops.items():
        print(
            f"weight {weight:g}: tracking error {loop.score['position']:.3f} V, rms change of the input "
            f"{np.sqrt(np.mean(np.diff(loop.inputs[:, 0]) ** 2)):.2f} V"
        )
    weights_picture(loops)
