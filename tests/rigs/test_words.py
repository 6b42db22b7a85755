"""Nothing of the package names a rig, its units or its records, but the rig's own folder."""

import re
from functools import cache
from pathlib import Path

from hybrid_sysid_ros.models import structure_names
from hybrid_sysid_ros.support.structured import read_mapping

ROOT = Path(__file__).parents[2]
RIGS = sorted(path.parent for path in (ROOT / "hybrid_sysid_ros" / "rigs").glob("[!_]*/system.py"))
STUDIES = [path.name for path in (ROOT / "studies").iterdir() if (path / "__init__.py").is_file()]
BAGS = [path.name for path in (ROOT / "bags").iterdir() if path.is_dir()]
ANYBODYS = {
    *("joint", "motor", "robot", "wheel", "string", "drill", "haste", "creeping", "bearing", "course", "psi", "roda"),
    *("coulomb", "hysteretic", "public", *structure_names()),
}
"""Words of rigs and studies that any may have."""

OWN = {*RIGS, ROOT / "hybrid_sysid_ros" / "trained"}
APART = {"__pycache__", "docs", "tests"}
PACKAGE = ROOT / "hybrid_sysid_ros"
OF_THE_SI = {
    PACKAGE / "rigs" / "units.py",
    PACKAGE / "extensions" / "importing" / "guessing.py",
    *(PACKAGE / "extensions" / "commander" / "language" / "words").glob("*.yaml"),
}
"""Name every unit, whoever uses it, but no rig."""
TEXT = {".py", ".yaml", ".toml", ".cfg", ".xml", ".html", ".md", ".json", ".txt", ""}
SEARCHED = [
    "hybrid_sysid_ros",
    "nodes",
    "launch",
    "msgs_config",
    "resource",
    "package.xml",
    "pyproject.toml",
    "setup.py",
]


def files():
    for name in SEARCHED:
        start = ROOT / name
        for path in sorted(start.rglob("*")) if start.is_dir() else [start]:
            own = OWN.intersection(path.parents) or APART.intersection(path.relative_to(ROOT).parts)
            if path.is_file() and path.suffix in TEXT and not own:
                yield path


UNITS = re.compile(r"(?<![A-Za-z])(?i:volts?)(?![A-Za-z])|\[m?V\]|\d m?V\b|\bmV\b")


@cache
def names() -> re.Pattern[str]:
    words = {*BAGS, "lecture", r"[mr]s_0\d"}
    for name in (*(path.name for path in RIGS), *STUDIES):
        parts = name.split("_")
        words |= {name, " ".join(parts), "-".join(parts), *parts}
    for path in RIGS:
        source = (path / "system.py").read_text(encoding="utf-8")
        words |= set(re.findall(r"^class (\w+)", source, re.MULTILINE))
        structures = re.search(r"^STRUCTURES.*?= *\{(.*?)\}", source, re.MULTILINE | re.DOTALL)
        words |= set(re.findall(r'"(\w+)":', structures[1])) if structures else set()
        spoken = read_mapping(path / "rig.yaml").get("names", {})
        named = [item for language in spoken.values() for item in language.items() if item[0][0] not in "+-"]
        words |= {word for _, others in named for word in others}  # directions have words of anybody
    words = {word for word in words if word.lower() not in ANYBODYS}
    return re.compile(rf"(?<![A-Za-z])(?i:{'|'.join(sorted(words))})(?![A-Za-z])")


def found_in(text: str, path: Path | None = None) -> bool:
    """Whether a line of a file names a rig, or a unit of one."""
    return bool(names().search(text) or (path not in OF_THE_SI and UNITS.search(text)))


def test_the_words_of_rigs_are_found_where_they_are():
    """Or the other test says nothing."""
    assert len(RIGS) > 1
    for path in RIGS:
        assert found_in((path / "rig.yaml").read_text(encoding="utf-8"))
    assert len(list(files())) > 150
    for text in ("a Beam", "cam_beam.yaml", "[V]", "10 mV", "beam_multisine", "ms_05", "flexible joint", "a viga"):
        assert found_in(text)
    for text in ("came", "camera", "V = H P H'", "a joint", "ms_to"):
        assert not found_in(text)
    for path in OF_THE_SI:
        assert found_in("the beam", path)
        assert not found_in("volts", path)


def test_no_file_outside_of_a_rig_s_folder_names_it():
    found = []
    for path in files():
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if found_in(line, path):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert found == []
