"""Records that contradict the physics of their rig by one number, and records that repeat themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import RungeKutta, System, bounded, simulate
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.extensions.record_check.tests.records import RIG, record
from hybrid_sysid_ros.rigs.sensor import Sensor
from tests.linear_bench import held_levels
from tests.rigs.toys import rig_of

HOT, COLD = 80.0, 18.0


@dataclass(frozen=True, kw_only=True)
class HeatedVessel(System):
    """T' = q (80 K - T) - loss (T - 18 K): of another flow q it has another mean and another pace."""

    states = ("reading [K]",)
    inputs = ("flow [1/s]",)
    stepper = RungeKutta()

    loss: float = bounded(0.02, 0.001, 1.0, unit="1/s")

    def law(self, x: Any, u: Any) -> Any:
        return [u[0] * (HOT - x[0]) - self.loss * (x[0] - COLD)]


RIG_OF_VESSEL = rig_of(HeatedVessel(), step=0.5, limit=0.15, sensors={"reading": Sensor(unit="K", white_noise=0.05)})


def heated(flow: float = 1.0, scale: float = 1.0, offset: float = 0.0) -> Record:
    """A record whose columns are off by factors and an offset."""
    given = held_levels(0, 800, hold=40, low=0.02, high=0.1)
    states = simulate(HeatedVessel(), np.array([50.0]), given[:-1], step=0.5)
    noisy = states + 0.05 * np.random.default_rng(0).normal(size=states.shape)
    times = 0.5 * np.arange(800, dtype=np.float64)
    return Record(name="heated", time=times, input=flow * given, output=scale * noisy + offset)


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"flow": 0.5}, "scale", "flow is taken 2 times"),
        ({"scale": 1.5}, "scale", "reading is taken 0.667 times"),
        ({"offset": 20.0}, "zero", "reading is taken 20 K lower"),
    ],
)
def test_a_factor_or_an_offset_in_a_law_that_is_no_line_is_named_with_its_size(changes, kind, words) -> None:
    found = findings_of(heated(**changes), RIG_OF_VESSEL)[0]
    assert found.kind == kind
    assert words in found.words


def test_a_record_that_its_physics_explain_contradicts_nothing() -> None:
    assert findings_of(heated(), RIG_OF_VESSEL) == []


def test_a_record_that_is_glued_to_itself_repeats_its_rows() -> None:
    r = record()
    twice = {key: np.concatenate([getattr(r, key), getattr(r, key)]) for key in ("input", "output")}
    times = r.sampling_time * np.arange(2 * r.samples)
    found = findings_of(replace(r, time=times, measured=None, **twice), hs.load_rig(RIG))[0]
    assert found.kind == "repetition"
    assert f"samples {r.samples} to {2 * r.samples - 1} are those from 0 on" in found.words
