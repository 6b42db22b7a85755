"""Faults of the processes, of what they have read, of their clock and of the machine."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from benchmarks.faults.observation import PATIENCE
from benchmarks.faults.stage import LASTING, Fault, Stage
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.support.errors import UserError

OUTLIVED = 2.0
"""By which nodes may outlive their run [s]: they say their last words."""
RECORDED = 1 << 17
"""Bytes of the bag of a run whose loop goes: some three seconds."""


def killed(name: str) -> Fault:
    """Kill -9, and a new one at once."""

    def fault(stage: Stage) -> None:
        stage.kill(name)
        stage.restart(name)

    return fault


def stopped(name: str) -> Fault:
    """SIGSTOP for a while."""

    def fault(stage: Stage) -> None:
        stage.kill(name, signal.SIGSTOP)
        time.sleep(LASTING)
        stage.kill(name, signal.SIGCONT)

    return fault


def killed_recorder(stage: Stage) -> None:
    """Kill -9, and a new bag: what the old one lacks was written within the last second."""
    bag = stage.bag
    kept = stage.recorded
    stage.kill("recorder")
    stage.restart("recorder")
    with bags.bag.opened(bag, recover=True) as recovered:
        found = sum(topic.messages for topic in recovered.topics.values())
    if found < kept:
        raise UserError(f"{bag} has {found} messages, and its recorder had said that {kept} are kept")


def failing_disk(trouble: str) -> Fault:
    """The recorder's disk is full, read-only or slow for a while; no message is lost."""

    def fault(stage: Stage) -> None:
        before = int(stage.values["recorder"].get("lost", 0))
        stage.disk.write_text(trouble)
        time.sleep(LASTING)
        stage.disk.write_text("")
        time.sleep(LASTING)
        stage.alive()
        lost = int(stage.values["recorder"]["lost"]) - before
        if lost:
            raise UserError(f"the recorder lost {lost} messages")

    return fault


# ---------------------------------------------------------------------- what was read


def gone_model(stage: Stage) -> None:
    """The folder of the model is away for a while."""
    away = stage.model.with_name("away")
    stage.model.rename(away)
    time.sleep(LASTING)
    away.rename(stage.model)


def altered_model(stage: Stage) -> None:
    """The model is not what its seal says, and the estimator has to start again."""
    sheet = stage.model / "model.yaml"
    text, times = sheet.read_text(), sheet.stat()
    sheet.write_text(re.sub(r"(value: \d)", r"\g<1>1", text, count=1))
    _refused(stage, "altered since it was saved")
    sheet.write_text(text)
    os.utime(sheet, ns=(times.st_atime_ns, times.st_mtime_ns))
    stage.restart("estimator")


def swapped_model(stage: Stage) -> None:
    """A model of another rig lies in the folder, and the estimator has to start again."""
    away = stage.model.with_name("away")
    stage.model.rename(away)
    shutil.copytree(stage.other_model, stage.model)
    _refused(stage, "rig")
    shutil.rmtree(stage.model)
    away.rename(stage.model)
    stage.restart("estimator")


def _refused(stage: Stage, words: str) -> None:
    """The estimator, started again, ends with a line that has these words."""
    stage.kill("estimator")
    try:
        stage.restart("estimator")
    except UserError as error:
        child = stage.session.children["estimator"]
        if child.process.poll() == 2 and words in str(error):
            return
        raise
    raise UserError("the estimator takes the model")


# ---------------------------------------------------------------------- another plant


def replaced(**values: Any) -> Fault:
    """Another plant for a while, with other parameters of the node."""
    return lambda stage: _replace(stage, values)


def altered(changes: Callable[[str, str], tuple[str, str]]) -> Fault:
    """A plant for a while whose rig has another system or description: changes makes the two files' texts of theirs."""

    def fault(stage: Stage) -> None:
        folder = stage.folder / f"other_{stage.rig.name}"
        shutil.copytree(stage.rig.folder, folder, dirs_exist_ok=True)
        files = folder / "system.py", folder / "rig.yaml"
        for file, text in zip(files, changes(*(file.read_text() for file in files)), strict=True):
            file.write_text(text)
        _replace(stage, {}, rig=folder)
        shutil.rmtree(folder)

    return fault


