"""Extensions: the one of docs/extend.md as a package of its own, and bad ones."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from hybrid_sysid_ros import models
from hybrid_sysid_ros.runtime import parameters
from hybrid_sysid_ros.runtime.processes import has_ros
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError
from tests.apart import COMMANDS, END, ROOT, Apart, apart_in

PAGE = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```$', PAGE, re.M | re.S))
BAG = ROOT / "bags" / "beam_multisine"
Here = Callable[..., tuple[int, str, str]]


def offer(place: Path, name: str, target: str, **files: str) -> None:
    """Install a package as pip would: its files, and metadata with an entry point."""
    (place / name).mkdir(parents=True)
    (place / name / "__init__.py").touch()
    for file, text in files.items():
        (place / name / f"{file}.py").write_text(text, encoding="utf-8")
    metadata = place / f"{name}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[{extensions.GROUP}]\n{name} = {target}\n")


@pytest.fixture
def apart(tmp_path: Path) -> Apart:
    return apart_in(tmp_path)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Here) -> Iterator[Here]:
    """A command line in this process, which finds the packages in tmp_path / "site" while the test lasts."""
    caches, before = (extensions.registry, parameters.read_declarations), {*sys.modules}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.syspath_prepend(tmp_path / "site")

    def called(*words: str | Path) -> tuple[int, str, str]:
        for item in caches:
            item.cache_clear()
        return command(*words)

    yield called
    monkeypatch.undo()
    for item in caches:
        item.cache_clear()
    for name in {*sys.modules} - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


# A stranger's package


@pytest.fixture
def heating(tmp_path: Path) -> Path:
    """The package of the page, installed, and a rig that uses it."""
    target = re.search(r'^heating = "(.+)"', FILES["pyproject.toml"], re.M)
    assert target is not None
    offer(tmp_path / "site", "heating", target[1])
    for name, text in FILES.items():
        if name.startswith("heating/"):
            (tmp_path / "site" / name).write_text(text, encoding="utf-8")
    return tmp_path / "sled"


REPORT = """
from hybrid_sysid_ros import models
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.report import closed_loop_section
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
rig = load("./sled")
model = models.load("model")
loop = closed_loop_section(LoopRecord.from_bag("loop", rig))
report.write_report("report.html", report.identification_section(model, []), loop, report.provenance(model, "test"))
"""


@pytest.mark.slow
def test_the_page_s_extension_adds_what_it_says(heating: Path, apart: Apart, domain: int) -> None:
    pytest.importorskip("plotly", reason="needs the extra report")

    def does(*lines: str, code: str = "") -> list[str]:
        found = apart(code=COMMANDS + code, lines=lines)
        assert (found.returncode, "warning" in found.stderr) == (0, False), found.stderr
        return found.stdout.split(END)

    helped, run, *_ = does("--help", "run --help", "rig new ./sled")
    assert re.search(r"^  heating +Compare the commands", helped, re.M)
    assert "--heating" in run
    values = heating / "rig.yaml"
    reported = values.read_text(encoding="utf-8")
    content = yaml.safe_load(reported)
    name, kind = next(iter(content["actuators"])), next(iter(content["experiments"]["excitations"]))
    values.write_text(f"{reported}\nheating: {{{name}: 0.25}}\n", encoding="utf-8")
    checked, parameters, *_, shown, _ = does(
        "rig check ./sled",
        "parameters --rig ./sled",
        f"simulate {kind} bag --rig ./sled --duration 10",
        "identify bag --rig ./sled --structure linear --out model",
        "run --rig ./sled --model model --policy exact --lockstep --duration 2 --reference steps --heating --bag loop "
        f"--domain {domain}",
        "heating loop --rig ./sled",
        code=REPORT,
    )
    assert "no problems" in checked
    assert yaml.safe_load(parameters)["/**/heating"]["ros__parameters"]["memory"] == 10.0
    assert "actuator_load" in (heating.parent / "loop" / "metadata.yaml").read_text(encoding="utf-8")
    load = re.match(rf"{name}: (\S+) of 0\.25 ", shown)
    assert load is not None
    assert 0.0 < float(load[1]) < 100.0
    page = (heating.parent / "report.html").read_text(encoding="utf-8")
    assert f"<td>{name}</td><td>{load[1]}</td><td>0.25</td>" in page

    values.write_text(f"{reported}\nheating: {{motor: 0.25}}\n", encoding="utf-8")
    wrong = apart("rig", "check", "./sled")
    assert wrong.returncode == 2
    assert "heating: unknown key 'motor'" in wrong.stderr


def test_a_section_of_nobody_is_refused(heating: Path, here: Here, apart: Apart, tmp_path: Path) -> None:
    """As every typing error: without the package, its section is one."""
    assert here("rig", "new", heating)[0] == 0
    with (heating / "rig.yaml").open("a", encoding="utf-8") as file:
        file.write("\nheating: {}\n")
    assert here("parameters", "--rig", heating)[0] == 0
    (tmp_path / "site").rename(tmp_path / "away")
    refused = apart("parameters", "--rig", heating)  # a process reads a rig once
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "unknown key 'heating'" in refused.stderr


MANIFEST = "from hybrid_sysid_ros.support.manifest import Extension\nEXTENSION = Extension(name={!r}, summary='', {})"


@pytest.mark.parametrize(
    ("manifest", "why"),
    [
        ("1 / 0", "ZeroDivisionError"),
        ("raise SystemExit('bye')", "SystemExit: bye"),
        ("EXTENSION = 5", "needs an Extension"),
        ("", "has no attribute 'EXTENSION'"),
        (MANIFEST.format("tides", "commands={'identify': ('tides', '')}"), "command identify"),
        (MANIFEST.format("tides", "commands={'rig': ('tides', '')}"), "command rig"),
        (MANIFEST.format("tides", "nodes={'plant': 'tides'}"), "node plant"),
        (MANIFEST.format("tides", "provides={'sections': {'sensors': 'tides:check'}}"), "sections sensors"),
        (MANIFEST.format("hybrid_sysid_ros", ""), "extension hybrid_sysid_ros"),
        (MANIFEST.format(5, ""), "name is 5"),
        (MANIFEST.format("tides", "commands={'tide': 'tides.command'}"), "commands is"),
        (MANIFEST.format("tides", "commands=['tide']"), "commands is"),
        (MANIFEST.format("tides", "provides={'structures': ['x']}"), "provides is"),
        (MANIFEST.format("tides", "provides={'struktures': {}}"), "unknown kind 'struktures'"),
        (MANIFEST.format("tides", "declarations='nodes.yaml'"), "declarations is"),
    ],
)
def test_a_bad_extension_is_named_in_a_line_and_the_rest_works(
    tmp_path: Path, here: Here, manifest: str, why: str
) -> None:
    offer(tmp_path / "site", "tides", "tides.extension:EXTENSION", extension=manifest)
    offer(tmp_path / "site", "waves", "waves.extension:EXTENSION", extension=MANIFEST.format(
        "waves", "commands={'waves': ('waves.command', 'Make waves.')}"))  # fmt: skip
    status, printed, complaint = here("--help")
    assert status == 0
    assert all(word in printed for word in ("identify", "Make waves."))
    assert complaint.count("\n") == 1
    assert complaint.startswith("warning: extension tides ")
    assert why in complaint


def test_of_two_extensions_of_one_name_the_first_is_used(tmp_path: Path, here: Here) -> None:
    for name in ("tides", "waves"):
        given = f"commands={{'{name}': ('{name}', 'Of {name}.')}}"
        offer(tmp_path / "site", name, f"{name}.extension:EXTENSION", extension=MANIFEST.format("sea", given))
    _, printed, complaint = here("--help")
    assert "Of tides." in printed
    assert "Of waves." not in printed
    assert complaint.count("\n") == 1
    assert "extension sea" in complaint


def test_what_can_t_be_imported_is_named_when_it_is_needed(tmp_path: Path, here: Here) -> None:
    given = "provides={'companions': {'tides': 'tides.nowhere:companion'}}"
    offer(tmp_path / "site", "tides", "tides.extension:EXTENSION", extension=MANIFEST.format("tides", given))
    assert here("--help")[2] == ""
    status, printed, complaint = here("run", "--help")
    assert status == 0
    assert "--lockstep" in printed
    assert complaint.count("\n") == 1
    assert "tides.nowhere" in complaint


def test_an_estimator_of_another_package_is_a_method(tmp_path: Path, here: Here) -> None:
    given = "provides={'estimators': {'tidal': 'hybrid_sysid_ros.estimation:ExtendedKalmanFilter'}}"
    offer(tmp_path / "site", "tides", "tides.extension:EXTENSION", extension=MANIFEST.format("tides", given))
    status, printed, _ = here("parameters", "--rig", "wheel_motor")
    assert status == 0
    assert re.search(r"one of ekf, .*\btidal\b", printed)


@pytest.mark.parametrize(
    ("declared", "why"),
    [
        ("nodes: {tides: {high: {default: a, choices: moons, description: High.}}}", "choices is 'moons'"),
        (None, "cannot be read"),
        ("nodes: [", "nodes.yaml"),
        ("parameters: {}", "unknown key 'parameters'"),
        ("nodes: {tides: 3}", "tides needs keys"),
        ("nodes: {tides: {high: {default: 1.0, range: big, description: High.}}}", "tides.high.range is 'big'"),
        ("nodes: {tides: {high: {default: ten, range: [0, 1], description: High.}}}", "'ten'"),
        ("nodes: {tides: {high: {default: 5.0, range: [0, 1], description: High.}}}", "high is 5.0"),
        ("nodes: {tides: {high: {default: 5.0, above: moon, description: High.}}}", "above is moon"),
        ("nodes: {tides: {high: {default: a, choices: 5, description: High.}}}", "tides.high.choices is 5"),
        ("topics: [moon]", "topics needs keys"),
        ("nodes: {controller: {horizon: {default: 1, description: High.}}}", "horizon is declared already"),
    ],
)
def test_declarations_that_can_t_be_read_are_named_and_the_rest_works(
    tmp_path: Path, here: Here, declared: str | None, why: str
) -> None:
    given = "declarations=__import__('pathlib').Path(__file__).with_name('nodes.yaml')"
    offer(tmp_path / "site", "tides", "tides.extension:EXTENSION", extension=MANIFEST.format("tides", given))
    if declared is not None:
        (tmp_path / "site" / "tides" / "nodes.yaml").write_text(declared)
    status, shown, complaint = here("parameters")
    assert status == 0
    assert "/**/plant:" in shown
    assert complaint.count("\n") == 1
    assert "extension tides" in complaint
    assert str(tmp_path / "site" / "tides" / "nodes.yaml") in complaint
    assert why in complaint


CODE = """
from hybrid_sysid_ros.models import Structure
class Tides(Structure):
    def fit(self, context):
        raise ValueError("no moon")
    def assemble(self, design, weights):
        raise ValueError("no moon")
