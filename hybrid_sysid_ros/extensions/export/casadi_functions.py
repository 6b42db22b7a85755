"""A model as CasADi functions, for do-mpc, acados and anyone's own script."""

from __future__ import annotations

import json
import math
from pathlib import Path

from hybrid_sysid_ros.core.symbolic import symbolic_output, symbolic_step
from hybrid_sysid_ros.models.model import Model, signals_of
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder, written_folder

MOST_SUBSTEPS = 10_000
"""Of an exported step; each is written out."""
STEP, OUTPUT, CONTENT = "step.casadi", "output.casadi", "model.json"


def export_casadi(
    model: Model, folder: Path | str, *, step: float = 0.0, smoothing: float = 0.0, overwrite: bool = False
) -> None:
    """Write ``step.casadi``, (x, u) -> following, and ``output.casadi``, (x, u) -> y, for ``casadi.Function.load``, and
    what they take beside them in ``model.json``.

    step: of the step function [s], a multiple of the model's, which is the default; a recurrence has one only.
    smoothing: rounds stick-slip over so much velocity, 0 for the exact step, whose derivative jumps. u acts at once:
    model.json lists the delays. Raises UserError where the place can't be written or the step is no multiple.
    """
    check_folder(folder, marker=STEP, replace=overwrite)
    system, own = model.system, model.sampling.step
    if not (0.0 <= step <= MOST_SUBSTEPS * own and 0.0 <= smoothing < math.inf):
        raise UserError(
            f"export: step is {step:g} s and smoothing {smoothing:g}: give a step of 0 to {MOST_SUBSTEPS * own:g} s, "
            "and a width of 0 or more"
        )
    substeps = round(step / own) if step else 1
    if substeps < 1 or abs(substeps * own - (step or own)) > 1e-9:
        raise UserError(f"export: a step of {step:g} s is no multiple of the model's {own:g} s")
    content = {
        "rig": model.rig,
        "structure": model.structure,
        "step": substeps * own,
        "states": [str(item) for item in system.states],
        **signals_of(system),
        "input_delays": system.input_delays.tolist(),
        "model": model.seal,
    }
    with written_folder(folder, marker=STEP, replace=overwrite) as partial:
        symbolic_step(system, step=own, substeps=substeps, smoothing=smoothing).save(str(partial / STEP))
        symbolic_output(system).save(str(partial / OUTPUT))
        (partial / CONTENT).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
