"""hybrid-sysid rig check: a rig that makes no sense is reported in a line for each problem."""

import json
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy import signal

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.core import Dry, System, bounded
from hybrid_sysid_ros.core.mathematics import dead_zone, log, sqrt
from hybrid_sysid_ros.extensions.checks.findings import check, step_responses
from hybrid_sysid_ros.rigs.actuator import Actuator
from hybrid_sysid_ros.rigs.drivers import ExperimentLoop, Experiments
from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.rigs.experiments import simulate_experiment
from hybrid_sysid_ros.rigs.rig import default, load
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


class Bare(Mass):
    """An output in nobody's unit."""

    outputs = ("third",)

    def output(self, x: Any, u: Any) -> Any:
        return (x[0] / 3.0,)


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
    assert "do not determine position:" in problems(rig_of(Blind()))


def test_what_grows_without_a_loop_is_named_and_held_by_one():
    """q'' = 4 q + u grows by e in half a second."""
    falling = Mass(growth=4.0)
    assert "in position and velocity, by e in 0.5 s" in problems(rig_of(falling))
    held = Experiments(loops={0: ExperimentLoop(output=0, gain=6.0)})
    assert problems(rig_of(falling, experiments=held)) == ""


def test_a_loop_that_is_too_weak_is_reported_with_what_grows():
    """q'' = 4 q - q."""
    weak = rig_of(Mass(growth=4.0), experiments=Experiments(loops={0: ExperimentLoop(output=0, gain=1.0)}))
    found = problems(weak)
    assert f"with them unstable at the origin in position and velocity, by e in {3**-0.5:.3g} s" in found
    assert "do not tell" not in found


class Bridged(Mass):
    """Its drive has a dead zone of 1 m/s^2."""

    def law(self, x: Any, u: Any) -> Any:
        return x[1], dead_zone(u[0], 1.0, 0.01, over=1.75) + self.growth * x[0] - 2.0 * x[1]


def test_what_grows_within_a_dead_zone_alone_is_held():
    """q'' = 9 q - 2 q' + n(u): within the dead zone nothing holds it, beyond it a loop of gain 20 does."""
    falling = Bridged(growth=9.0)
    steps = {"steps": {0: Excitation(kind="random_steps", numbers={"amplitude": 0.2, "hold": 0.5})}}

    def found(gain, **changes):
        driven = Experiments(loops={0: ExperimentLoop(output=0, gain=gain)}, excitations=steps)
        return problems(rig_of(falling, experiments=driven, **changes))

    assert found(20.0) == ""
    assert "with them unstable at the origin" in found(6.0)
    travel = np.array([[-0.5, -np.inf], [0.5, np.inf]])
    assert "with them unstable at the origin" in found(6.0, travel=travel)  # at a stop it grows no further


@pytest.mark.parametrize("delay", [0.02, 0.35])
@pytest.mark.parametrize("share", [0.97, 1.03])
def test_a_loop_is_stable_up_to_the_gain_at_which_its_phase_is_180_degrees(share, delay):
    """k (1 + a / s) F(s) e^(-s T) / (1 + s / 2): delays of input, sensor and half a step, F of 5 Hz (scipy's)."""
    s, integral, low_pass = 1j * np.linspace(1.0, 60.0, 100_000), 1.5, LowPass(hertz=5.0, order=2)
    numerator, denominator = signal.butter(2, 2 * np.pi * low_pass.hertz, analog=True)
    filtered = np.polyval(numerator, s) / np.polyval(denominator, s)
    along = (1 + integral / s) * filtered * np.exp(-s * (0.0125 + delay + 0.0005)) / (1 + 0.5 * s)
    crossing = along[np.flatnonzero(np.diff(np.sign(along.imag)) > 0)[0]]
    loop = ExperimentLoop(output=0, gain=share / abs(crossing), integral=integral)
    sensors = {"first": Sensor(unit="m", delay=delay, low_pass=low_pass)}
    found = problems(rig_of(Lags(), sensors=sensors, experiments=Experiments(loops={0: loop})))
    assert ("unstable at the origin in first" in found) == (share > 1.0)


