"""Closed-loop re-simulation against a loop in plain Python, the rig's own filter and open-loop simulation."""

import dataclasses
import functools

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.shared.resimulation import resimulate
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.rigs.excitation import multisine, random_steps, swept_sine
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import LowPassFilter
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError

LOADED = rigs.load("cam_beam")
RIG = dataclasses.replace(LOADED, system=CamBeam(centre=0.0))  # rests at 0 without input
EXACT = Sampling(step=RIG.step)


def law(rig: Rig, reference: float, filtered: float) -> float:
    """u = gain (reference - yf) within the limit, in volts."""
    error = rig.experiments.loops[0].gain * (reference - filtered) / rig.display[0].scale
    return float(np.clip(error, -rig.actuators[0].high, rig.actuators[0].high))


def driven(rig=RIG, *, amplitude=4.0, duration=4.0, error=0.0) -> Record:
    """The noiseless rig under its own controller, tick by tick: .1 s at rest, then a multisine, which the sensor shows
    with an error.
    """
    ticks = round(duration / rig.step) + 1
    time = rig.step * np.arange(ticks)
    moving = multisine(3, amplitude=amplitude, low=0.2, high=2.0, lines=12, period=duration)(time)
    reference = rig.display[0].si(np.where(time < 0.1, 0.0, moving))
    plant, wrong = Plant(rig, seed=0, noisy=False), LowPassFilter(rig.sensors[0].low_pass, rig.step)
    rows = []
    for k in range(ticks):
        seen = plant.measure()
        u = law(rig, reference[k], seen.filtered[0] + wrong.value)
        wrong.advance(error if time[k] >= 0.1 else 0.0)
        rows.append((seen.outputs[0], seen.filtered[0], u))
        plant.advance(u)
    position, filtered, u = np.array(rows).T
    channels = {"reference": reference, "filtered": filtered}
    return Record(name="loop", time=time, input=u[:, None], output=position[:, None], channels=channels)


@pytest.fixture(scope="module")
def loop() -> Record:
    return driven()


def test_the_rig_itself_does_the_experiment_again_exactly(loop):
    again = resimulate(RIG.system, loop, RIG, sampling=EXACT)
    np.testing.assert_allclose(again.simulated, loop.output[:, 0], atol=1e-9)
    np.testing.assert_allclose(again.simulated_input, loop.input[:-1, 0], atol=1e-6)
    assert again.output.r2 == pytest.approx(1.0)
    assert again.input.r2 == pytest.approx(1.0)


def test_what_limits_the_input_limits_it_again():
    record = driven(amplitude=12.0)
    again = resimulate(RIG.system, record, RIG, sampling=EXACT)
    assert np.max(np.abs(again.simulated_input)) == RIG.actuators[0].high
    np.testing.assert_allclose(again.simulated, record.output[:, 0], atol=1e-9)


@pytest.mark.parametrize("handling", ["averaged", "sampled"])
@pytest.mark.parametrize("step", [0.001, 0.005, 0.01])
def test_output_and_input_are_those_of_one_loop(loop, step, handling):
    """The model answers the input as in open loop, and the rig's controller the output on its straight lines."""
    sampling = Sampling(step=step, input=handling, initial="first")
    again = resimulate(RIG.system, loop, RIG, sampling=sampling)
    ticks = round(step / RIG.step)
    assert RIG.sensors[0].low_pass is not None
    low_pass, u = LowPassFilter(RIG.sensors[0].low_pass, RIG.step), []
    low_pass.reset(0.0)
    line = np.interp(RIG.step * np.arange(ticks * (len(again.time) - 1)), again.time, again.simulated)
    for reference, y in zip(loop.channels["reference"], line, strict=False):
        u.append(law(RIG, reference, low_pass.value))
        low_pass.advance(y)
    blocks = np.reshape(u, (-1, ticks))
    np.testing.assert_allclose(again.simulated_input, blocks.mean(axis=1), atol=1e-4)
    first = np.repeat(blocks[:: sampling.every, 0], sampling.every)[: len(blocks)]
    inputs = blocks.mean(axis=1) if handling == "averaged" else first
    open_loop = simulate(RIG.system, np.zeros(2), inputs[:, None], step=step)
    np.testing.assert_allclose(again.simulated, open_loop[:, 0], atol=1e-6)


