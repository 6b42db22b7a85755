"""hybrid-sysid rig check: a rig that makes no sense is told in a line for each problem."""

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pytest

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.core import Dry, System, bounded
from hybrid_sysid_ros.core.mathematics import log, sqrt
from hybrid_sysid_ros.rigs.actuator import Actuator
from hybrid_sysid_ros.rigs.check import check, step_responses
from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.rigs.experiments import simulate
from hybrid_sysid_ros.rigs.rig import Experiments, Loop, load
from hybrid_sysid_ros.rigs.sensor import LowPass, Sensor
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import refused
from tests.rigs.toys import Lags, rig_of


@dataclass(frozen=True, kw_only=True)
class Mass(System):
    """v' = u + growth q, q' = v."""

    states = ("position [m]", "velocity [m/s]")
    inputs = ("force [N]",)
    outputs: ClassVar[tuple[str, ...]] = ("position",)
    growth: float = bounded(0.0, -10.0, 10.0, unit="1/s^2")

    def law(self, x: Any, u: Any) -> Any:
        return x[1], u[0] + self.growth * x[0]


class Misplaced(Mass):
    """Friction on where it is."""

    contacts = (Dry(on="position", level="level"),)

    def level(self, x: Any, u: Any) -> Any:
        return 1.0


class Blind(Mass):
    """Only its speed is measured: nobody can tell where it is."""

    outputs = ("velocity",)


class Rooted(Mass):
    """An output that no number is at rest."""

    outputs = ("position", "level [m]")

    def output(self, x: Any, u: Any) -> Any:
        return x[0], log(x[0])


class HalfRooted(Mass):
    """An output that is no number on one side."""

    outputs = ("position", "level [m]")

    def output(self, x: Any, u: Any) -> Any:
        return x[0], sqrt(x[0])


def problems(rig):
    found = check(rig).problems
    assert all("\n" not in line for line in found)
    return " | ".join(found)


def test_a_sound_rig_has_no_problems():
    assert problems(rig_of(Lags())) == ""
    assert problems(rig_of(Mass())) == ""


def test_a_state_that_the_outputs_do_not_tell_is_named():
    assert "do not tell position:" in problems(rig_of(Blind()))


def test_what_grows_without_a_loop_is_named_and_held_by_one():
    """q'' = 4 q + u grows by e in half a second."""
    falling = Mass(growth=4.0)
    assert "position and velocity grow by e in 0.5 s" in problems(rig_of(falling))
    held = Experiments(loops={0: Loop(output=0, gain=6.0)})
    assert problems(rig_of(falling, experiments=held)) == ""


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (Rooted(), "not finite for level"),
        (HalfRooted(), "level is not finite at position -"),
        (Mass(growth=20.0), "parameter growth = 20"),
        (Misplaced(), "friction acts on its velocity, velocity"),
    ],
)
def test_equations_that_make_no_sense_are_told(system, message):
    assert message in problems(rig_of(system))


def test_a_low_pass_faster_than_the_step_is_told():
    rig = rig_of(Mass(), step=0.01, sensors={"position": Sensor(unit="m", low_pass=LowPass(hertz=100.0, order=2))})
    assert "is unstable at a step of 0.01 s" in problems(rig)


def test_the_step_response_is_that_of_the_lags():
    times, found = step_responses(rig_of(Lags(push_delay=0.0)), seconds=2.0, samples=21)
    np.testing.assert_allclose(found["push"][:, 0], 5.0 * (1 - np.exp(-times / 0.5)), atol=1e-9)
    assert np.all(found["push"][:, 1] == 0.0)


@pytest.fixture
def command(call):
    """Run hybrid-sysid with arguments; give status, standard output and standard error."""
    return partial(call, app.main, "hybrid-sysid")


def test_a_new_rig_passes_its_check_and_its_files_are_short(tmp_path, command):
    folder = tmp_path / "sled"
    assert command("rig", "new", str(folder))[0] == 0
    assert len((folder / "system.py").read_text().splitlines()) < 60
    assert len((folder / "rig.yaml").read_text().splitlines()) < 60
    status, _, error = command("rig", "check", str(folder))
    assert (status, error) == (0, "")
    refused(command("rig", "new", str(folder)), folder, "not empty")
    refused(command("rig", "new", str(tmp_path / "cam_beam")), "called cam_beam already")
    refused(command("rig", "new", str(tmp_path / "my rig")), "letters, digits")


def test_problems_are_lines_and_the_status_is_2(tmp_path, command):
    folder = tmp_path / "sledge"
    command("rig", "new", str(folder))
    values = (folder / "rig.yaml").read_text()
    (folder / "rig.yaml").write_text(values.replace("process_noise: [1.0e-5, 0.02]", "process_noise: [1, 2, 3]"))
    refused(command("rig", "check", str(folder)), folder, "nodes.estimator: parameter process_noise has 3 numbers")
    refused(command("rig", "check", str(tmp_path / "crane")), "no such folder")


@pytest.mark.parametrize("name", ["cam_beam", "flexible_joint"])
def test_the_rigs_of_the_package_pass(name):
    assert check(load(name)).problems == ()


def test_a_step_too_long_to_see_anything_is_told():
    assert "step: 1 s is too long" in problems(rig_of(Mass(), step=1.0))


def test_an_input_may_rest_at_its_limit():
    """A valve: from shut to open."""
    assert problems(rig_of(Mass(), actuators=(Actuator(low=0.0, high=10.0),))) == ""


def test_what_leaves_all_numbers_is_not_written_as_a_bag(tmp_path):
    """q grows by e^80 in 40 s."""
    steps = Excitation(kind="random_steps", numbers={"amplitude": 1.0, "hold": 1.0})
    rig = rig_of(Mass(growth=4.0), experiments=Experiments(excitations={"steps": {0: steps}}))
    with pytest.raises(UserError, match="grows beyond all numbers"):
        simulate(rig, "steps", tmp_path / "bag", seed=0, duration=40.0, rate=100.0)
    assert not (tmp_path / "bag").exists()
