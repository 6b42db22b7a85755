"""A page of one file in which the simulated rig and its controller run, without a server and without a network."""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.export.c_source import Text
from hybrid_sysid_ros.extensions.export.fmu.content import STATUSES, files_of
from hybrid_sysid_ros.extensions.export.page import node_check
from hybrid_sysid_ros.extensions.export.page.web_assembly import check_compiler, library_licence, module_of
from hybrid_sysid_ros.extensions.export.simulation.simulation import Simulation
from hybrid_sysid_ros.extensions.export.unit.folder import export_loop, unit_name
from hybrid_sysid_ros.extensions.export.unit.python_loop import PythonLoop, loop_in_python
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file, write_text

HERE = Path(__file__).parent
TOLERANCE, CONVERGED = 1e-9, 1e-6
"""Largest difference from Python, in the variables' units, relative above 1; the second with a policy."""
PERIODS, EVERY = 1000, 100
"""Periods that are compared, and how long a reference is held."""
SEAL = 12
"""Digits of the model's seal that are shown."""
PUSH = 0.1
"""Of the range of an input."""
REAL_TIME: Mapping[str, Any] = {"real_time": True}


@dataclass(frozen=True, kw_only=True)
class PageExport:
    """What was written. differences: the largest ones from Python by controller; empty without node."""

    differences: Mapping[str, float]
    bytes: int


def export_page(
    rig: Rig, model: Model, out: Path | str, *,
    seal: str, settings: Mapping[str, Any] = REAL_TIME, overwrite: bool = False, **more: Any,
) -> PageExport:  # fmt: skip
    """Write a page with a model and its exact MPC, and the policy of the settings, if there is one. The arguments are
    those of :func:`~..unit.folder.export_loop`.

    Raises UserError where the place can't be written, without a compiler for WebAssembly, for what can't be printed,
    and where the page's code answers otherwise than Python.
    """
    check_file(out, suffix=".html", replace=overwrite)
    check_compiler()
    simulation = Simulation.of_model(f"{unit_name(rig.name)}_model", rig, model, stops=True)
    texts = simulation.texts(about=f"{model.structure} of {rig.name}, {seal}")
    chosen: dict[str, dict[str, Any]] = {"exact": {"settings": REAL_TIME, "source": more.get("source")}}
    if "policy" in settings:
        chosen["supervised"] = {"settings": settings, **more}
    loops, drivers = dict[str, PythonLoop](), dict[str, str]()
    for name, given in chosen.items():
        module, licence = _loop(rig, model, seal=seal, **given)
        drivers[name] = _packed(module)
        loops[name] = loop_in_python(rig, model, given["settings"], given.get("network"))
    plant = {**texts, "page.c": _glue("plant.c", simulation.name)}
    data = _data(simulation, model, loops["exact"], seal=seal)
    data |= {"drivers": drivers, "plant": _packed(module_of(plant, [name for name in plant if name.endswith(".c")]))}
    code = _static("rig.js")
    differences = {}
    for name, loop in loops.items():
        found = _difference(code, data, name, simulation, loop)
        if found is not None:
            differences[name] = found
    text = _page(data, code, f"DAQP\n\n{licence}\n\n{library_licence()}")
    write_text(out, text)
    return PageExport(differences=differences, bytes=len(text.encode()))


def _loop(rig: Rig, model: Model, **given: Any) -> tuple[bytes, str]:
    """A loop's unit as WebAssembly, and the licence of its solver."""
    with TemporaryDirectory() as scratch:
        folder = Path(scratch) / "loop"
        done = export_loop(rig, model, folder, **given)
        files = files_of(folder, done.name) | {"page.c": _glue("loop.c", done.name)}
        licence = (folder / "daqp" / "LICENSE").read_text(encoding="utf-8")
    return module_of(files, [f"{done.name}.c", f"{done.name}_solver.c", "page.c"]), licence


def _glue(file: str, name: str) -> str:
    return Text((HERE / "c" / file).read_text(encoding="utf-8")).substitute({"name": name, "NAME": name.upper()})


def _packed(module: bytes) -> str:
    return base64.b64encode(gzip.compress(module, mtime=0)).decode()


def _static(name: str) -> str:
    return (HERE / "static" / name).read_text(encoding="utf-8")


