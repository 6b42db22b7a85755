"""Models as CasADi functions: what is exported simulates as the model does."""

import json

import casadi
import numpy as np
import pytest

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.extensions.export.casadi_functions import export_casadi
from hybrid_sysid_ros.support.errors import UserError
from tests.model_samples import model_of
from tests.structures import FURTHER


@pytest.mark.parametrize("structure", ["lugre", "hybrid", *FURTHER])
def test_an_export_simulates_as_the_model_in_plain_casadi(tmp_path, structure):
    """Fifty steps by the functions that were loaded from files, against the compiled rollout."""
    model = model_of(structure)
    export_casadi(model, tmp_path / "export")
    step, output = (casadi.Function.load(str(tmp_path / "export" / f"{name}.casadi")) for name in ("step", "output"))
    reported = json.loads((tmp_path / "export" / "model.json").read_text())
    assert reported["inputs"] == ["drive [V]"]
    assert reported["step"] == model.sampling.step
    drive = np.random.default_rng(1).uniform(-3.0, 3.0, (50, 1))
    x, states = np.zeros(len(model.system.states)), []
    for u in drive:
        x = np.array(step(x, u)).ravel()
        states.append(x)
    undelayed = model.system.with_values(
        [0.0 if item.name == "input_delay" else value for item, value in zip(
            model.system.parameters, model.system.values, strict=True)]
    )  # fmt: skip
    expected = simulate(undelayed, np.zeros(len(x)), drive, step=model.sampling.step)[1:]
    np.testing.assert_allclose(states, expected, rtol=1e-9, atol=1e-12)
    assert float(output(x, drive[-1])) == pytest.approx(output_of(undelayed, x, drive[-1])[0])
    if structure == "hybrid":
        export_casadi(model, tmp_path / "export", step=10 * model.sampling.step, overwrite=True)
        ten = casadi.Function.load(str(tmp_path / "export" / "step.casadi"))
        held = simulate(undelayed, np.zeros(len(x)), np.full((10, 1), 2.0), step=model.sampling.step)[-1]
        np.testing.assert_allclose(np.array(ten(np.zeros(len(x)), 2.0)).ravel(), held, rtol=1e-9)
        with pytest.raises(UserError, match="no multiple"):
            export_casadi(model, tmp_path / "export", step=1.5 * model.sampling.step, overwrite=True)
        for wrong in ({"step": np.nan}, {"step": 1e6}, {"smoothing": np.inf}):
            with pytest.raises(UserError, match="export: step is"):
                export_casadi(model, tmp_path / "export", overwrite=True, **wrong)
