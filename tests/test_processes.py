"""The nodes as processes: they start, run in real time, end when told to, and say in a line what is wrong."""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import preflight
from hybrid_sysid_ros.runtime.run import Run, RunResult
from hybrid_sysid_ros.runtime.session import Session
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Bool

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


@pytest.mark.parametrize("node", ["plant", "estimator", "controller", "reference"])
def test_a_node_of_the_loop_loads_nothing_that_it_does_not_need(node: str) -> None:
    module = f"hybrid_sysid_ros.nodes.{node}"
    code = f"import sys, {module}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert module in loaded
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


def test_a_session_tells_what_keeps_a_node_from_starting(domain: int, tmp_path: Path, monkeypatch) -> None:
    with monkeypatch.context() as late:
        late.setattr(preflight, "check", lambda rig, given: None)  # the folder goes after that
        with pytest.raises(UserError, match=r"ended with status 2: .*nowhere"):
            Run(model=tmp_path / "nowhere", policy="exact", domain=domain, tell=lambda line: None).go()
    with pytest.raises(UserError, match="parameter rate is 5000"):
        Run(rate=5e3, domain=domain).go()
    with pytest.raises(UserError, match="controller: unknown parameter speed"):
        Run(domain=domain, parameters={"controller": {"speed": 1.0}}).go()
    with pytest.raises(UserError, match="ROS domain 233"):
        Run(domain=233).go()


@pytest.mark.slow
def test_a_session_says_where_the_bag_of_a_killed_recorder_is(domain: int, tmp_path: Path) -> None:
    bag = tmp_path / "bag"

    def kill(seconds: float, duration: float) -> None:
        if (bag / "bag_0.mcap").exists():
            for process in Path("/proc").iterdir():
                if _records(process, bag):
                    os.kill(int(process.name), signal.SIGKILL)

    with pytest.raises(UserError, match=rf"recorder ended .* in {bag}$"):
        Run(bag=bag, domain=domain, respawn=0, progress=kill).go()
    with bags.bag.opened(bag, recover=True) as recovered:
        assert sum(topic.messages for topic in recovered.topics.values()) > 0


@pytest.mark.slow
def test_a_node_that_dies_is_started_again_and_the_loop_comes_back(domain: int, tmp_path: Path) -> None:
    """The controller dies, then the recorder: each time commands come again, and what comes then is in the next bag."""
    lines: list[str] = []
    bench, left = Bench(domain), ["controller", "recorder"]
    heard = bench.listen("joint_command")

    def kill(seconds: float, duration: float) -> None:
        for _ in range(100):
            bench.executor.spin_once(timeout_sec=0.0)
        if not left and not any(tmp_path.glob("bag_2/*.mcap")):
            heard.clear()  # those from when the recorder is there again count
        if len(heard) > (50 if left else 600):
            heard.clear()
            if not left:
                raise KeyboardInterrupt
            os.kill(_process(left.pop(0), domain), signal.SIGKILL)

    outcome = Run(reference="constant", bag=tmp_path / "bag", domain=domain, tell=lines.append, progress=kill).go()
    bench.close()
    assert [outcome.diagnostics[node]["restarts"] for node in ("controller", "recorder")] == [1, 1]
    assert sum("started again, 1 of 3" in line for line in lines) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "bag_2"]
    assert bags.topics(tmp_path / "bag_2")["/cam_beam/joint_command"].messages > 0


@pytest.mark.slow
def test_a_controller_that_dies_in_an_emergency_stop_does_not_drive_when_it_is_started_again(domain: int) -> None:
    bench, killed = Bench(domain), [0]
    heard = bench.listen("joint_command")
    speaker = bench.speak("estop", Bool)

    def kill(seconds: float, duration: float) -> None:
        for _ in range(100):
            bench.executor.spin_once(timeout_sec=0.0)
        if killed[0] and len(heard) > 100:
            raise KeyboardInterrupt
        if not killed[0] and len(heard) > 50:
            speaker.publish(Bool(data=True))
            if heard[-1].effort[0] == 0.0:
                killed[0] = _process("controller", domain)
                os.kill(killed[0], signal.SIGKILL)
                heard.clear()

    outcome = Run(reference="sine", domain=domain, tell=lambda line: None, progress=kill).go()
    bench.close()
    assert outcome.diagnostics["controller"]["restarts"] == 1
    assert outcome.diagnostics["controller"]["state"] == "disarmed"
    assert {message.effort[0] for message in heard} == {0.0}