def check(rig):
    raise ValueError("no moon")
NUMBER = 5
"""


@pytest.mark.parametrize(
    ("given", "line", "why"),
    [
        ("commands={'tide': ('tides.nowhere', '')}", "tide", "tides.nowhere"),
        ("commands={'tide': ('tides.code', '')}", "tide", "no attribute 'command'"),
        ("provides={'sections': {'travel_of_moon': 'tides.code:check'}}", "rig check ./raft", "no moon"),
        (
            "provides={'structures': {'tides': 'tides.code:Tides'}}",
            f"identify {BAG} --structure tides --out m",
            "no moon",
        ),
        (
            "provides={'structures': {'tides': 'tides.code:NUMBER'}}",
            f"identify {BAG} --structure tides --out m",
            "is 5",
        ),
    ],
)
def test_code_that_is_wrong_is_named_in_a_line(tmp_path: Path, here: Here, given: str, line: str, why: str) -> None:
    offer(tmp_path / "site", "tides", "tides.extension:EXTENSION", extension=MANIFEST.format("tides", given), code=CODE)
    if "raft" in line:
        assert here("rig", "new", tmp_path / "raft")[0] == 0
        with (tmp_path / "raft" / "rig.yaml").open("a", encoding="utf-8") as file:
            file.write("\ntravel_of_moon: {}\n")
    status, _, complaint = here(*line.split())
    assert (status, complaint.count("\n")) == (2, 1), complaint
    assert "tides.code" in complaint or "tides.nowhere" in complaint
    assert why in complaint


@pytest.mark.skipif(not has_ros(), reason="needs ROS 2")
def test_a_topic_of_an_unknown_type_is_left_out(tmp_path: Path, apart: Apart) -> None:
    given = "declarations=__import__('pathlib').Path(__file__).with_name('nodes.yaml')"
    offer(tmp_path / "site", "tides", "tides.extension:EXTENSION", extension=MANIFEST.format("tides", given))
    path = tmp_path / "site" / "tides" / "nodes.yaml"
    path.write_text("topics: {height: {type: std_msgs/msg/Nothing}, level: {type: std_msgs/msg/Float64}}")
    code = """
