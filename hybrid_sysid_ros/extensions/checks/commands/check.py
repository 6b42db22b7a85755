"""hybrid-sysid check: whether the installation works, in a quarter of a minute."""

from __future__ import annotations

import importlib.metadata
import json
import platform
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros import identification, models
from hybrid_sysid_ros.bags import read
from hybrid_sysid_ros.commands.options import Json, RigName
from hybrid_sysid_ros.commands.terminal import console, end, status
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.extensions.checks.findings import check
from hybrid_sysid_ros.rigs import experiments
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime import processes
from hybrid_sysid_ros.runtime.parameters import NothingShippedError, shipped
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError

PACKAGE = "hybrid_sysid_ros"
NAME = re.compile(r"[\w.-]+")
"""Name of a package, at the beginning of a requirement."""
SECONDS = 5.0
"""Length of the simulated experiment after all its signals have begun."""
LATEST = 300.0
"""Latest beginning of an experiment's signals [s]."""
LOOP_SECONDS = 2.0
SEED = 1
LEAST = 0.5
"""Share of the variance of the simulated rig's outputs that its shipped model explains."""


class Checks:
    """The checks: methods that return what they saw, or raise UserError."""

    def __init__(self, rig: Rig, place: Path) -> None:
        self.rig, self.place = rig, place
        self.all: dict[str, Callable[[], str]] = {
            "packages": self.packages,
            "rig": self.equations,
            "bag": self.bag,
            "model": self.model,
            "policy": self.policy,
            "ROS 2 loop": self.loop,
            "real-time priority": self.priority,
        }

    def packages(self) -> str:
        """Check that every dependency outside extras is installed."""
        required = [item for item in importlib.metadata.requires(PACKAGE) or [] if "extra ==" not in item]
        names = [found.group() for item in required if (found := NAME.match(item))]
        missing: list[str] = []
        for name in names:
            try:
                importlib.metadata.version(name)
            except importlib.metadata.PackageNotFoundError:
                missing.append(name)
        if missing:
            raise UserError(f"not installed: {', '.join(missing)}: pip install {' '.join(missing)}")
        own = importlib.metadata.version(PACKAGE)
        return f"Python {platform.python_version()}, {PACKAGE} {own}, {len(names)} packages"

    def equations(self) -> str:
        """Check the rig's file and equations."""
        problems = check(self.rig).problems
        if problems:
            raise UserError(problems[0])
        return str(self.rig.folder)

    def bag(self) -> str:
        """Simulate an experiment, write its bag and read it back."""
        kind, feedback = next(iter(self.rig.experiments.excitations)), self.rig.experiments.feedback
        period = feedback.period if feedback else self.rig.step * max(round(0.005 / self.rig.step), 1)
        duration = period * round((self.begin(kind) + SECONDS) / period)
        path = experiments.simulate_experiment(
            self.rig, kind, self.place / "bag", seed=SEED, duration=duration, rate=1.0 / period
        )
        record = read(path, self.rig.signals)
        return f"{kind}: {len(record.time)} samples in {record.duration:g} s"

    def begin(self, kind: str) -> float:
        """The time at which the last of an experiment's signals begins [s]."""
        times = np.linspace(0.0, LATEST, round(LATEST / 0.1) + 1)
        signals = experiments.excitation(self.rig, kind, seed=SEED, duration=LATEST, times=times)
        moved = signals != signals[0]
        return float(max((times[np.argmax(column) - 1] for column in moved.T if column.any()), default=0.0))

    def model(self) -> str:
        """Score the shipped model on the experiment, in free run or under the rig's feedback if it has one."""
        model = models.load(shipped(self.rig.name, "model"), rig=self.rig.source)
        record = read(self.place / "bag", self.rig.signals)
        if self.rig.experiments.feedback:
            again = extensions.one("loops", "commands", "a rig that is held by a feedback needs resimulation")
            run, score = "closed loop", again(model, record, self.rig, identification.Part())["r2"]
        else:
            run, score = "free run", identification.evaluate(model, record).r2
        if not score > LEAST:
            raise UserError(f"{run} of the shipped model over a simulated record: R2 {score:.3f}, below {LEAST:g}")
        return f"{model.structure}: R2 {score:.3f} in {run}"

    def policy(self) -> str:
        """Check that the shipped policy fits the model and is certified."""
        model = models.load(shipped(self.rig.name, "model"), rig=self.rig.source)
        network = policies.load(shipped(self.rig.name, "policy"), model=model)
        if network.certificate is None:
            raise UserError("the shipped policy has no certificate")
        return f"certified, mu {network.certificate.mu('supervised'):.4f}"

    def loop(self) -> str:
        """Run plant, estimator, controller and reference in lockstep."""
        shipped(self.rig.name, "model")
        outcome = Run(rig=self.rig.source, lockstep=True, duration=LOOP_SECONDS, composed=True, tell=status.print).go()
        plant = outcome.diagnostics["plant"]
        if not plant["commands"] or plant["rejected_commands"]:
            raise UserError(f"{plant['commands']} commands, {plant['rejected_commands']} of them rejected")
        return f"{plant['commands']} commands, none rejected"

    def priority(self) -> str:
        """Check whether a loop may have a real-time priority."""
        return (
            f"{processes.permitted_priority()}"
            if processes.permitted_priority()
            else "not permitted: `ulimit -r` raises it"
        )


def command(rig: RigName = "", as_json: Json = False) -> None:
    """Check the installation: packages, rig, bags, model, policy and the ROS 2 loop, each PASS or FAIL.

    Laws are compiled once, which takes some two minutes the first time.
    """
    found, failed = list[dict[str, Any]](), list[str]()
    with tempfile.TemporaryDirectory() as place:
        checks = Checks(load(rig), Path(place))
        width = max(map(len, checks.all))
        for name, check in checks.all.items():
            begin = time.perf_counter()
            with status.status(name):
                try:
                    word, seen = "PASS", check()
                except NothingShippedError as error:
                    word, seen = "left out", str(error)
                except UserError as error:
                    word, seen = "FAIL", str(error)
                    failed.append(f"{name}: {error}")
            seconds = round(time.perf_counter() - begin, 1)
            found.append({"check": name, "result": word, "seconds": seconds, "seen": seen})
            (status if as_json else console).print(f"{name:<{width}}  {word:<8}  {seconds:>5} s  {seen}")
    if as_json:
        console.print(json.dumps(found, indent=2))
    end(failed)
