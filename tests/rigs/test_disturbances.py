"""What moves states from outside, as a hand on a brake does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.excitation import Excitation, pulses
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.support.errors import UserError
from tests.rigs.toys import rig_of

NUMBERS = {"amplitude": 6.0, "shortest": 1.0, "longest": 3.0, "apart": 8.0, "rise": 0.2}
STEP = 0.001


@dataclass(frozen=True, kw_only=True)
class Pushed(System):
    """v' = u + w, w a wind."""

    states = ("speed [m/s]", "wind [m/s^2]")
    inputs = ("drive [m/s^2]",)
    outputs = ("speed",)

    def law(self, x: Any, u: Any) -> Any:
        return u[0] + x[1], 0.0


def test_pulses_are_one_in_each_slot_as_long_and_as_high_as_told():
    times = STEP * np.arange(80_000)
    slots = pulses(3, **NUMBERS)(times).reshape(10, 8000)
    for slot in slots:
        up = np.flatnonzero(slot)
        assert np.all(np.diff(up) == 1)
        assert 1.0 - 3 * STEP <= STEP * len(up) <= 3.0
        assert 2.0 <= slot.max() <= 6.0
        assert np.abs(np.diff(slot)).max() <= slot.max() * STEP / 0.2 * 1.001
    assert len({float(slot.max()) for slot in slots}) == 10
    assert not np.array_equal(slots, pulses(4, **NUMBERS)(times).reshape(10, 8000))


def test_a_state_is_moved_from_outside_whatever_the_model_knows():
    """The speed is the integral of the wind; from the same seed it is the same, and undisturbed it is none."""
    wind = Excitation.of({"kind": "pulses", **NUMBERS}, "wind")
    rig = rig_of(Pushed(), disturbances={1: wind})
    plant, blown = Plant(rig, seed=5), []
    for _ in range(3000):
        plant.advance(0.0)
        blown.append(plant.outputs()[0])
    expected = STEP * np.cumsum(pulses(5, **NUMBERS)(STEP * np.arange(3000)))
    np.testing.assert_allclose(blown, expected, atol=1e-12)
    plant.reset(np.zeros(2))
    plant.advance(0.0)
    assert plant.outputs()[0] == blown[0]
    calm = Plant(rig, seed=5, disturbed=False)
    for _ in range(3000):
        calm.advance(0.0)
    assert calm.outputs()[0] == 0.0


@pytest.mark.parametrize(
    ("reported", "message"),
    [
        ("gust: {kind: constant, level: 1.0}", "'gust' is no state"),
        ("wind: {kind: random_steps, amplitude: 1.0, hold: 2.0}", "a random_steps comes to an end"),
        ("wind: {kind: pulses, amplitude: 1.0}", "shortest is missing"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, reported, message):
    (tmp_path / "cart").mkdir()
    (tmp_path / "cart" / "system.py").write_text(
        "from dataclasses import dataclass\n"
        "from hybrid_sysid_ros.core import System\n"
        "@dataclass(frozen=True, kw_only=True)\n"
        "class Cart(System):\n"
        "    states = ('speed [m/s]', 'wind [m/s^2]')\n"
        "    inputs = ('drive [m/s^2]',)\n"
        "    def law(self, x, u):\n"
        "        return u[0] + x[1], 0.0\n"
    )
    values = f"step: 0.001\nactuators: {{drive: {{low: -1.0, high: 1.0}}}}\ndisturbances:\n  {reported}\n"
    (tmp_path / "cart" / "rig.yaml").write_text(values)
    with pytest.raises(UserError, match=message):
        rigs.load(tmp_path / "cart")


def test_pulses_that_do_not_fit_are_refused():
    with pytest.raises(UserError, match="shortest"):
        pulses(0, **{**NUMBERS, "longest": 9.0})
