"""hybrid-sysid export loop: a loop in C answers as in Python, and what can't be printed is refused by its name."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hybrid_sysid_ros as hs
from benchmarks import loop_fuzz
from hybrid_sysid_ros.control.mpc.calls import FAILED, HELD, NOT_CONVERGED, SOLVED
from hybrid_sysid_ros.estimation import monitored_estimator
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.unit import built, daqp_source, folder, stack_use, unit
from hybrid_sysid_ros.extensions.export.unit.printed_loop import RESTED
from hybrid_sysid_ros.extensions.export.unit.python_loop import loop_in_python
from hybrid_sysid_ros.extensions.export.unit.replay import (
    SPELL,
    PeriodAnswer,
    PeriodQuestion,
    answers_of,
    difference_from,
    largest_difference,
    recorded,
)
from hybrid_sysid_ros.extensions.export.unit.unit import affine_initial_states
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError
from tests.model_samples import model_of

FUZZED = 20_000
"""Calls; ``python -m benchmarks.loop_fuzz`` makes a million of each rig's loop."""
COMPILER = compiler.found() or ""
needs_compiler = pytest.mark.skipif(not COMPILER, reason="needs a C compiler: cc, gcc or clang")


def beam():
    return load_rig("cam_beam"), hs.load_model(shipped("cam_beam", "model"))


def test_without_a_compiler_it_says_what_still_works(tmp_path, monkeypatch):
    rig, model = beam()
    monkeypatch.setattr(compiler, "found", lambda: None)
    with pytest.raises(UserError, match=r"no C compiler \(cc, gcc, clang\).*policy export, model export, .* work"):
        folder.export_loop(rig, model, tmp_path / "unit", settings={}, seal="")
    assert not (tmp_path / "unit").exists()


def test_the_compiler_is_the_one_that_cc_names(tmp_path, monkeypatch):
    own = tmp_path / "mine"
    own.write_text("#!/bin/sh\n")
    monkeypatch.setenv("CC", str(own))
    with pytest.raises(UserError, match="there is no such program"):
        compiler.found()
    own.chmod(0o755)
    assert compiler.found() == str(own)
    monkeypatch.setenv("CC", f"{own} -O3")
    with pytest.raises(UserError, match="without flags"):
        compiler.found()


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"solver": "ipopt"}, "solver ipopt with policy exact"),
        ({"policy": "network"}, "solver sqp with policy network"),
    ],
)
def test_a_controller_that_can_t_be_printed_is_named(settings, what):
    rig, model = beam()
    with pytest.raises(UserError, match=f"{what} can't be printed as C"):
        loop_in_python(rig, model, settings)


def test_a_folder_that_is_not_daqp_s_is_refused(tmp_path):
    with pytest.raises(UserError, match="has no csrc/src, csrc/include and LICENSE of DAQP"):
        daqp_source.daqp(tmp_path)


def test_the_network_is_not_asked_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(daqp_source, "folder", lambda *name: tmp_path)
    monkeypatch.setattr(
        daqp_source.subprocess, "run", lambda command, **more: subprocess.CompletedProcess(command, 1, "", "no route")
    )
    with pytest.raises(UserError, match=r"can't be fetched \(no route\); unpack daqp-.*tar.gz .* with --daqp"):
        daqp_source.daqp()


@pytest.mark.parametrize("structure", ["hybrid", "narx", "takagi_sugeno", "difnn", "state_space"])
def test_initial_states_are_those_of_the_record_map(structure):
    system = model_of(structure).system
    offset, by_outputs, by_inputs = affine_initial_states(system)
    y, u = np.array([0.3]), np.array([-1.0])
    states = system.record_map().states_from_record(y[None], np.zeros((1, 1)), u[None])[0]
    np.testing.assert_allclose(offset + by_outputs @ y + by_inputs @ u, states, atol=1e-12)


@pytest.fixture(scope="module")
def joint():
    rig = load_rig("flexible_joint")
    return rig, loop_in_python(rig, hs.load_model(shipped("flexible_joint", "model")), {"real_time": True})


def texts_of(rig, python):
    loop = unit.loop_of(rig, python)
    printer = unit.translated(loop, python.estimator._arrays, "joint", single=False)
    return unit.texts(printer, loop, title="", about={}, seal="", soft=python.mpc.shooting.memory[-1])


@pytest.fixture(scope="module")
def texts(joint):
    return texts_of(*joint)