from hybrid_sysid_ros.nodes.topics import TYPES
from hybrid_sysid_ros.support.errors import UserError
assert "level" in TYPES
try:
    TYPES["height"]
except UserError as error:
    print(error)
"""
    found = apart(code=code)
    assert f"{path}: topics.height: std_msgs/msg/Nothing is not installed" in found.stdout, found.stderr


def test_a_mistake_of_this_package_stays_as_it_is() -> None:
    with pytest.raises(ZeroDivisionError), extensions.blaming("moon", "hybrid_sysid_ros.moon"):
        _ = 1 / 0
    with pytest.raises(UserError, match="moon: ZeroDivisionError"), extensions.blaming("moon", "tides.moon"):
        _ = 1 / 0


def test_an_interrupt_while_extensions_are_looked_for_stays_one(tmp_path: Path, apart: Apart) -> None:
    offer(tmp_path / "site", "tides", "tides.extension:EXTENSION", extension="raise KeyboardInterrupt")
    found = apart("--help")
    assert (found.returncode, found.stdout, found.stderr) == (130, "", "interrupted\n")


@pytest.mark.parametrize(
    ("manifest", "why"),
    [
        ("1 / 0", "extension tides (tides.extension:EXTENSION) is left out: "),
        (MANIFEST.format("tides", "provides={'structures': {'tides': 'tides.nowhere:Tides'}}"), "tides.nowhere:Tides"),
    ],
)
def test_a_model_of_a_structure_that_is_left_out_names_its_extension(
    tmp_path: Path, here: Here, manifest: str, why: str
) -> None:
    replace(models.load(ROOT / "trained" / "cam_beam" / "model"), structure="tides").save(tmp_path / "m")
    offer(tmp_path / "site", "tides", "tides.extension:EXTENSION", extension=manifest)
    status, _, complaint = here("evaluate", tmp_path / "m", BAG)
    *_, line = complaint.splitlines()
    assert (status, line.startswith(f"error: {tmp_path / 'm' / 'model.yaml'}: ")) == (2, True)
    assert why in line
