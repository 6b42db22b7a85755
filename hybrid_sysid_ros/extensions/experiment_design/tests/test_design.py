"""Information in closed form, the best inputs of a first-order lag, and an experiment within its limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import ImplicitFriction, RungeKutta, Sensitivities, System, bounded, rollouts, simulate
from hybrid_sysid_ros.extensions.experiment_design import search
from hybrid_sysid_ros.extensions.experiment_design.design import designed, expected
from hybrid_sysid_ros.extensions.experiment_design.information import Fisher, Knowledge
from hybrid_sysid_ros.extensions.experiment_design.looped import looped
from hybrid_sysid_ros.extensions.experiment_design.plan_folder import SIGNALS, save_plan
from hybrid_sysid_ros.extensions.experiment_design.search import BEYOND, Bench
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.drivers import ExperimentLoop, Experiments
from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.rigs.experiments import driven, excitation
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.rigs.sensor import Sensor
from hybrid_sysid_ros.support.errors import UserError
from tests.rigs.toys import rig_of

NOISE, STEP = 0.01, 0.01
GAIN, LAG = 2.0, 0.5


@dataclass(frozen=True, kw_only=True)
class ValveLag(System):
    """y' = (K u - y) / T."""

    states = ("level [m]",)
    inputs = ("valve [1]",)
    stepper = RungeKutta()

    gain: float = bounded(GAIN, 0.1, 10.0, unit="m")
    lag: float = bounded(LAG, 0.05, 5.0, unit="s")

    def law(self, x: Any, u: Any) -> Any:
        return [(self.gain * u[0] - x[0]) / self.lag]


def rig(**changes: Any) -> Rig:
    return rig_of(ValveLag(), step=STEP, limit=1.0, sensors={"level": Sensor(unit="m", white_noise=NOISE)}, **changes)


def model(*, deviation: float = 0.1, step: float = STEP) -> Model:
    return Model(
        rig="toy", structure="gray", system=ValveLag(), sampling=Sampling(step=step, period=step),
        names=("gain", "lag"), covariance=np.diag([deviation**2, deviation**2]),
        training_range={"valve": (-1.0, 1.0), "level": (-GAIN, GAIN)},
    )  # fmt: skip


def fisher() -> Fisher:
    return Fisher(
        sensitivities=Sensitivities(ValveLag(), states=[]), sampling=model().sampling, sizes=np.ones(2),
        weight=np.array([NOISE**-2]),
    )  # fmt: skip


def test_the_information_of_a_step_is_that_of_its_response() -> None:
    """y = K (1 - e), dy/dK = 1 - e, dy/dT = -K t e / T^2, with e = exp(-t / T)."""
    times = np.arange(401) * STEP
    e = np.exp(-times / LAG)
    slopes = np.stack([1.0 - e, -GAIN * times * e / LAG**2])
    found = fisher().information(ValveLag(), np.ones((400, 1)))
    np.testing.assert_allclose(found, slopes @ slopes.T / NOISE**2, rtol=1e-6)


def test_a_beginning_that_is_not_known_takes_what_it_could_explain() -> None:
    """S' R^-1 S with R = s^2 I + b^2 e e', as y begins within b and forgets it as e = exp(-t / T)."""
    inputs, begin = np.sin(np.arange(300) * STEP)[:, None], 0.05
    with_start = replace(fisher(), sensitivities=Sensitivities(ValveLag()), begins=np.array([begin]))
    slopes, e = fisher().tangents(ValveLag(), inputs)[:, 0], np.exp(-np.arange(301) * STEP / LAG)
    noise = NOISE**2 * np.eye(len(slopes)) + begin**2 * np.outer(e, e)
    found = with_start.information(ValveLag(), inputs)
    np.testing.assert_allclose(found, slopes.T @ np.linalg.solve(noise, slopes), rtol=1e-5)