def _data(simulation: Simulation, model: Model, loop: PythonLoop, *, seal: str) -> dict[str, Any]:
    """What the page knows of the rig, beside the modules."""
    rig, system, horizon = simulation.rig, simulation.system, loop.mpc.horizon
    n, m, p = len(system.states), len(system.inputs), len(system.outputs)
    steps = round(loop.estimator.period / rig.step)
    if abs(steps * rig.step - loop.estimator.period) > 1e-9:
        raise UserError(f"export: the estimator's period is no multiple of the model's step of {rig.step:g} s")
    low, high = _references(rig, model)
    weights = np.broadcast_to(np.array(loop.mpc.problem.output_weights), p)
    low_input, high_input = rig.limits
    drawing = extensions.one("sections", "drawing")(rig) if "drawing" in extensions.targets("sections") else None
    return {
        "rig": rig.name,
        "model": f"{model.structure}, {seal[:SEAL]}",
        "made": f"hybrid_sysid_ros {version('hybrid_sysid_ros')}",
        "step": rig.step, "period": loop.estimator.period, "steps": steps,
        "sizes": {"states": n, "estimated": len(loop.mpc.system.states), "inputs": m, "outputs": p, "horizon": horizon},
        "states": [{"name": item.name, "unit": item.unit} for item in system.states],
        "inputs": [
            {"name": item.name, "unit": item.unit, "low": float(low_input[j]), "high": float(high_input[j])}
            for j, item in enumerate(system.inputs)
        ],
        "outputs": [
            {
                "name": item.name, "unit": shown.unit, "scale": shown.scale, "low": float(low[k]),
                "high": float(high[k]), "tracked": bool(weights[k] > 0.0),
                "noise": sensor.white_noise * abs(sensor.scale) if sensor.noisy else 0.0,
            }
            for k, (item, shown, sensor) in enumerate(zip(system.outputs, rig.display, rig.sensors, strict=True))
        ],
        "statuses": [name for name, _ in STATUSES],
        "push": (PUSH * (high_input - low_input)).tolist(),
        "joints": {
            name: {"position": joint.position, "velocity": joint.velocity} for name, joint in rig.joints.joints.items()
        },
        "drawing": None if drawing is None else {"bodies": drawing.description(), "extent": drawing.extent()},
    }  # fmt: skip


def _references(rig: Rig, model: Model) -> tuple[Array, Array]:
    """Lowest and highest reference of each output (p,) on the page: what the model was trained on, within the reach."""
    low, high = rig.reach
    trained = [model.training_range.get(item.name, (-1.0, 1.0)) for item in model.system.outputs]
    low, high = np.maximum(low, [item[0] for item in trained]), np.minimum(high, [item[1] for item in trained])
    return np.minimum(low, 0.0), np.maximum(high, 0.0)


def _difference(
    code: str, data: Mapping[str, Any], name: str, simulation: Simulation, loop: PythonLoop
) -> float | None:
    """The largest difference of commands, states and estimates from Python's; None without node.

    Raises UserError where it is above the tolerance.
    """
    low, high, noise = ([item[key] for item in data["outputs"]] for key in ("low", "high", "noise"))
    course = node_check.course(low, high, np.array(data["push"]), noise, PERIODS, EVERY)
    found = node_check.run(code, data, name, *course)
    if found is None:
        return None
    expected = node_check.in_python(simulation, loop, *course)
    largest = float(np.max(np.abs(found - expected) / np.maximum(np.abs(expected), 1.0)))
    tolerance = TOLERANCE if loop.supervisor is None else CONVERGED
    if not largest <= tolerance:
        raise UserError(
            f"export: with the controller {name} the page's numbers differ by {largest:.3g} from Python's, more than "
            f"{tolerance:g}; nothing is written: report this"
        )
    return largest


def _page(data: Mapping[str, Any], code: str, licences: str) -> str:
    """The text of the page."""
    drawing = "class Drawing { constructor() {} move() {} }"
    if data["drawing"] is not None:
        home = Path(str(extensions.one("sections", "drawing").__init__.__code__.co_filename)).parent
        drawing = (home / "page" / "drawing.js").read_text(encoding="utf-8").replace("export class", "class")
    values = {
        "title": html.escape(f"{data['rig']} with its controller"),
        "rig": html.escape(data["rig"].replace("_", " ")),
        "model": html.escape(data["model"]),
        "style": _static("page.css"),
        "licences": html.escape(licences),
        "data": json.dumps(data).replace("</", "<\\/"),
        "code": "\n".join([code, drawing, _static("charts.js"), _static("page.js")]),
    }
    return Text(_static("page.html")).substitute(values)