def test_an_excitation_beyond_the_limits_is_reported_by_its_key():
    def rig(low, high, amplitude):
        steps = Excitation(kind="random_steps", numbers={"amplitude": amplitude, "hold": 0.5})
        experiments = Experiments(excitations={"steps": {0: steps}})
        return rig_of(Mass(), actuators=(Actuator(low=low, high=high),), experiments=experiments)

    assert problems(rig(-2.0, 2.0, 2.0)) == problems(rig(0.0, 2.0, 2.0)) == ""
    for low, high in ((-2.0, 1.0), (0.0, 1.9)):
        assert "experiments.excitations.steps: amplitude 2 " in problems(rig(low, high, 2.0))


def test_variables_without_a_unit_are_remarked():
    assert any(line.startswith("third:") for line in check(rig_of(Bare())).remarks)
    assert check(rig_of(Mass())).remarks == []


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (Rooted(), "not finite for level"),
        (HalfRooted(), "level is not finite at position -"),
        (Mass(growth=20.0), "parameter growth = 20"),
        (Misplaced(), "friction acts on its velocity, velocity"),
    ],
)
def test_equations_that_make_no_sense_are_reported(system, message):
    assert message in problems(rig_of(system))


def test_a_low_pass_faster_than_the_step_is_reported():
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
    found = json.loads(command("rig", "check", str(folder), "--json")[1])
    assert (found["rig"], found["problems"]) == (folder.name, [])
    assert len(found["step_responses"]["time [s]"]) > 1
    assert (status, error) == (0, "")
    refused(command("rig", "new", str(folder)), folder, "not empty")
    refused(command("rig", "new", str(tmp_path / "cam_beam")), "called cam_beam already")
    for name in ("my rig", "3d_printer", "größe", 101 * "a"):  # a model's file names its rig, and is held to the same
        refused(command("rig", "new", str(tmp_path / name)), "letters of ASCII", "100 at most, and begin with a letter")


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("process_noise: [1.0e-5, 0.02]", "process_noise: [1, 2, 3]", "nodes.estimator: parameter process_noise"),
        ("controller: {", "controller: {period: 0.0105, ", "nodes.controller.period"),
        ("nodes:\n  estimator: {", "nodes:\n  plant: {rate: 300.0}\n  estimator: {rate: 300.0, ", "nodes.plant.rate"),
        ("nodes:\n", "demo: {learn: [nowhere]}\nnodes:\n", "demo: no bag nowhere"),
        ("nodes:\n", "demo: {period: 0.007}\nnodes:\n", "demo: "),
    ],
)
def test_problems_are_lines_and_the_status_is_2(tmp_path, command, old, new, key):
    folder = tmp_path / "sledge"
    command("rig", "new", str(folder))
    values = (folder / "rig.yaml").read_text()
    (folder / "rig.yaml").write_text(values.replace(old, new))
    refused(command("rig", "check", str(folder)), folder / "rig.yaml", key)


def test_the_rig_that_is_meant_where_none_is_named_stands_in_the_help(command):
    status, shown, _ = command("simulate", "--help")
    assert (status, f"[default: {default()}]" in " ".join(shown.split())) == (0, True)


@pytest.mark.parametrize("name", ["cam_beam", "flexible_joint"])
def test_the_rigs_of_the_package_pass(name):
    assert check(load(name)).problems == []


@pytest.mark.parametrize("step", [3600.0, 1.0, 1.0 / 610.35, 1e-5])
def test_a_rig_may_have_any_time_scale(step):
    """Neither a long nor a short step hides the equations from the check."""
    assert problems(rig_of(Mass(growth=0.0), step=step)) == ""


def test_an_input_may_rest_at_its_limit():
    """A valve: from shut to open."""
    assert problems(rig_of(Mass(), actuators=(Actuator(low=0.0, high=10.0),))) == ""


def test_what_leaves_all_numbers_is_not_written_as_a_bag(tmp_path):
    """q grows by e^80 in 40 s."""
    steps = Excitation(kind="random_steps", numbers={"amplitude": 1.0, "hold": 1.0})
    rig = rig_of(Mass(growth=4.0), experiments=Experiments(excitations={"steps": {0: steps}}))
    with pytest.raises(UserError, match="grows beyond all numbers"):
        simulate_experiment(rig, "steps", tmp_path / "bag", seed=0, duration=40.0, rate=100.0)
    assert not (tmp_path / "bag").exists()
