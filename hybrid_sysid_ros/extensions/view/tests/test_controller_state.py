"""The state that a page shows: what a controller says of itself, or what its diagnostics amount to."""

from __future__ import annotations

import pytest

from hybrid_sysid_ros.extensions.view.controller_state import ControllerState


def test_a_controller_that_names_its_state_is_believed() -> None:
    state = ControllerState()
    values = {"state": "slowed", "state_reason": "the sensor is frozen", "layer_zeroed": "7"}
    assert state.read("running", values) == ("slowed", "the sensor is frozen")
    assert state.read("stopped until ...", {"state": "disarmed"}) == ("disarmed", "")
    state.read("running", {"state": "driving", "layer_zeroed": "7"})
    assert state.read("running", {"state": "resting", "layer_zeroed": "9"})[1].startswith("nothing sound")


@pytest.mark.parametrize(
    ("message", "wanted"),
    [
        ("running", "driving"),
        ("3 plans late, of 80", "driving"),
        ("holding the outputs until the service enable is called", "holding"),
        ("stopped until the service enable is called", "stopped"),
        ("waiting for estimates", "resting"),
    ],
)
def test_a_status_tells_the_state(message: str, wanted: str) -> None:
    assert ControllerState().read(message, {"policy": "exact"})[0] == wanted


def test_the_layer_that_answered_tells_the_state() -> None:
    state = ControllerState()
    counts = {"layer_held": "0", "layer_zeroed": "5", "layer_policy": "100"}
    assert state.read("running", counts)[0] == "driving"  # what was before counts no more
    counts = {**counts, "layer_held": "4"}
    assert state.read("4 commands held, of 20", counts)[0] == "holding"
    counts = {**counts, "layer_held": "8", "layer_zeroed": "9"}
    assert state.read("commands at rest", counts)[0] == "resting"
    assert state.read("running", {**counts, "layer_policy": "180"})[0] == "driving"