def test_a_finer_step_changes_little(loop):
    coarse = resimulate(RIG.system, loop, RIG, sampling=Sampling(step=0.005))
    assert coarse.output.r2 > 0.995


def test_a_part_begins_with_the_filter_as_it_was(loop):
    again = resimulate(RIG.system, loop, RIG, sampling=EXACT, part=Part(start=0.5))
    assert again.input.r2 > 0.9999
    assert again.simulated_input[0] == pytest.approx(loop.input[round(0.5 * loop.samples), 0], abs=1e-6)


def test_slower_records_are_scored_at_their_samples(loop):
    slow = thinned(loop, 5)
    again = resimulate(RIG.system, slow, RIG, sampling=EXACT)
    np.testing.assert_array_equal(again.time, slow.time)
    assert again.output.r2 > 0.999
    assert again.input.r2 > 0.999


def test_a_wrong_model_is_scored_lower(loop):
    assert resimulate(CamBeam(centre=0.0, gain=2.0), loop, RIG, sampling=EXACT).output.r2 < 0.95


def without(record, name):
    return dataclasses.replace(record, channels={k: v for k, v in record.channels.items() if k != name})


def test_records_without_a_whole_reference_are_refused(loop):
    unknown = np.where(np.arange(loop.samples) == 7, np.nan, loop.channels["reference"])
    hole = dataclasses.replace(loop, channels={"reference": unknown})
    for record, reason in ((without(loop, "reference"), "no channel reference"), (hole, "unknown at sample 7")):
        with pytest.raises(UserError, match=reason):
            resimulate(RIG.system, record, RIG, sampling=EXACT)


@dataclasses.dataclass(frozen=True)
class Driver:
    """The rig's law times a gain; or the MPC that ships, an approximate one, on the plant's state, every 50 ms."""

    gain: float = 1.0
    mpc: bool = False


MPC = Driver(mpc=True)
EVERY = [1, 5, 10, 50]  # ms


@functools.cache
def noisy_loop(driver: Driver, kind: str) -> Record:
    """20 s of the rig with its noise and a bias, at 1 kHz, as it ships."""
    reference = {
        "multisine": multisine(1, amplitude=4.5, low=0.05, high=2.5, lines=40, period=20.0),
        "steps": random_steps(2, amplitude=4.5, hold=1.5, duration=20.0),
        "sweep": swept_sine(amplitude=3.0, low=0.05, high=2.0, duration=20.0),  # the MPC's is nearest to the law's here
    }[kind]
    rig = LOADED
    mpc = policies.load(configuration.shipped(rig.name, "policy"))
    plant = Plant(rig, seed=0, bias=0.03)
    time = rig.step * np.arange(round(20.0 / rig.step) + 1, dtype=np.float64)
    wanted = rig.display[0].si(reference(time))
    u, rows = 0.0, []
    for k in range(len(time)):
        seen = plant.measure()
        if not driver.mpc:
            u = law(rig, wanted[k], seen.filtered[0]) * driver.gain
        elif k % round(mpc.problem.period / rig.step) == 0:
            preview = rig.display[0].si(reference(plant.time + mpc.problem.period * np.arange(1, mpc.horizon + 1)))
            u = float(mpc.control(plant.state, np.zeros(1), np.array([u]), preview[:, None]).input[0])
            mpc.prepare(mpc.problem.period)
        rows.append((seen.outputs[0], seen.filtered[0], u))
        plant.advance(u)
    position, filtered, given = np.array(rows).T
    channels = {"reference": wanted, "filtered": filtered}
    return Record(name="loop", time=time, input=given[:, None], output=position[:, None], channels=channels)


