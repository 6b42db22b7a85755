"""hybrid-sysid export fmu: an FMU simulates as Python does, and refuses what it can't do with a sentence."""

import math
import sys
import zipfile

import numpy as np
import pytest

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.fmu import export
from hybrid_sysid_ros.extensions.export.fmu.fmpy_check import RunningFmu
from hybrid_sysid_ros.extensions.export.simulation.simulation import Simulation
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError

COMPILER = compiler.found() or ""
needs_compiler = pytest.mark.skipif(not COMPILER, reason="needs a C compiler: cc, gcc or clang")


def loaded(name="cam_beam"):
    return load_rig(name), hs.load_model(shipped(name, "model"))


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """The beam's model as a file."""
    pytest.importorskip("fmpy", reason="needs the extra [fmu]")
    rig, model = loaded()
    path = tmp_path_factory.mktemp("fmu") / "beam.fmu"
    done = export.export_simulation(rig, path, model=model, seal="s")
    assert not COMPILER or (done.difference is not None and done.difference <= 1e-12)
    return path


def test_a_model_in_its_rig_s_place_is_the_model():
    rig, model = loaded()
    drive = np.random.default_rng(3).uniform(-9.0, 9.0, (300, 1))
    states, _ = Simulation.of_model("beam", rig, model).run(drive)
    expected = simulate(model.system, np.zeros(2), drive, step=model.sampling.step)
    np.testing.assert_allclose(states, expected, atol=1e-12)


@pytest.mark.parametrize(("period", "steps"), [(1e-4, export.STEPS), (0.005, 400), (14.0, export.HELD)])
def test_a_slow_model_is_compared_over_some_steps(period, steps):
    assert export.steps_of(period) == steps


def test_without_fmpy_it_says_what_to_install(tmp_path, monkeypatch):
    rig, model = loaded()
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(UserError, match=r"checked by FMPy, which is missing.*pip install 'hybrid_sysid_ros\[fmu\]'"):
        export.export_simulation(rig, tmp_path / "beam.fmu", model=model)
    assert not (tmp_path / "beam.fmu").exists()


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"does not end in \.fmu"):
        export.export_simulation(loaded()[0], tmp_path / "beam.zip", model=None)


def test_without_a_compiler_the_sources_go_alone(tmp_path, monkeypatch):
    pytest.importorskip("fmpy", reason="needs the extra [fmu]")
    monkeypatch.setattr(compiler, "found", lambda: None)
    rig, _ = loaded("wheel_motor")
    done = export.export_simulation(rig, tmp_path / "wheel.fmu", model=None)
    names = zipfile.ZipFile(tmp_path / "wheel.fmu").namelist()
    assert (done.by, done.difference) == ("", None)
    assert "sources/wheel_motor_plant_equations.c" in names
    assert not [name for name in names if name.startswith("binaries/")]


@needs_compiler
def test_steps_of_other_lengths_are_refused_and_multiples_are_done(beam):
    period = loaded()[1].sampling.step
    with RunningFmu(beam) as one, RunningFmu(beam) as other:
        for fmu in (one, other):
            fmu.set(["drive"], [4.0])
            fmu.start(at=2.0)
        with pytest.raises(Exception, match="fmi3DoStep failed"):
            one.fmu.doStep(2.0, 1.5 * period)
        with pytest.raises(Exception, match="fmi3DoStep failed"):
            one.fmu.doStep(3.0, period)
        assert "0.0075 s is not a multiple of the period of 0.005 s" in one.messages[0]
        assert "begins at 3 s, but the last one ended at 2 s" in one.messages[1]
        one.fmu.doStep(2.0, 40 * period)
        for k in range(40):
            other.fmu.doStep(2.0 + k * period, period)
        assert one.get(["time"])[0] == pytest.approx(2.0 + 40 * period)
        assert one.get(["position"])[0] == other.get(["position"])[0] > 0.0


@needs_compiler
def test_inputs_keep_their_bounds_and_wrong_values_are_refused_by_name(beam):
    found = []
    for value in (math.nan, 0.0, math.inf, 10.0):
        with RunningFmu(beam) as fmu:
            fmu.start()
            fmu.set(["drive"], [value])
            fmu.fmu.doStep(0.0, 0.5)
            found.append(fmu.get(["position"])[0])
    assert found[0] == found[1] != found[2] == found[3]
    with RunningFmu(beam) as fmu:
        name = next(name for name in fmu.references if name.startswith("parameter."))
        wrong = [("set", [name], [math.nan]), ("set", ["position"], [1.0]), ("set", ["state.velocity"], [math.inf])]
        for call, names, values in wrong:
            with pytest.raises(Exception, match="failed"):
                getattr(fmu, call)(names, values)
        with pytest.raises(Exception, match="failed"):
            fmu.fmu.getFloat64([999])
        with pytest.raises(Exception, match="failed"):
            fmu.fmu.getString([0])
        fmu.start()
        with pytest.raises(Exception, match="failed"):
            fmu.set(["state.velocity"], [1.0])
        messages = "\n".join(fmu.messages)
    assert f"{name} is nan, which is outside of" in messages
    assert "position can't be set." in messages
    assert "state.velocity can't be set after the first step." in messages
    assert "no variable of this type with the value reference 999" in messages
    assert "fmi3GetString is not in this FMU." in messages


@needs_compiler
def test_a_state_comes_back_in_its_own_instance_alone(beam):
    with RunningFmu(beam) as one, RunningFmu(beam) as other:
        one.start()
        other.start()
        one.set(["drive"], [5.0])
        one.fmu.doStep(0.0, 0.1)
        kept = one.fmu.getFMUState()
        one.fmu.doStep(0.1, 0.1)
        first = one.get(["position"])
        one.fmu.setFMUState(kept)
        one.fmu.doStep(0.1, 0.1)
        assert first == one.get(["position"])
        with pytest.raises(Exception, match="failed"):
            other.fmu.setFMUState(kept)
        one.fmu.freeFMUState(kept)
        one.fmu.reset()
        one.start()
        assert one.get(["position"])[0] == one.get(["time"])[0] == 0.0


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("rig", ["drill_string", "flexible_joint", "wheel_motor", "winged_cone", "balancing_robot"])
def test_every_rig_s_model_and_plant_simulates_as_in_python(tmp_path, rig):
    pytest.importorskip("fmpy", reason="needs the extra [fmu]")
    own, model = loaded(rig)
    for given in (model, None):
        done = export.export_simulation(own, tmp_path / "body.fmu", model=given, seal="s", overwrite=True)
        assert done.difference is not None
        assert done.difference <= 1e-9


@pytest.mark.slow
@needs_compiler
def test_a_controller_commands_as_in_python(tmp_path):
    pytest.importorskip("fmpy", reason="needs the extra [fmu]")
    rig, model = loaded("wheel_motor")
    path = tmp_path / "controller.fmu"
    done = export.export_controller(rig, model, path, settings={"real_time": True}, seal="s")
    assert done.difference is not None
    assert done.difference <= 1e-9
    with RunningFmu(path) as fmu:
        fmu.start()
        fmu.set(["measured_speed", "reference_speed"], [math.nan, math.inf])
        fmu.fmu.doStep(0.0, done.period)
        assert np.isfinite(fmu.get(["pwm"])[0])
