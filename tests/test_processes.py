"""The nodes as processes: they start, run in real time, end when told to, and say in a line what is wrong."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.run import Run, RunResult

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from tests.node_bench import Bench

TIMEOUT = 60.0  # s
HEAVY = {
    *("jinja2", "joblib", "matplotlib", "onnx", "optuna", "pandas", "plotly", "rich", "rosbags", "torch"),
    *("scipy.optimize", "scipy.signal", "scipy.special", "scipy.stats"),  # its linear algebra numba itself loads
}


@pytest.fixture
def start(domain: int) -> Iterator[type[subprocess.Popen[str]]]:
    """Start a node with arguments; none is left behind."""
    started: list[subprocess.Popen[str]] = []

    def make(node: str, *arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", f"hybrid_sysid_ros.nodes.{node}", *arguments]
        pipe, environment = subprocess.PIPE, {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        started.append(subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment))
        return started[-1]

    yield make  # type: ignore[misc]
    for process in started:
        process.kill()
        process.communicate()


def wait_until_ready(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"


@dataclass(frozen=True)
class Seen:
    """What came of a session, what it told, and the seconds of its progress."""

    outcome: RunResult
    lines: list[str]
    seconds: list[float]


@pytest.fixture(scope="module")
def run(domain: int, tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """Two seconds in real time: the shipped network under supervision."""
    lines: list[str] = []
    seconds: list[float] = []
    outcome = Run(
        reference="sine",
        duration=2.0,
        bag=tmp_path_factory.mktemp("run") / "bag",
        domain=domain,
        tell=lines.append,
        progress=lambda elapsed, duration: seconds.append(elapsed),
    ).go()
    return Seen(outcome, lines, seconds)


def test_the_whole_loop_runs_in_real_time_and_leaves_a_bag(run: Seen) -> None:
    assert not run.outcome.interrupted
    assert 1.9 < run.seconds[-1] < 5.0
    assert "done after 2 s" in " ".join(run.lines)
    assert run.outcome.diagnostics["plant"]["measurements"] > 390
    assert run.outcome.diagnostics["controller"]["layer_policy"] > 200
    assert 0.0 < run.outcome.diagnostics["plant"]["delay_ms_p50"] < 1e3
    assert run.outcome.bag is not None
    record = bags.read(run.outcome.bag, load_rig("cam_beam").signals)
    assert record.duration > 1.9
    assert "/diagnostics" in bags.topics(run.outcome.bag)


def test_the_nodes_of_the_loop_load_nothing_that_they_do_not_need() -> None:
    modules = [f"hybrid_sysid_ros.nodes.{node}" for node in ("plant", "estimator", "controller", "reference")]
    code = f"import sys, {', '.join(modules)}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert set(modules) <= set(loaded)
    assert HEAVY.isdisjoint(loaded)


@pytest.mark.slow
def test_nothing_is_compiled_once_the_nodes_are_ready(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiling takes seconds, and each is a hundred missed commands; at a first start, since later ones load code."""
    monkeypatch.setenv("HYBRID_SYSID_CACHE", str(tmp_path))
    outcome = Run(reference="sine", duration=2.0, domain=domain, tell=lambda line: None).go()
    for node in ("estimator", "controller"):
        assert outcome.diagnostics[node]["execution_ms_max"] < 500.0


@pytest.mark.parametrize("numbers", [(signal.SIGINT,), (signal.SIGINT, signal.SIGINT), (signal.SIGHUP,)])
def test_a_node_ends_well_on_an_interrupt_or_two_or_when_its_terminal_closes(start, numbers: tuple[int, ...]) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a run of the tests under nohup ignores it, and so would its children
    process = start("reference")
    wait_until_ready(process)
    for number in numbers:
        process.send_signal(number)
    out, complaints = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0
    assert complaints == ""
    assert '"kind": "hardware"' in out  # its last diagnostics


def test_a_recorder_that_is_terminated_leaves_a_whole_bag(start, tmp_path: Path) -> None:
    process = start("recorder", "--ros-args", "-p", f"path:={tmp_path / 'bag'}", "-p", "topics:=/diagnostics")
    wait_until_ready(process)
    process.terminate()
    process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0
    bags.topics(tmp_path / "bag")
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGXFSZ], ids=["killed", "full"])
def test_a_recorder_that_cannot_go_on_leaves_what_it_has(domain: int, start, tmp_path: Path, number: int) -> None:
    """Its own diagnostics are what it records: after a kill, or where its file may not grow beyond 128 KB."""
    bag = tmp_path / "bag"
    process = start("recorder", "--ros-args", "-p", f"path:={bag}", "-p", "topics:=/diagnostics")
    wait_until_ready(process)
    bench = Bench(domain)
    publisher, heard = bench.speak("/diagnostics", DiagnosticArray), bench.listen("/diagnostics", DiagnosticArray)
    try:
        bench.until(publisher.get_subscription_count)
        for count in (1, 400):
            for _ in range(count):
                publisher.publish(DiagnosticArray(status=[DiagnosticStatus(name=os.urandom(500).hex())]))
            bench.until((bag / "bag_0.mcap").exists)
            if number == signal.SIGXFSZ:
                resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (1 << 17, 1 << 17))
        if number == signal.SIGKILL:
            process.kill()
        else:  # it goes on until it is told to end
            bench.until(lambda: any("cannot be written" in said.message for each in heard for said in each.status))
            process.terminate()
        bench.until(lambda: process.poll() is not None)
    finally:
        bench.close()
    _, complaints = process.communicate()
    assert process.returncode == (-9 if number == signal.SIGKILL else 2)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    with bags.bag.opened(bag, recover=True) as recovered:
        kept = recovered.topics["/diagnostics"].messages
    assert kept > 0
    assert bags.topics(bag)["/diagnostics"].messages == kept
    assert (bag / "metadata.yaml").exists() == (number == signal.SIGXFSZ)
    if number == signal.SIGXFSZ:
        assert f"error: {bag}: cannot be written (File too large): {kept} messages" in complaints.splitlines()[-1]
        assert "Traceback" not in complaints