@pytest.fixture(scope="module")
def written(texts, tmp_path_factory):
    """The folder of a unit."""
    place = tmp_path_factory.mktemp("unit")
    for file, text in texts.items():
        (place / file).write_text(text)
    daqp_source.copy_to(daqp_source.daqp(), place / "daqp")
    return place


def test_what_is_printed_does_not_depend_on_where_arrays_are(joint, texts):
    rig, _ = joint
    other = loop_in_python(rig, hs.load_model(shipped("flexible_joint", "model")), {"real_time": True})
    assert texts_of(rig, other) == texts
    assert "joint_mean_of(" in texts["joint.c"]
    assert "joint_mean_of_2(" not in texts["joint.c"], "there is one filter"


@needs_compiler
@pytest.mark.parametrize(("flag", "reason"), [("-D__DBL_MANT_DIG__=24", "-mdouble=64"), ("-ffast-math", "ffast-math")])
def test_a_target_that_would_answer_otherwise_is_refused_where_it_is_compiled(written, flag, reason):
    ran = subprocess.run([COMPILER, flag, "-E", "joint.c"], cwd=written, capture_output=True, text=True, check=False)
    assert ran.returncode
    assert reason in ran.stderr


@needs_compiler
class TwoSolutions:
    """A controller that moves away from a corner, on whose other side rounding is."""

    period, iterates = 0.01, True

    def __init__(self):
        self.estimator, self.command = self, np.zeros(1)

    def reset(self):
        pass

    def prepare(self, elapsed):
        pass

    def step(self, time, outputs, applied, preview):
        return answered(SOLVED, 1.0 if outputs[0] > 0.3 else -1.0)


def answered(status, inputs):
    return PeriodAnswer(status, np.array([inputs]), np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(2))


def asked_at(reading):
    return PeriodQuestion(0.0, np.array([reading]), np.zeros(1), np.zeros((1, 1)))


@pytest.mark.parametrize(("reading", "iterates", "apart"), [(0.3, True, 0.0), (0.3, False, 2.0), (0.29, True, 2.0)])
def test_between_two_solutions_rounding_decides_where_answers_are_iterated(reading, iterates, apart):
    loop: Any = TwoSolutions()
    loop.iterates = iterates
    questions = [asked_at(reading)] * 3
    answers = answers_of(loop, questions, loop.period)
    found = [answered(SOLVED, 1.0)] * 3
    assert difference_from(loop, questions, answers, found, tolerance=1e-6)["inputs"] == apart


def test_rounding_decides_whether_an_iteration_ends_within_its_tolerance_but_not_whether_it_fails():
    of = {status: [answered(status, 1.0)] for status in (SOLVED, NOT_CONVERGED, FAILED)}
    assert largest_difference(of[SOLVED], of[NOT_CONVERGED], share=0.95)["status"] == 0.0
    assert largest_difference(of[SOLVED], of[NOT_CONVERGED])["status"] == np.inf
    assert largest_difference(of[FAILED], of[NOT_CONVERGED], share=0.95)["status"] == np.inf


def test_in_a_faulty_loop_a_sensor_is_left_out_and_a_second_estimate_brings_it_back(joint, written, monkeypatch):
    """In C as in Python, here of a rig with several sensors and without the compiler's optimisation."""
    rig, python = joint
    python.command = np.zeros(len(rig.actuators))
    agreed, agrees = [], monitored_estimator.agrees

    def kept(*given):
        agreed.append(agrees(*given))
        return agreed[-1]

    monkeypatch.setattr(monitored_estimator, "agrees", kept)
    asked, answers = recorded(rig, python, 2 * SPELL, faults=True)
    assert sum(python.monitored.monitor.counts) > 0
    assert any(agreed)
    assert not any(python.monitored.monitor.left_out)
    library = built.build(COMPILER, written, "joint", written, flags=("-O0",))
    made = built.BuiltUnit(library, "joint", single=False, **folder.sizes_of(unit.loop_of(rig, python)))
    again, period = asked[:SPELL], python.estimator.period  # which begin anew
    answers += answers_of(python, again, period)
    differences = largest_difference(answers_of(made, [*asked, *again], period), answers)
    assert max(differences.values()) <= folder.LOOSE