def _replace(stage: Stage, values: dict[str, Any], *, rig: Path | None = None) -> None:
    """Another plant for a while."""
    stage.end("plant")
    stage.start("plant", rig=rig, **values)
    stage.session.wait_for("started", ["plant"], PATIENCE)
    stage.started = time.monotonic()
    time.sleep(2.0 * LASTING)
    stage.end("plant")
    stage.start("plant")
    stage.session.wait_for("started", ["plant"], PATIENCE)


def parameters(system: str, **values: float) -> str:
    """Source of a system whose parameters have other values."""
    for name, value in values.items():
        system, count = re.subn(rf"(\b{name}: float = bounded\()[^,]+", rf"\g<1>{value}", system)
        if not count:
            raise UserError(f"the system has no parameter {name}")
    return system


def narrower(rig: str) -> str:
    """Description of a rig that ends at .3 of the travel, before where its reference is."""
    low, high = (0.3 * float(value) for value in re.findall(r"travel: \{position: \[(.+), (.+)\]\}", rig)[0])
    return re.sub(r"travel: .*", f"travel: {{position: [{low}, {high}]}}", rig)


# ---------------------------------------------------------------------- clock and machine


def set_clock(seconds: float) -> Fault:
    """The clock is set, and stays so."""

    def fault(stage: Stage) -> None:
        stage.clock.offset += round(seconds * SECOND)

    return fault


def standing_clock(stage: Stage) -> None:
    """The clock stands still for a while."""
    stage.clock.stands = True
    time.sleep(LASTING)
    stage.clock.stands = False


def without_clock(stage: Stage) -> None:
    """The controller waits for a simulated clock that nobody gives."""
    stage.end("controller")
    stage.start("controller", use_sim_time=True)
    stage.session.wait_for("ready", ["controller"], PATIENCE)
    stage.started = time.monotonic()
    time.sleep(LASTING)
    stage.end("controller")
    stage.start("controller")
    stage.session.wait_for("ready", ["controller"], PATIENCE)


def crowded(stage: Stage) -> None:
    """Ten processes that do nothing but count."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(10)]
    time.sleep(5.0)
    for other in others:
        other.kill()
        other.wait()


def killed_run(stage: Stage) -> None:
    """Kill -9 of `hybrid-sysid run`, beside this loop, in a domain of its own: no node of it goes on."""
    bag = stage.folder / "of_run"
    command = [sys.executable, "-m", "hybrid_sysid_ros", "run", "--rig", stage.rig.name, "--bag", str(bag)]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(stage.domain + 1)}
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
    try:
        _wait(lambda: _size(bag / f"{bag.name}_0.mcap") > RECORDED or run.poll() is not None, 2.0 * PATIENCE)
        time.sleep(LASTING)
        nodes = [int(pid) for pid in os.listdir("/proc") if pid.isdigit() and _status(int(pid))[1] == str(run.pid)]
        run.send_signal(signal.SIGKILL)
        if len(nodes) < 5:
            raise UserError(f"run has {len(nodes)} nodes")
        began = time.monotonic()
        _wait(lambda: not any(map(_runs, nodes)), PATIENCE)
        if (lasted := time.monotonic() - began) > OUTLIVED:
            raise UserError(f"nodes outlive their run by {lasted:.1f} s")
    finally:
        run.kill()
        run.wait()
    record = bags.read(bag, stage.rig.signals)
    actuator = stage.rig.actuators[0]
    if not ((record.input >= actuator.low) & (record.input <= actuator.high)).all():
        raise UserError("an input of the killed run was out of its bounds")


def _size(file: Path) -> int:
    """In bytes, 0 where there is none."""
    return file.stat().st_size if file.exists() else 0


def _status(process: int) -> tuple[str, str]:
    """State of a process and the one that started it; nothing where it has ended."""
    with suppress(OSError):
        state, parent, *_ = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return state, parent
    return "", ""


def _runs(process: int) -> bool:
    return _status(process)[0] not in ("", "Z")


def _wait(condition: Callable[[], bool], seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise UserError(f"waited {seconds:g} s in vain")
        time.sleep(0.02)
