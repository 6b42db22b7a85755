"""Sessions of nodes: what they say of a node that fails, and that no node outlives them."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.runtime import preflight
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.runtime.session import Session
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from std_msgs.msg import Bool

from tests.node_bench import Bench

TIMEOUT = 60.0  # s


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