class Asked:
    """The joint's loop in Python, asked period by period with a sound plant; a unit is held to it by its export."""

    def __init__(self, joint):
        self.rig, self.loop = joint
        self.loop.command = np.zeros(len(self.rig.actuators))  # it stays through a reset
        self.loop.reset()
        self.plant, self.applied, self.k = Plant(self.rig, seed=2), self.loop.command.copy(), 0
        self.preview = np.zeros((self.loop.controller.horizon, len(self.rig.sensors)))

    def go(self, periods, *, stamp=lambda time: time, applied=None, preview=None):
        """Its answers."""
        period, found = self.loop.estimator.period, []
        for _ in range(periods):
            given = self.applied if applied is None else applied
            asked = self.preview if preview is None else preview
            found.append(self.loop.step(stamp(self.k * period), self.plant.sensed(), given, asked))
            self.loop.prepare(period)
            self.applied, self.k = found[-1].inputs, self.k + 1
            for _ in range(round(period / self.plant.step)):
                self.plant.advance(self.applied)
        return found


@pytest.fixture
def asked(joint):
    found = Asked(joint)
    found.go(20)
    return found


STILL = 0.1  # s, a stamp that stands still or lies far ahead of all others


def test_a_unit_whose_stamps_stand_still_holds_then_rests_and_comes_back(asked):
    loop, rest = asked.loop, [actuator.rest for actuator in asked.rig.actuators]
    period = loop.estimator.period
    found = asked.go(round((loop.stale_after + loop.zero_after) / period) + 10, stamp=lambda time: STILL)
    statuses = [answer.status for answer in found]
    assert statuses[round(loop.stale_after / period) + 2] == HELD
    assert statuses[-1] == RESTED
    np.testing.assert_array_equal(found[-1].inputs, rest)
    assert asked.go(3)[-1].status not in (HELD, RESTED)


@pytest.mark.parametrize("ahead", [100.0, 1e9, 1e15, 1e300])
def test_one_stamp_far_ahead_blinds_a_unit_for_two_periods_at_most(asked, ahead):
    asked.go(1, stamp=lambda time: time + ahead)
    asked.go(3)
    period, sensed = asked.loop.estimator.period, asked.plant.sensed()
    assert asked.loop._stale < 1.5 * period
    assert abs(asked.go(1)[-1].state[0] - sensed[0]) < 0.01


def test_without_a_reference_a_unit_rests(asked):
    missing = np.full_like(asked.preview, np.nan)
    found = asked.go(round(asked.loop.zero_after / asked.loop.estimator.period) + 5, preview=missing)
    assert found[-1].status == RESTED
    assert asked.go(2)[-1].status not in (HELD, RESTED)


def test_applied_inputs_that_are_unknown_are_no_fault(asked):
    found = asked.go(200, applied=np.full_like(asked.applied, np.nan))
    assert max(answer.judged[0] for answer in found) == 0.0


def test_a_reference_beyond_the_travel_is_held_before_its_end(asked, joint, monkeypatch):
    high = np.full(asked.preview.shape[1], 0.3)  # the joint turns without end
    monkeypatch.setattr(asked.loop, "reach", np.array([-high, high]))
    found = asked.go(20, preview=np.full_like(asked.preview, 1e9))
    other = Asked(joint)
    other.go(20)
    expected = other.go(20, preview=np.tile(high, (len(other.preview), 1)))
    np.testing.assert_array_equal([answer.inputs for answer in found], [answer.inputs for answer in expected])


@pytest.mark.parametrize("rig", ["math", "Signal", "api", "daqp", "node", "test", "7 motors"])
def test_a_unit_has_no_name_that_something_else_has(rig):
    """#include <math.h> would find the unit's own header; DAQP has an api.h, CMake a target test."""
    assert folder.unit_name(rig).startswith("rig_")


def test_a_function_that_calls_itself_has_no_bound(tmp_path):
    node = 'node: {{ title: "{0}" label: "{0}\\nunit.c:1:1\\n{1} bytes (static)" }}'
    edge = 'edge: {{ sourcename: "{0}" targetname: "{1}" label: "unit.c:2:2" }}'
    lines = [node.format("step", 32), node.format("unit.c:solve", 64), node.format("unit.c:show", 100)]
    lines += [edge.format("step", "unit.c:solve"), edge.format("step", "unit.c:show")]
    (tmp_path / "unit.ci").write_text("\n".join(lines))
    assert stack_use.most_bytes(tmp_path, ["step"], constraints=9) == 132
    (tmp_path / "more.ci").write_text(edge.format("unit.c:show", "step"))
    with pytest.raises(UserError, match="step calls itself: step -> show -> step"):
        stack_use.most_bytes(tmp_path, ["step"], constraints=9)


