"""Rollouts: delays of inputs by hand, records apart from each other, outputs beside states."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from hybrid_sysid_ros.core import RungeKutta, System, bounded, rollouts, simulate
from tests.structures import ThrusterCart


def seen_through(inputs, delay, step, parts=1000):
    """Means over each step of a held input that comes late, by counting fine parts of the steps."""
    middle = (np.arange(len(inputs) * parts) + 0.5) * step / parts - delay
    index = np.clip(np.floor(middle / step).astype(int), 0, None)
    return inputs[index].reshape(len(inputs), parts).mean(axis=1)


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.010, 0.0125, 0.0021])
def test_a_delay_shifts_the_held_input_and_averages_it_over_each_step(slider, delay):
    inputs = np.random.default_rng(0).uniform(3, 9, 60)
    late = simulate(dataclasses.replace(slider, input_delay=delay), np.zeros(2), inputs[:, None], step=0.005)
    shifted = simulate(slider, np.zeros(2), seen_through(inputs, delay, 0.005)[:, None], step=0.005)
    np.testing.assert_allclose(late, shifted, rtol=2e-3, atol=1e-5)


def test_a_delay_of_two_and_a_half_steps_by_hand(slider):
    inputs = np.array([[4.0], [6.0], [3.0], [9.0], [9.0]])
    system = dataclasses.replace(slider, input_delay=0.25)
    speeds = simulate(system, np.zeros(2), inputs, step=0.1)[:, 1]
    # The input seen is 4 until 0.35 s, 6 until 0.45 s, then 3: its means over each 0.1 s follow.
    np.testing.assert_allclose(np.diff(speeds) / 0.1 + 2.0, [4.0, 4.0, 4.0, 5.0, 4.5])


def test_two_inputs_act_each_after_its_own_delay():
    """By a step of .1 s: the left one after one step, the right one after two and a half."""
    inputs = np.array([[4.0, 0.0], [5.0, 4.0], [4.0, 8.0], [4.0, 8.0], [4.0, 8.0]])
    speeds = simulate(ThrusterCart(), np.zeros(2), inputs, step=0.1)[:, 1]
    seen = np.array([4.0, 4.0, 5.0, 4.0, 4.0]) + np.array([0.0, 0.0, 0.0, 2.0, 6.0])
    np.testing.assert_allclose(np.diff(speeds) / 0.1, seen - 2.0)
    assert ThrusterCart().delay == 0.25


def test_outputs_are_a_map_of_states_and_of_the_inputs_that_act():
    inputs = np.array([[4.0, 0.0], [5.0, 4.0], [4.0, 8.0], [4.0, 8.0], [4.0, 8.0]])
    states, outputs = rollouts(ThrusterCart(), np.array([[0, 0, 6, 0]]), np.zeros((1, 2)), inputs, step=0.1)
    seen = np.array([4.0, 4.0, 5.0, 6.0, 10.0, 12.0])  # behind its end the record's last input holds
    np.testing.assert_allclose(outputs, np.column_stack([states[:, 0], seen - 3.0 * states[:, 1]]), rtol=1e-13)


def test_every_record_of_several_begins_with_its_own_input(slider):
    """No input leaks from the record before through the delay."""
    system = dataclasses.replace(slider, input_delay=0.012)
    inputs = np.concatenate([np.full((40, 1), 9.0), np.full((40, 1), 3.0)])
    states, _ = rollouts(
        system, np.array([[0, 0, 9, 0], [40, 40, 9, 9]]), np.zeros((2, 2)), inputs, step=0.005, every=5
    )
    np.testing.assert_array_equal(states[9:], simulate(system, np.zeros(2), inputs[40:], step=0.005, every=5))


@dataclass(frozen=True, kw_only=True)
class Cooling(System):
    """T' = -k T, which nobody drives."""

    states = ("temperature [K]",)
    stepper = RungeKutta()

    rate: float = bounded(2.0, 0.0, 10.0, unit="1/s")
    """Of the loss."""

    def law(self, x, u):
        return (-self.rate * x[0],)


def test_a_system_without_inputs_runs_by_itself():
    states = simulate(Cooling(), np.array([10.0]), np.empty((100, 0)), step=0.01)
    np.testing.assert_allclose(states[:, 0], 10.0 * np.exp(-2.0 * 0.01 * np.arange(101)), rtol=1e-7)
    assert Cooling().delay == 0.0


@pytest.mark.parametrize(("state", "inputs"), [((3,), (10, 1)), ((2,), (10, 2)), ((2,), (10,))])
def test_arrays_of_other_sizes_are_refused(slider, state, inputs):
    """Compiled code would read and write behind their ends."""
    with pytest.raises(ValueError, match=r"\d"):
        simulate(slider, np.zeros(state), np.zeros(inputs), step=0.01)