def test_what_a_killed_node_has_said_before_is_not_the_reason(domain: int) -> None:
    code = "import os, sys; print('a warning', file=sys.stderr, flush=True); os.kill(os.getpid(), 9)"
    with Session("cam_beam", domain=domain, tell=lambda line: None) as session:
        session.start("plant", [sys.executable, "-c", code])
        with pytest.raises(UserError, match="plant ended with status -9: killed"):
            session.wait_for("ready", ["plant"], TIMEOUT)


@pytest.mark.slow
def test_a_short_reference_may_end_before_a_late_node_is_ready(domain: int) -> None:
    """The plant starts once its own readers are there, a view may take longer."""
    late = "import time; time.sleep(1); print('ready', flush=True); time.sleep(60)"
    with Session("cam_beam", domain=domain, tell=lambda line: None) as session:
        session.start("reference", [sys.executable, "-c", "print('ready', flush=True)"])
        session.start("view", [sys.executable, "-c", late])
        session.wait_for("ready", ["reference", "view"], TIMEOUT)
        session.wait_for_end(["reference"], lambda seconds: None)


@pytest.mark.slow
def test_a_node_that_dies_again_and_again_is_given_up(domain: int) -> None:
    def kill(seconds: float, duration: float) -> None:
        if found := _process("reference", domain):
            os.kill(found, signal.SIGKILL)

    with pytest.raises(UserError, match="reference ended with status -9"):
        Run(domain=domain, respawn=1, tell=lambda line: None, progress=kill).go()


def _process(node: str, domain: int) -> int:
    """Number of a node's process on a domain, 0 where there is none."""
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            here = f"ROS_DOMAIN_ID={domain}".encode() in (entry / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if here and f"hybrid_sysid_ros.nodes.{node}".encode() in words:
            return int(entry.name)
    return 0


def _records(process: Path, bag: Path) -> bool:
    """Whether an entry of /proc is the recorder of a bag."""
    try:
        return f"path:={json.dumps(str(bag))}".encode() in (process / "cmdline").read_bytes()
    except OSError:
        return False


@pytest.mark.slow
def test_a_session_ends_well_when_it_is_interrupted(domain: int, model_folder: Path, policy_folder: Path) -> None:
    def interrupt(seconds: float, duration: float) -> None:
        if seconds > 0.5:
            threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT)).start()  # a second one, while it stops
            os.kill(os.getpid(), signal.SIGTERM)

    before = threading.active_count()
    outcome = Run(
        model=model_folder,
        policy_path=policy_folder,
        policy="network",
        parameters={"controller": {"certificate": "ignore"}},
        lockstep=True,
        domain=domain,
        progress=interrupt,
    ).go()
    assert outcome.interrupted
    assert outcome.diagnostics["plant"]["commands"] > 0
    assert threading.active_count() == before


@pytest.mark.slow
def test_no_node_outlives_its_session(domain: int, model_folder: Path, policy_folder: Path) -> None:
    """However that ends: here it is killed."""
    given = f"model={str(model_folder)!r}, policy_path={str(policy_folder)!r}, policy='network', reference='constant'"
    given += ", parameters={'controller': {'certificate': 'ignore'}}"
    code = f"Run({given}, domain={domain}, progress=lambda seconds, duration: print('on', flush=True)).go()"
    command = [sys.executable, "-c", f"from hybrid_sysid_ros.runtime.run import Run; {code}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        next(line for line in running.stdout if line == "on\n")
        children = Path(f"/proc/{running.pid}/task/{running.pid}/children").read_text().split()
        assert len(children) == 4
        ends = [os.pidfd_open(int(pid)) for pid in children]
        running.kill()
    for end in ends:
        assert select.select([end], [], [], TIMEOUT)[0]  # readable once the process has ended
        os.close(end)


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
