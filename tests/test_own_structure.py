"""docs/own-structure.md, word for word: a structure of another package is identified, stored, loaded and run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "own-structure.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```$', PAGE, re.M | re.S))
COMMANDS = [line.split()[1:] for line in re.findall(r"^    (hybrid-sysid .*)$", PAGE, re.M)]
Call = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Where the package of the page is installed, as pip would: its files, and metadata with the entry point."""
    place = tmp_path / "site"
    for name, text in FILES.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text, encoding="utf-8")
    (place / "hammerstein" / "__init__.py").touch()
    metadata = place / "hammerstein-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: hammerstein\nVersion: 1.0\n")
    points = re.search(r'^\[project\.entry-points\."(.+)"\]\n(\w+) = "(.+)"', FILES["pyproject.toml"], re.M)
    assert points is not None
    (metadata / "entry_points.txt").write_text(f"[{points[1]}]\n{points[2]} = {points[3]}\n")
    return place


@pytest.fixture
def call(tmp_path: Path, site: Path) -> Call:
    """A command line, or Python code, in a process that finds the package or does not."""
    (tmp_path / "bags").symlink_to(ROOT / "bags")

    def called(*words: str, code: str = "", installed: bool = True) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join(map(str, (site, ROOT) if installed else (ROOT,)))
        program = ["-c", code] if code else ["-m", "hybrid_sysid_ros"]
        return subprocess.run(
            [sys.executable, *program, *words],
            capture_output=True, text=True, cwd=tmp_path, timeout=600,
            env={**os.environ, "PYTHONPATH": path, "COLUMNS": "200"},
        )  # fmt: skip

    return called


def test_the_structure_is_short() -> None:
    assert len(FILES["hammerstein/structure.py"].splitlines()) < 80


TRUTH = """
from dataclasses import replace
import numpy as np
from hybrid_sysid_ros import models
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.identification import evaluate, identify
from hybrid_sysid_ros.rigs.rig import load

rig, sampling = load("cam_beam"), models.Sampling(step=0.005, period=0.05)
plain = models.structure_of("hammerstein", rig.system).assemble({}, np.zeros(0))
truth = replace(
    plain, output_size=0.05, input_size=4.0, gain=0.8, square=0.3, cube=-0.2, offset=0.1, frequency=7.0, damping=0.4
)


def driven(seed):
    u = np.random.default_rng(seed).uniform(-6, 6, 80).repeat(50)[:, None]
    y = simulate(truth, np.array([0.005, 0.0]), u[:-1], step=0.005)[:, :1]
    return Record(name=f"driven {seed}", time=0.005 * np.arange(len(u)), input=u, output=y)


model = identify([driven(0)], rig, "hammerstein", sampling=sampling)
found = model.system.named
for name in ("frequency", "damping"):
    assert abs(found[name] / truth.named[name] - 1.0) < 1e-3, found


def curve(system, u):
    value, z = system.named, u / system.input_size
    return system.output_size * value["gain"] * z * (1 + value["square"] * z + value["cube"] * z**2)


volts = np.linspace(-6, 6, 13)
assert np.abs(curve(model.system, volts) - curve(truth, volts)).max() < 1e-3 * np.abs(curve(truth, volts)).max()
assert evaluate(model, driven(1)).r2 > 0.9999
straight = identify([driven(0)], rig, "hammerstein", sampling=sampling, options={"degree": 1})
assert straight.system.square == straight.system.cube == 0.0
assert evaluate(straight, driven(1)).r2 < evaluate(model, driven(1)).r2
"""

RUN = """
import numpy as np
from hybrid_sysid_ros import models
from hybrid_sysid_ros.estimation import estimator_class
from hybrid_sysid_ros.estimation.tuning import Tuning

model = models.load("my_model")
(line,) = model.kind.lines(model.system)
assert line.startswith("curve: ")
tuning = Tuning(
    measurement_noise=(1e-5,), process_noise=(1e-4, 1e-2), disturbance_noise=(0.1,), disturbance_limit=(1.0,), gate=9.0
)
estimator = estimator_class("ekf")(model.system, tuning, period=0.005, latency=0.0)
for k in range(5):
    estimate = estimator.update(0.005 * k, np.array([0.01]), np.array([1.0]))
assert np.isfinite(estimate.covariance).all()
assert abs(estimate.state[0] - 0.01) < 1e-3
"""


@pytest.mark.slow
def test_known_parameters_come_back(call: Call) -> None:
    found = call(code=TRUTH)
    assert found.returncode == 0, found.stderr


@pytest.mark.slow
def test_the_commands_of_the_page_run_and_without_the_package_the_model_is_refused(call: Call, tmp_path: Path) -> None:
    identified, evaluated = (call(*words) for words in COMMANDS)
    assert (identified.returncode, evaluated.returncode) == (0, 0), identified.stderr + evaluated.stderr
    assert "curve: " in identified.stdout
    ran = call(code=RUN)
    assert ran.returncode == 0, ran.stderr
    refused = call(*COMMANDS[1], installed=False)
    assert refused.returncode == 2
    (line,) = refused.stderr.strip().splitlines()
    assert "hammerstein" in line