@dataclass(frozen=True, kw_only=True)
class SteppedLag(ValveLag):
    """By Euler's method."""

    stepper = ImplicitFriction()  # type: ignore[assignment]


def test_what_a_step_moves_in_a_fit_is_known_beforehand() -> None:
    """Euler's 1 - h / T' is exp(-h / T) at T' = T + h / 2; the gain is that of the rest."""
    euler = replace(fisher(), sensitivities=Sensitivities(SteppedLag(), states=[]))
    information, pull = euler.shown(SteppedLag(), np.sin(np.arange(1000) * STEP)[:, None])
    gain, lag = np.linalg.solve(information, pull)
    assert lag == pytest.approx(0.5 * STEP, rel=0.05)
    assert abs(gain) < 0.1 * STEP
    known = Knowledge(names=("gain", "lag"), sizes=np.ones(2), information=1e-6 * np.eye(2))
    assert known.deviations(information, pull)[1] == pytest.approx(np.hypot(known.deviations(information)[1], lag))


@dataclass(frozen=True, kw_only=True)
class EndingLag(ValveLag):
    """A law that is held from the highest level of its training on."""

    level_high: float = bounded(0.4, 0.0, 10.0, unit="m", fixed=True)

    def trained_on(self, low: Any, high: Any) -> EndingLag:
        return replace(self, level_high=float(high[0]))


@pytest.mark.usefixtures("short")
def test_an_experiment_stays_near_what_was_trained_where_the_law_ends_there_and_not_for_new_cells() -> None:
    everywhere = replace(model(), training_range={"valve": (-1.0, 1.0), "level": (-0.4, 0.4)})
    narrow = replace(everywhere, system=EndingLag())
    found = designed(narrow, rig(), seconds=8.0, period=STEP)
    assert 0.4 < np.abs(found.outputs).max() <= 0.4 + BEYOND * 0.8
    for trained, known in ((narrow, False), (everywhere, True)):
        free = Bench(model=trained, rig=rig(), seconds=8.0, period=STEP, amplitude=0.9, known=known)
        assert free.within(np.full((3, 1), 1.5))


def test_a_lag_is_determined_best_by_a_sine_at_its_corner() -> None:
    """|dG/dT| = K w / (1 + w^2 T^2) is largest at w = 1 / T: Goodwin & Payne (1977), chapter 6."""
    times = np.arange(4000) * STEP
    speeds = np.array([0.25, 0.5, 0.8, 1.0, 1.25, 2.0, 4.0]) / LAG
    found = [fisher().information(ValveLag(), np.sin(speed * times)[:, None])[1, 1] for speed in speeds]
    assert speeds[int(np.argmax(found))] == 1.0 / LAG


def test_what_is_known_adds_to_what_is_learned() -> None:
    """Of independent parts deviations add as 1 / s^2; a number without covariance has its prior, or next to nothing."""
    known = Knowledge.of(model(deviation=0.3))
    np.testing.assert_allclose(known.deviations(), 0.3, rtol=1e-4)
    more = np.diag((known.sizes / 0.4) ** 2)
    np.testing.assert_allclose(known.deviations(more), 0.24, rtol=1e-4)
    unknown = Knowledge.of(model(deviation=0.0))
    np.testing.assert_allclose(unknown.deviations(), 1e3 * unknown.sizes)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "FEWEST", 400)
    monkeypatch.setattr(search, "STEPS", 1)


@pytest.mark.usefixtures("short")
def test_a_gain_is_determined_best_by_the_largest_level() -> None:
    """With |u| <= a no input has more information about K than u = a, that of dy/dK = a (1 - e), if all else is known.
    Where the rest is to be found as well, turns of u tell the two apart a little better than u = a.
    """
    found = designed(model(), rig(), seconds=8.0, period=STEP, amplitude=1.0, parameters=("gain",))
    known, full = Knowledge.of(model()), np.ones((800, 1))
    fisher = Fisher.of(model(), rig(), known.sizes)
    fully = expected(found.bench, fisher, known, full)
    most = known.information + replace(fisher, begins=None).information(model().system, full)
    least = known.sizes[0] / np.sqrt(most[0, 0])
    assert least < found.after[0] < 1.15 * fully[0]