STARTING = """
import os, signal, sys
from hybrid_sysid_ros.nodes import process, recorder

def make():
    {before}
    node = recorder.RecorderNode()
    os.kill(os.getpid(), signal.SIGTERM)
    return node

sys.exit(process.run(make))
"""
COMPILING = "import time; os.kill(os.getpid(), signal.SIGINT); time.sleep(60.0)"


@pytest.mark.parametrize(("before", "left"), [("", ["bag"]), (COMPILING, [])], ids=["short", "long"])
def test_a_node_that_is_stopped_while_it_starts_ends_well(domain: int, tmp_path: Path, before: str, left: list[str]):
    """A short start is finished, so that a recorder leaves its bag and no thread; a long one is cut."""
    end = subprocess.run(
        [sys.executable, "-c", STARTING.format(before=before), "--ros-args", "-p", f"path:={tmp_path / 'bag'}"],
        capture_output=True,
        text=True,
        timeout=20.0,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
    )
    assert end.returncode == 0
    assert "Traceback" not in end.stderr
    assert [path.name for path in tmp_path.iterdir()] == left


def test_security_that_cannot_be_had_is_reported_in_a_line(domain: int, tmp_path: Path) -> None:
    """A keystore without keys, or a middleware without security, as that of the wheels."""
    (tmp_path / "enclaves").mkdir()
    security = {"ENABLE": "true", "STRATEGY": "Enforce", "KEYSTORE": str(tmp_path)}
    end = subprocess.run(
        [sys.executable, "-m", "hybrid_sysid_ros.nodes.reference"],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain), **{f"ROS_SECURITY_{k}": v for k, v in security.items()}},
    )
    assert end.returncode == 2
    assert end.stderr.splitlines()[-1].startswith("error: ROS cannot make the node: ")
    assert "Traceback" not in end.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "rate:=50000.0"], "error: parameter rate is 50000.0 Hz"),
        (["-p", "rat:=100.0"], "error: unknown parameter rat: the nearest of"),
        (["-p", "rate"], "error: "),
        (["--params-file", "/nowhere.yaml"], "error: "),
    ],
)
def test_a_wrong_argument_ends_a_node_with_status_2_and_a_line(start, arguments: list[str], message: str) -> None:
    process = start("plant", "--ros-args", *arguments)
    _, complaints = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 2
    assert message in complaints.splitlines()[-1]
    assert "Traceback" not in complaints


def test_parameters_come_from_a_file_too(start, tmp_path: Path) -> None:
    (tmp_path / "parameters.yaml").write_text("/**:\n  ros__parameters:\n    kind: sine\n    amplitude: 2.0\n")
    process = start("reference", "--ros-args", "--params-file", str(tmp_path / "parameters.yaml"))
    wait_until_ready(process)
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=TIMEOUT)
    assert '"kind": "sine"' in out


def test_all_nodes_run_in_one_process_with_the_parameters_of_each(domain: int) -> None:
    outcome = Run(composed=True, lockstep=True, duration=1.0, reference="sine", domain=domain).go()
    assert outcome.diagnostics["reference"]["kind"] == "sine"
    assert outcome.diagnostics["plant"]["commands"] == pytest.approx(200, abs=25)
    assert outcome.diagnostics["controller"]["commands"] >= outcome.diagnostics["plant"]["commands"]
    assert outcome.diagnostics["estimator"]["missing_measurements"] == 0


ANSWERED_NOBODY = """
import warnings
from hybrid_sysid_ros.nodes import process
from hybrid_sysid_ros.support.errors import UserError
def make():
    warnings.warn("failed to send response (timeout): client will not receive response", RuntimeWarning)
    warnings.warn("another", RuntimeWarning)
    raise UserError("the end")
process.run(make)
"""


def test_a_client_that_has_gone_is_no_warning_on_the_screen(domain: int) -> None:
    said = subprocess.run([sys.executable, "-c", ANSWERED_NOBODY], capture_output=True, text=True, timeout=TIMEOUT)
    assert "failed to send response" not in said.stderr
    assert "another" in said.stderr
    assert "error: the end" in said.stderr
