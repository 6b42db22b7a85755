"""hybrid-sysid trim, and what it refuses."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.validity import check_valid
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import refused


@pytest.fixture
def trim(call):
    return partial(call, app.main, "hybrid-sysid", "trim")


def test_modes_go_by_their_names_and_whole_values_are_shown(trim):
    status, out, _ = trim("winged_cone", "--at", "speed=0", "--at", "height=0")
    assert status == 0
    for word in ("1.7705 deg", "-0.3947 deg", "short_period", "phugoid", "engine", "height", "20 rad/s, damping 0.7"):
        assert word in out


def test_any_rig_has_its_equilibrium(trim):
    """Beyond a dead zone w = K (u - U0), dry friction left out; the lag is a pole at -1 / tau."""
    status, out, _ = trim("wheel_motor", "--at", "speed=10", "--json")
    assert status == 0
    reported, system = json.loads(out), rigs.load("wheel_motor").system
    assert reported["at"]["speed"] == 10.0
    assert reported["at"]["pwm"] == pytest.approx(10.0 / system.named["gain"] + system.named["dead_zone"], rel=1e-3)
    assert reported["modes"][0]["pole"][0] == pytest.approx(-1.0 / system.named["time_constant"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("winged_cone", "--at", "altitude=0"), ("'altitude' is no state or input", "speed")),
        (("winged_cone", "--at", "speed"), ("NAME=VALUE",)),
        (("winged_cone", "--at", "speed=nan"), ("finite",)),
        (("winged_cone", "--at", "speed=0", "--at", "speed=5"), ("speed is given twice",)),
        (
            ("winged_cone", "--at", "throttle=5", "--at", "height=0"),
            ("needs throttle_command 5", "deviations from 0.17"),
        ),
        (("wheel_motor", "--at", "speed=1e6"), ("the equilibrium: needs", "its actuator gives", "hold other values")),
        (("winged_cone", "--structure", "other"), ("no gray box other", "known_air")),
        (
            ("winged_cone", "--at", "speed=0", "--at", "throttle=0.5", "--at", "height=0"),
            ("no equilibrium at",),
        ),
        (("winged_cone", "--at", "speed=-2600", "--at", "height=0"), ("angle_of_attack is", "deg", "is valid from")),
        (
            ("winged_cone", "--structure", "known_air_quasi_steady", "--at", "height=-24000"),
            ("--at: height is", "is valid from"),
        ),
        (
            ("winged_cone", "--at", "speed=-1e4"),
            ("--at: speed is -1e+04 m/s", "is valid from", "deviations from 4590.29"),
        ),  # it would fly backwards
        (("winged_cone", "--at", "height=-5.3e6"), ("--at: height is -5.3e+06 m", "is valid from")),  # underground
    ],
)
def test_what_can_t_be_is_reported_in_a_line(trim, arguments, words):
    refused(trim(*arguments), *words)


def test_a_record_beyond_the_validity_is_refused_by_its_state():
    rig = rigs.load("winged_cone")
    states = np.zeros((4, 7))
    check_valid(rig, states, "flight")
    states[2, 3] = 0.1
    with pytest.raises(UserError, match=r"flight: angle_of_attack is 0\.1 rad \(5\.73 deg\), and winged_cone is valid"):
        check_valid(rig, states, "flight")


@pytest.mark.slow
def test_from_a_flight_to_what_is_known_and_how_far_it_predicts(call, tmp_path: Path):
    """simulate, identify, evaluate: groups are named, the open run is refused, and other scores stand in its place."""
    command = partial(call, app.main, "hybrid-sysid")
    bag, model = tmp_path / "flight", tmp_path / "model"
    reported = ("--rig", "winged_cone")
    assert command("simulate", "flight", bag, *reported, "--seed", 1, "--duration", 100, "--rate", 50)[0] == 0
    options = ("--structure", "known_air", "--part", "0.6:1", "--out", model)
    coarse = ("--step", "0.005", "--period", "0.05")
    refused(command("identify", bag, *reported, *options, *coarse), "give a period as long as the step")
    status, out, _ = command("identify", bag, *reported, *options)  # with the rig's own step and period
    assert status == 0
    assert "known together: area density / mass" in out
    assert "known together: elevator_moment" in out
    assert "closed by the stabiliser" in out
    status, out, _ = command("evaluate", model, bag)
    assert status == 0
    assert "open free run over 100 s is meaningless for an unstable system" in out
    assert "closed loop, from the commands alone" in out
    assert "20 s" in out
    page = tmp_path / "report.html"
    assert command("evaluate", model, bag, "--part", "0.9:1", "--report", page)[0] == 0
    assert "Run under the stabiliser" in page.read_text()
