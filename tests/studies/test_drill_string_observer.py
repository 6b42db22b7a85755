"""The observer of the bit's speed, on the simulated drill string, whose values and states are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.experiments import driven, excitation
from hybrid_sysid_ros.rigs.plant import Plant
from studies.drill_string import stops
from studies.drill_string.choice import FilterNoises
from studies.drill_string.observer import aligned, balance, estimated, identified

LATE, SECONDS = 20, 20
CHOICE = FilterNoises(
    torque_noise=0.02, twist_noise=0.003, speed_noise=0.1, brake_noise=0.3, top_noise=0.03, fade=5.0, stuck_below=0.3
)
"""For torques ten times smaller than the public record's."""


@pytest.fixture(scope="module")
def rig():
    return rigs.load("drill_string")


def simulated(rig, seed, *, hand=False):
    """Stick-slip under the speed loop: torque LATE samples late, noise on it and on the top's speed."""
    times = rig.step * np.arange(1000 * SECONDS)
    wanted = excitation(rig, "slow", seed=seed, duration=float(SECONDS), times=times)
    plant, random = Plant(rig, seed=seed, bias=rig.bias, disturbed=hand), np.random.default_rng(seed)
    steps, states = driven(plant, wanted), []
    for _ in range(len(times) - 1):
        states.append(plant.state.copy())
        next(steps)
    x = np.array(states)
    system, bit = rig.system, x[:, 1]
    shaft = -system.stiffness * x[:, 0] - system.shaft_damping * (bit - x[:, 2])
    torque = shaft - system.bit_inertia * np.gradient(bit, rig.step)
    top = x[:, 2:3] + random.normal(0.0, 0.02, (len(x), 1))
    output = np.column_stack([bit[:-LATE], torque[:-LATE]])
    output[LATE:, 1], output[:LATE, 1] = torque[: -2 * LATE], torque[0]
    output[:, 1] += random.normal(0.0, 0.005, len(output))
    return Record(name="simulated", time=rig.step * np.arange(len(output)), input=top[:-LATE], output=output)


def test_the_balance_tells_shaft_inertia_and_delay(rig):
    found = balance(simulated(rig, 1, hand=True))
    assert found.delay == pytest.approx(LATE * rig.step, abs=0.002)
    assert found.stiffness == pytest.approx(rig.system.stiffness, rel=0.03)
    assert found.inertia == pytest.approx(rig.system.bit_inertia, rel=0.1)
    assert found.explained > 0.95


def test_stuck_samples_are_found_without_the_bits_speed(rig):
    system, found = identified(simulated(rig, 1))
    for seed in (2, 3, 4):
        record = aligned(simulated(rig, seed), found.delay)
        measured, speed = CHOICE.estimated(system, record)
        judged = stops.found(np.abs(measured) < stops.STUCK, np.abs(speed) < CHOICE.stuck_below)
        assert min(judged["precision"], judged["recall"]) > 0.8


def test_the_bits_speed_is_not_read(rig):
    system, _ = identified(simulated(rig, 1))
    record = simulated(rig, 2)
    blind = replace(record, output=record.output * [0.0, 1.0])
    np.testing.assert_array_equal(
        estimated(system, record, CHOICE.tuning)[1], estimated(system, blind, CHOICE.tuning)[1]
    )


def test_stops_that_are_touched_count_as_found():
    """Two true stops, of which one is touched; two that are reported, of which one touches."""
    truth = np.array([1, 1, 1, 0, 0, 1, 1, 0, 0], dtype=bool)
    shown = np.array([0, 0, 1, 1, 0, 0, 0, 0, 1], dtype=bool)
    found = stops.found(truth, shown)
    assert found == pytest.approx(
        {"precision": 1 / 3, "recall": 0.2, "share": 5 / 9, "stop_precision": 0.5, "stop_recall": 0.5, "stops": 2}
    )
