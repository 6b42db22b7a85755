"""The comparison of structures: the rule that chooses, and candidates that fail without stopping the others."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.shared.workers import Lost
from hybrid_sysid_ros.identification import Part, evaluate
from hybrid_sysid_ros.models import Sampling
from studies.beam_lecture import comparison
from studies.beam_lecture.candidate import CandidateStore
from studies.beam_lecture.comparison import compare
from tests.studies.candidates import candidate

# Tasks


@pytest.fixture
def tasks(monkeypatch):
    """The tasks that a comparison works through, in turn, without working."""
    done = []

    def work(task):
        done.append(task)
        return candidate(task.structure, [0.9, 0.9], parameters=3)

    monkeypatch.setattr(comparison, "work", work)
    return done


def test_only_learned_structures_are_fitted_with_every_seed_and_they_begin_first(linear_records, rig, tasks):
    structures = ["linear", "black_box", "gray", "hybrid"]
    report = []
    found = compare(
        linear_records[:2],
        [(linear_records[2], Part(start=0.5))],
        rig,
        structures,
        sampling=Sampling(),
        seeds=(4, 5, 6),
        jobs=1,
        report=lambda item: report.append(item.structure),
    )
    assert {task.structure: tuple(task.seeds) for task in tasks} == {
        "black_box": (4, 5, 6),
        "hybrid": (4, 5, 6),
        "linear": (4,),
        "gray": (4,),
    }
    assert [task.structure for task in tasks] == ["black_box", "hybrid", "linear", "gray"] == report
    assert [item.structure for item in found.candidates] == structures


def test_channels_that_no_fit_needs_are_left_behind(linear_records, rig, tasks):
    """They would travel to every process."""
    wide = [replace(item, channels={"reference": np.zeros(item.samples)}) for item in linear_records]
    compare(wide[:2], [(wide[2], Part())], rig, ["linear"], sampling=Sampling(), jobs=1)
    (task,) = tasks
    assert all(not item.channels for item in (*task.training, task.tests[0][0]))
    np.testing.assert_array_equal(task.training[0].output, wide[0].output)
    assert task.tests[0][1] == Part()


# Fits


def compared(records, rig, jobs):
    report = []
    found = compare(
        records[1:],
        [(records[0], Part(start=0.5)), (records[2], Part())],
        rig,
        ["stribeck", "magic", "linear"],
        sampling=Sampling(),
        part=Part(stop=0.8),
        seeds=(0, 1),
        jobs=jobs,
        report=lambda item: report.append(item.structure),
    )
    assert sorted(report) == ["linear", "magic", "stribeck"]
    return found


@pytest.fixture(scope="module")
def alone(linear_records, rig):
    return compared(linear_records, rig, jobs=1)


def test_a_structure_that_cannot_be_fitted_is_a_candidate_with_the_reason(alone):
    stribeck, magic, linear = alone.candidates
    assert magic.error.startswith("structure 'magic' is unknown")
    assert (magic.models, magic.r2, magic.validation) == ((), (), None)
    for item in (stribeck, linear):
        assert item.error == ""
        assert len(item.models) == len(item.r2) == 1


def test_a_candidate_is_scored_on_the_tests_and_on_blocks_of_its_training_data(alone, linear_records):
    linear = alone.candidates[2]
    (model,) = linear.models
    assert [entry["name"] for entry in model.records] == ["linear_4V", "linear_2V"]
    assert model.records[0]["part"] == [0.0, 0.8]
    assert linear.r2[0] == {
        "linear_6V": evaluate(model, linear_records[0], part=Part(start=0.5)).r2,
        "linear_2V": evaluate(model, linear_records[2]).r2,
    }
    assert {name.partition(" ")[0] for name in linear.validation.scores} == {"linear_4V", "linear_2V"}
    assert linear.parameters == 5


def test_a_linear_beam_gets_the_linear_model(alone):
    assert alone.candidates[2].validation.value > 0.9999
    assert alone.chosen == "linear"
    assert alone.model().structure == "linear"


def assert_alike(one, two):
    """The same but for rounding: what a process compiled before may decide which products and sums are fused."""
    assert len(one.r2) == len(two.r2)
    for mine, other in zip(one.r2, two.r2, strict=True):
        assert mine == pytest.approx(other, rel=1e-9)
    if one.validation is not None:
        assert one.validation.scores == pytest.approx(two.validation.scores, rel=1e-9)
        np.testing.assert_allclose(one.models[0].system.values, two.models[0].system.values, rtol=1e-9)
        np.testing.assert_allclose(one.models[0].covariance, two.models[0].covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.slow
def test_two_processes_find_what_one_does(alone, linear_records, rig):
    both = compared(linear_records, rig, jobs=2)
    assert both.chosen == alone.chosen
    for one, two in zip(alone.candidates, both.candidates, strict=True):
        assert one.structure == two.structure
        assert one.error == two.error
        assert_alike(one, two)


# Lost processes and interrupts


class Deadly(str):
    """A structure's name that ends the process which unpacks it."""

    __slots__ = ()

    def __reduce__(self):
        return os._exit, (1,)