@pytest.fixture(scope="module")
def press() -> tuple[Rig, Model]:
    """A rig of two inputs, of which one acts 12 ms later, and no reference of its own."""
    rig = load_rig(str(Path(__file__).parents[4] / "tests" / "press"))
    sampling = Sampling(step=0.005, period=0.05)
    return rig, Model(
        rig="press", structure="gray", system=rig.system, sampling=sampling, names=(), covariance=np.zeros((0, 0)),
        training_range={},
    )  # fmt: skip


def test_a_loop_whose_inputs_wait_is_replayed_without_a_reference_of_the_rig(press):
    rig, model = press
    questions, answers = recorded(rig, loop_in_python(rig, model, {}), 200)
    assert np.ptp([item.preview for item in questions]) > 0.0
    assert np.ptp([item.inputs for item in answers], axis=0).min() > 0.0


PROBLEM = {
    "terms": {
        "power": {"value": "valve * leakage", "price": 0.1},
        "stop": {"value": "(position - wall)**2", "high": 1e-4, "soft_linear": 10.0},
        "calm": {"value": "speed", "weight": 2.0, "final": True},
        "pump": {"value": "valve**2 + load**2", "high": 30.0, "hard": True},
    },
    "stage_parameters": {"wall": np.linspace(0.0, 1e-3, 20).tolist()},
    "intervals": [1, 1, 2, 4, 6, 6],
    "tightening": {
        "share": 0.99,
        "between": [[-1e-3, 0.0], [1e-3, 0.0]],
        "states": [1e-5, 1e-3, 1e-2],
        "parameters": 0.05,
    },
}
"""Of a section mpc: all that a problem may have."""


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(("problem", "tolerance"), [({}, 1e-9), (PROBLEM, 1e-6)])
def test_inputs_of_different_delays_wait_in_c_as_in_python(tmp_path, press, problem, tolerance):
    rig, model = press
    rig = replace(rig, content={**rig.content, "mpc": problem})
    done = folder.export_loop(rig, model, tmp_path / "unit", settings={}, seal="s", periods=200, more=100)
    assert max(done.differences["recorded"].values()) <= tolerance


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("driver", ["exact", "supervised"])
def test_the_beam_s_loop_in_c_is_that_of_python(tmp_path, driver):
    """With the sanitizers, and as C++."""
    rig, model = beam()
    settings = {"real_time": True, "policy": driver}
    done = folder.export_loop(rig, model, tmp_path / "unit", settings=settings, seal="s")
    assert max(done.differences["recorded"].values()) <= (1e-9 if driver == "exact" else 1e-6)
    written = json.loads((tmp_path / "unit" / "export.json").read_text())
    assert written["largest_differences"]["recorded"] == done.differences["recorded"]
    written_to, name = tmp_path / "unit", done.name
    objects = loop_fuzz.sanitized_objects(written_to, name, tmp_path)
    common = ["-I", str(written_to)]
    own = [str(written_to / f"{name}_test.c"), *map(str, objects), "-lm"]
    subprocess.run([COMPILER, "-std=c99", *loop_fuzz.SANITIZED, *common, *own], cwd=tmp_path, check=True)
    ran = subprocess.run([str(tmp_path / "a.out")], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, ""), ran.stdout
    assert f"0 of {folder.SHOWN} periods wrong" in ran.stdout
    loop = loop_in_python(rig, model, settings)
    counted = loop_fuzz.fuzzed(written_to, name, loop, objects, calls=FUZZED, seed=0)
    assert counted["calls"] == FUZZED
    assert counted["answered"] > loop_fuzz.ANSWERED * FUZZED
    as_cpp = [
        COMPILER,
        "-x",
        "c++",
        "-std=c++11",
        "-fsyntax-only",
        "-Wall",
        "-Wextra",
        "-Werror",
        *common,
        str(written_to / f"{name}.c"),
    ]
    subprocess.run(as_cpp, check=True)
    symbols = subprocess.run(["nm", "-u", *objects], capture_output=True, text=True, check=True).stdout
    assert not {"malloc", "calloc", "realloc", "free"} & {line.split()[-1] for line in symbols.splitlines() if line}
