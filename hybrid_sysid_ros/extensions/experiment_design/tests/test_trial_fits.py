"""Trial fits err as information says where a law is linear, and show minima that it does not know."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.core import bounded
from hybrid_sysid_ros.core.mathematics import sin
from hybrid_sysid_ros.extensions.experiment_design.information import Fisher, Knowledge
from hybrid_sysid_ros.extensions.experiment_design.search import Bench
from hybrid_sysid_ros.extensions.experiment_design.tests.test_design import STEP, EndingLag, ValveLag, model, rig
from hybrid_sysid_ros.extensions.experiment_design.trial_fits import are_needed, simulated, worst_error
from hybrid_sysid_ros.rigs.rig import load


@dataclass(frozen=True, kw_only=True)
class RippledLag(ValveLag):
    """y' = (sin(K u) - y) / T: over |u| <= a, gains whose products with a are a turn apart are minima of their own."""

    gain: float = bounded(30.0, 1.0, 60.0, unit="m")

    def law(self, x: Any, u: Any) -> Any:
        return [(sin(self.gain * u[0]) - x[0]) / self.lag]


def steps(amplitude: float) -> Any:
    """Of 1 s each, (steps, 1)."""
    return amplitude * np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, 20), 100)[:, None]


def test_trial_fits_err_as_information_says_where_there_is_one_minimum() -> None:
    bench, known = Bench(model=model(), rig=rig(), seconds=20.0, period=STEP, amplitude=1.0), Knowledge.of(model())
    information = Fisher.of(model(), rig(), known.sizes).information(ValveLag(), steps(1.0))
    expected = float(np.sqrt(np.max(np.diag(np.linalg.inv(information)))))
    assert 0.4 * expected < worst_error(bench, steps(1.0), [0, 1]) < 2.0 * expected


def test_trial_fits_show_minima_of_which_information_knows_nothing() -> None:
    """Of large steps a derivative sees more, and a fit ends anywhere within what is not known beforehand."""
    rippled = replace(model(), system=RippledLag(), covariance=np.diag([12.0**2, 0.02**2]))
    bench = Bench(model=rippled, rig=rig(), seconds=20.0, period=STEP, amplitude=1.0)
    known = Knowledge.of(rippled)
    fisher = Fisher.of(rippled, rig(), known.sizes)
    large, small = (known.deviations(fisher.information(RippledLag(), steps(a)))[0] for a in (1.0, 0.05))
    assert large < 0.3 * small
    assert worst_error(bench, steps(1.0), [0]) > 5.0 * worst_error(bench, steps(0.05), [0])


def test_trial_fits_are_for_dry_friction_in_a_loop() -> None:
    """Without a loop secants see its corners, and bristles have none."""
    needed = {name: are_needed(load(name).system, load(name)) for name in ("cam_beam", "wheel_motor", "flexible_joint")}
    assert needed == {"cam_beam": True, "wheel_motor": False, "flexible_joint": False}


def test_the_law_of_a_simulated_record_goes_on_where_that_of_the_model_ends() -> None:
    ending = replace(model(), system=EndingLag())
    bench = Bench(model=ending, rig=rig(), seconds=8.0, period=STEP, amplitude=0.9)
    record = simulated(bench, EndingLag(), np.full((800, 1), 0.9), seed=0)
    assert record.output.shape == (801, 1)
    assert record.output[-1, 0] == pytest.approx(0.9 * 2.0, abs=0.1)