def thinned(record: Record, every: int) -> Record:
    """One sample in so many, with the mean inputs between them."""
    chosen = slice(None, None, every)
    return dataclasses.replace(
        record,
        time=record.time[chosen],
        output=record.output[chosen],
        input=np.append(record.input[:-1].reshape(-1, every).mean(axis=1), 0.0)[:, None],
        channels={name: values[chosen] for name, values in record.channels.items()},
    )


@pytest.mark.parametrize("known", [True, False], ids=["filtered", "not filtered"])
@pytest.mark.parametrize(("kind", "every"), [*(("sweep", every) for every in EVERY), ("multisine", 1), ("steps", 50)])
@pytest.mark.parametrize("driver", [Driver(), MPC], ids=["law", "mpc"])
def test_the_rig_s_own_loop_is_told_from_one_of_the_mpc(driver, kind, every, known):
    """Whatever the rate of the record, and also where the filtered position has to be made of the noisy output."""
    record = thinned(noisy_loop(driver, kind), every)
    record = record if known else without(record, "filtered")
    sampling = Sampling(step=RIG.step, period=0.05)
    if driver.mpc:
        with pytest.raises(UserError, match=r"loop: .* of its inputs are not those of the rig's controller"):
            resimulate(LOADED.system, record, LOADED, sampling=sampling)
    else:
        assert resimulate(LOADED.system, record, LOADED, sampling=sampling).output.r2 > 0.9


@pytest.mark.parametrize("gain", [0.9, 1.1])
def test_a_loop_of_nearly_the_rig_s_law_is_none_of_its_own(gain):
    """Its input is told by the law to an R2 of .99 and yet is another one."""
    record = noisy_loop(Driver(gain=gain), "multisine")
    with pytest.raises(UserError, match="are not those of the rig's controller"):
        resimulate(LOADED.system, record, LOADED, sampling=EXACT)


def test_a_few_lost_samples_make_no_other_controller(loop):
    given = loop.input.copy()
    given[1000:1100] = given[1000]
    assert resimulate(RIG.system, dataclasses.replace(loop, input=given), RIG, sampling=EXACT).output.r2 > 0.99


def test_a_record_without_its_filtered_position_begins_settled(loop):
    again = resimulate(RIG.system, without(loop, "filtered"), RIG, sampling=EXACT)
    assert again.output.r2 == pytest.approx(1.0)


def test_a_step_that_the_rig_has_not_is_refused(loop):
    with pytest.raises(UserError, match="no multiple of the step"):
        resimulate(RIG.system, loop, RIG, sampling=Sampling(step=0.0025))


def test_the_real_records_are_loops_of_this_law(experiments):
    for item in experiments.values():
        if item.reference is None or item.filtered is None:
            continue
        error = LOADED.experiments.loops[0].gain * (item.reference - item.filtered)
        np.testing.assert_allclose(
            item.input, np.clip(error, -LOADED.actuators[0].high, LOADED.actuators[0].high), atol=1e-6
        )


def test_a_loop_with_an_integral_part_is_not_done_again_without_it(loop):
    experiments = RIG.experiments
    slow = dataclasses.replace(experiments, loops={0: dataclasses.replace(experiments.loops[0], integral=0.01)})
    with pytest.raises(UserError, match="integral"):
        resimulate(RIG.system, loop, dataclasses.replace(RIG, experiments=slow), sampling=EXACT)


def test_an_error_of_the_output_goes_round_the_loop(loop):
    error = np.where(loop.time < 0.1, 0.0, 0.01)
    again = resimulate(RIG.system, loop, RIG, sampling=EXACT, output_error=error)
    np.testing.assert_allclose(again.simulated, driven(error=0.01).output[:, 0], atol=1e-9)
    assert np.ptp(again.simulated - loop.output[:, 0]) > 0.005