@pytest.mark.usefixtures("short")
def test_a_designed_experiment_tells_more_than_steps_and_sines_and_stays_within_travel(tmp_path: Path) -> None:
    """The level may reach 1.2 m, which a valve that is wide open would pass."""
    tight = rig(travel=np.array([[-1.2], [1.2]]))
    found = designed(model(), tight, seconds=8.0, period=0.02, amplitude=1.0)
    assert np.abs(found.outputs).max() < 1.2
    assert found.bench.feasible(found.driving) == 1.0
    assert np.all(np.abs(found.inputs) <= 1.0)
    after, times = float(np.max(found.after / [GAIN, LAG])), np.arange(800, dtype=np.float64) * STEP
    known, bench = Knowledge.of(model()), found.bench
    for other in (0.5 * np.sin(2 * np.pi * times), 0.55 * np.sign(np.sin(np.pi * times + 0.01))):
        assert bench.feasible(other[:, None]) == 1.0
        more = fisher().information(ValveLag(), other[:, None]) * np.outer(known.sizes, known.sizes)
        assert after < float(np.max(known.deviations(more) / known.sizes))
    save_plan(tmp_path / "plan", found)
    played = excitation(tight, str(tmp_path / "plan" / SIGNALS), seed=0, duration=8.0, times=times)
    np.testing.assert_allclose(played, found.driving, rtol=1e-6, atol=1e-8)


@pytest.mark.usefixtures("short")
def test_a_plan_is_no_worse_than_the_rig_s_own_experiments_by_its_criterion(monkeypatch: pytest.MonkeyPatch) -> None:
    """With no trial it is the best of these; of a level that leaves the travel the largest part that stays within."""
    monkeypatch.setattr(search, "FEWEST", 0)
    monkeypatch.setattr(search, "MOST", 0)
    slow = Excitation(kind="sine", numbers={"amplitude": 0.5, "frequency": 0.05})
    corner = Excitation(kind="sine", numbers={"amplitude": 0.9, "frequency": 1.0 / (2.0 * np.pi * LAG)})
    own = rig(experiments=Experiments(excitations={"slow": {0: slow}, "corner": {0: corner}}))
    found = designed(model(), own, seconds=20.0, period=STEP, amplitude=1.0, parameters=("lag",))
    times = np.arange(2000, dtype=np.float64) * STEP
    np.testing.assert_allclose(found.driving[:, 0], 0.9 * np.sin(times / LAG), atol=1e-9)
    tight = replace(own, travel=np.array([[-0.8], [0.8]]))  # the corner's level is 0.9 * 2 / sqrt(2)
    kept = designed(model(), tight, seconds=20.0, period=STEP, amplitude=1.0, parameters=("lag",))
    np.testing.assert_allclose(kept.driving[:, 0], 0.4 * 0.9 * np.sin(times / LAG), atol=1e-9)


def test_a_loop_s_inputs_are_those_that_it_would_give() -> None:
    """u = g (r - y) within limits: y' = (K g (r - y) - y) / T settles at K g r / (1 + K g)."""
    driven = rig(
        experiments=Experiments(loops={0: ExperimentLoop(output=0, gain=0.5)}), travel=np.array([[-9.0], [9.0]])
    )
    bench = Bench(model=model(), rig=driven, seconds=8.0, period=STEP, amplitude=1.0)
    inputs, outputs = bench.run(ValveLag(), np.full((800, 1), 1.0))
    assert outputs[-1, 0] == pytest.approx(GAIN * 0.5 / (1.0 + GAIN * 0.5), rel=1e-3)
    assert inputs[0, 0] == pytest.approx(0.5)
    assert inputs[-1, 0] == pytest.approx(outputs[-1, 0] / GAIN, rel=1e-3)
    saturated, _ = bench.run(ValveLag(), np.full((800, 1), 9.0))
    assert saturated.max() == 1.0