@pytest.mark.slow
def test_a_structure_that_kills_its_process_fails_alone(linear_records, rig):
    found = compare(
        linear_records[1:],
        [(linear_records[0], Part())],
        rig,
        [Deadly("stribeck"), "linear"],
        sampling=Sampling(),
        jobs=2,
    )
    assert [item.error for item in found.candidates] == [Lost().reason, ""]
    assert found.chosen == "linear"


def unpacked_again(name, started):
    """A structure's name the second time; the first time it never comes."""
    if not started.exists():
        started.touch()
        time.sleep(600.0)
    return name


class Slow(str):
    """A structure's name that is only unpacked when another process has tried it before; that leaves a file."""

    started: Path

    def __reduce__(self):
        return unpacked_again, (str(self), self.started)


def workers_of_this_process():
    listed = (path.read_text().split() for path in Path("/proc/self/task").glob("*/children"))
    return [int(pid) for pids in listed for pid in pids if b"popen_loky" in Path(f"/proc/{pid}/cmdline").read_bytes()]


@pytest.mark.slow
def test_a_structure_whose_process_is_killed_once_is_fitted_again(linear_records, rig, tmp_path):
    slow = Slow("stribeck")
    slow.started = tmp_path / "begun"

    def kill(candidate):
        """The processes left: the one that is at work, and an idle one."""
        if candidate.structure == "linear":
            while not slow.started.exists():
                time.sleep(0.01)
            for child in workers_of_this_process():
                os.kill(child, signal.SIGKILL)

    arguments = (linear_records[1:], [(linear_records[0], Part())], rig, ["linear", slow])
    found = compare(*arguments, sampling=Sampling(), jobs=2, report=kill)
    assert [item.error for item in found.candidates] == ["", ""]


@pytest.fixture
def interrupted(monkeypatch):
    """Ctrl-C comes when the second structure would begin; the names of what was worked through."""
    done: list[str] = []
    work = comparison.work

    def interrupted_work(task):
        if len(done) == 1:
            done.append("interrupt")
            raise KeyboardInterrupt
        done.append(task.structure)
        return work(task)

    monkeypatch.setattr(comparison, "work", interrupted_work)
    return done


@pytest.mark.slow
def test_an_interrupted_comparison_goes_on_with_what_it_kept(alone, linear_records, rig, interrupted, tmp_path):
    def again(**changes):
        arguments = {
            "training": linear_records[1:],
            "tests": [(linear_records[0], Part(start=0.5)), (linear_records[2], Part())],
            "rig": rig,
            "structures": ["stribeck", "linear"],
            "sampling": Sampling(),
            "part": Part(stop=0.8),
            "seeds": (0, 1),
            "jobs": 1,
            "store": CandidateStore(tmp_path / "fits"),
        }
        return compare(**{**arguments, **changes})

    with pytest.raises(KeyboardInterrupt):
        again()
    found = again()
    assert interrupted == ["stribeck", "interrupt", "linear"]
    assert [item.kept for item in found.candidates] == [True, False]
    one, two = alone.candidates[0], found.candidates[0]
    assert one.seconds > 0
    assert two.seconds > 0
    assert_alike(one, two)
    assert found.chosen == "linear"
    kept = sorted((tmp_path / "fits").iterdir())
    # Whatever the fit depends on must be the same.
    changed = replace(linear_records[1], output=1.001 * linear_records[1].output)
    for changes in (
        {"part": Part(stop=0.7)},
        {"seeds": (1, 0)},
        {"sampling": Sampling(step=0.01)},
        {"training": [changed, linear_records[2]]},
    ):
        assert not any(item.kept for item in again(**changes, structures=["linear"]).candidates)
    (kept[0] / "candidate.json").write_text("{")
    assert [item.kept for item in again().candidates].count(True) == 1