def test_what_is_too_fast_for_the_model_s_step_is_none_that_could_be() -> None:
    """A step of 0.2 s bears lags down to 0.07 s, and a deviation of 4 s leaves 0.05 s open, the lowest bound."""
    wide = Bench(model=model(deviation=4.0, step=0.2), rig=rig(), seconds=60.0, period=0.2, amplitude=0.9)
    assert all(system.named["lag"] > 0.07 for system in wide.systems)
    assert len(Bench(model=model(), rig=rig(), seconds=60.0, period=STEP, amplitude=0.9).systems) > len(wide.systems)
    found = designed(wide.model, rig(), seconds=20.0, period=0.2)
    assert np.all(found.after < found.before)
    with pytest.raises(UserError, match="fewer than 20 samples"):
        designed(wide.model, rig(), seconds=0.1, period=0.2)


def test_what_can_not_be_designed_for_is_refused() -> None:
    with pytest.raises(UserError, match="parameter 'lags' is no fitted one of this model; it has gain, lag"):
        designed(model(), rig(), seconds=8.0, period=STEP, parameters=("lags",))
    held = rig(experiments=Experiments(stabiliser=np.ones((1, 1))))
    with pytest.raises(UserError, match="toy is driven by a feedback or a stabiliser"):
        designed(model(), held, seconds=8.0, period=STEP)
    loose = rig(experiments=Experiments(loops={0: ExperimentLoop(output=0, gain=0.5)}))
    with pytest.raises(UserError, match="the reference of a loop has no limits: declare travel of level"):
        designed(model(), loose, seconds=8.0, period=STEP)


@pytest.mark.usefixtures("short")
def test_an_experiment_goes_where_records_have_not_been() -> None:
    """Of a record whose valve was never closed half, the cells of (level, valve) with u < 0 are new."""
    times = np.arange(801, dtype=np.float64) * STEP
    given = 0.5 + 0.5 * np.sin(times)
    states = simulate(ValveLag(), np.zeros(1), given[1:, None], step=STEP)
    record = Record(name="open", time=times, input=given[:, None], output=states)
    walled = rig(travel=np.array([[-2.5], [2.5]]))
    found = designed(model(), walled, seconds=8.0, period=STEP, amplitude=1.0, records=[record])
    assert found.visits is not None
    visited, new, total = found.visits
    assert total == 64
    assert 0 < visited < 32
    assert new > 12
    assert found.inputs.min() < -0.5


def test_a_designed_loop_knows_the_low_pass_that_it_feeds_back_and_how_late_its_input_acts() -> None:
    """Against the simulated beam, whose loop feeds a low-pass of sixth order back: its reference makes other inputs."""
    rig, step = load_rig("cam_beam"), 0.001
    jumps = np.random.default_rng(0).uniform(-0.08, 0.08, 10).repeat(400)[:, None]
    plant = Plant(rig, seed=0, noisy=False)
    given = np.array([applied[0] for applied in driven(plant, jumps)])

    def error(used: Rig) -> float:
        loop = looped(used.system, used, step)
        starts, first = search.run_of(loop, len(jumps) + 1)
        states, _ = rollouts(loop, starts, first, jumps, step=step)
        return float(np.std(loop.inputs_of(states[:-1], jumps)[:, 0] - given) / np.std(given))

    prompt = rig.system.with_values([*(rig.system.named | {"input_delay": 0.0}).values()])
    at_once = replace(rig, system=prompt)
    without = replace(rig, sensors=(replace(rig.sensors[0], low_pass=None),))
    assert error(rig) < 0.05 < 0.15 < min(error(at_once), error(without))
