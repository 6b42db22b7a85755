"""Single-line mutants of gates and thresholds, and which of them the tests do not kill.

    python -m benchmarks.mutants [FILE...]            # those of benchmarks/mutants.toml, or of some files of it
    python -m benchmarks.mutants --of FILE FUNCTION   # list what could be mutated in a function

benchmarks/mutants.toml says for each function its tests, and its mutants by the operators of cosmic-ray and their
occurrences in the function. Mutated is a copy of the tree. Exit status: 1 where a mutant lives.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import local
from typing import Any

from hybrid_sysid_ros.support import threads
from hybrid_sysid_ros.support.extras import extra

with extra("mutants"):
    import cosmic_ray.ast
    import cosmic_ray.plugins
    from cosmic_ray.mutating import mutate_code

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
TIMEOUT = 600.0  # s, of the tests of one mutant: one that does not end is killed, too
COMPARISONS = ("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Lt_GtE", "LtE_Gt", "Gt_LtE", "GtE_Lt", "Eq_NotEq", "NotEq_Eq")
OPERATORS = (
    *(f"ReplaceComparisonOperator_{name}" for name in (*COMPARISONS, "Is_IsNot", "IsNot_Is")),
    *(
        "ReplaceAndWithOr",
        "ReplaceOrWithAnd",
        "AddNot",
        "NumberReplacer",
        "ReplaceTrueWithFalse",
        "ReplaceFalseWithTrue",
    ),
)


@dataclass(frozen=True)
class Mutant:
    """One line of a function changed."""

    file: str
    function: str
    name: str
    """Operator and its occurrence in the function."""
    tests: tuple[str, ...]
    line: int
    code: str
    """Of the whole file."""

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.function}: {self.name}: {self.code.splitlines()[self.line - 1].strip()}"


def mutants_of(file: str, function: str, tests: Sequence[str] = ()) -> Iterator[Mutant]:
    """All of a function, by the operators above. Raises SystemExit where there is no such function."""
    source = (ROOT / file).read_text(encoding="utf-8")
    found = [node for node in ast.walk(ast.parse(source)) if getattr(node, "name", None) == function]
    if len(found) != 1:
        sys.exit(f"error: {len(found)} functions {function} in {file}: name one that is there once")
    (node,) = found
    assert isinstance(node, ast.FunctionDef)
    tree = cosmic_ray.ast.get_ast(source)
    for name in OPERATORS:
        operator: Any = cosmic_ray.plugins.get_operator(f"core/{name}")()
        places = [place for item in cosmic_ray.ast.ast_nodes(tree) for place in operator.mutation_positions(item)]
        inside = [i for i, ((line, _), _) in enumerate(places) if node.body[0].lineno <= line <= (node.end_lineno or 0)]
        for number, place in enumerate(inside):
            code = mutate_code(source, operator, place)
            yield Mutant(file, function, f"{name} {number}", tuple(tests), places[place][0][0], code)


def listed(files: Sequence[str]) -> list[Mutant]:
    """Those of the list, of some files or of all."""
    gates = tomllib.loads((ROOT / "benchmarks" / "mutants.toml").read_text(encoding="utf-8"))["gate"]
    found = []
    for gate in gates:
        if not files or gate["file"] in files:
            known = {item.name: item for item in mutants_of(gate["file"], gate["function"], gate["tests"])}
            for name in gate["mutants"]:
                if name not in known:
                    sys.exit(f"error: {gate['file']}: {gate['function']} has no {name}: see --of")
                found.append(known[name])
    return found


class Trees:
    """Copies of the tree, one for each thread, in which mutants are tested."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._mine = folder, local()

    def passes(self, tests: Sequence[str], mutant: Mutant | None = None) -> bool:
        """Whether the tests pass, with a mutant or as all is."""
        if not hasattr(self._mine, "tree"):
            self._mine.tree = Path(tempfile.mkdtemp(dir=self._folder)) / "tree"
            ignored = shutil.ignore_patterns(".git", ".venv", "out", "build", "__pycache__", ".*_cache")
            shutil.copytree(ROOT, self._mine.tree, symlinks=True, ignore=ignored)
        tree: Path = self._mine.tree
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
        environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
        place = None if mutant is None else tree / mutant.file
        original = "" if place is None else place.read_text(encoding="utf-8")
        try:
            if place is not None and mutant is not None:
                place.write_text(mutant.code, encoding="utf-8")
            quiet: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "timeout": TIMEOUT}
            return not subprocess.run(command, cwd=tree, env=environment, check=False, **quiet).returncode
        except subprocess.TimeoutExpired:
            return False
        finally:
            if place is not None:
                place.write_text(original, encoding="utf-8")


def main(words: list[str]) -> int:
    """Test the mutants, print the living."""
    if words[:1] == ["--of"]:
        print(*mutants_of(*words[1:]), sep="\n")
        return 0
    mutants = listed(words)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(threads.available()) as pool:
        trees = Trees(Path(folder))
        needed = sorted({item.tests for item in mutants})
        broken = [tests for tests, sound in zip(needed, pool.map(trees.passes, needed), strict=True) if not sound]
        if broken:
            print(f"error: without a mutant fail {broken}", file=sys.stderr)
            return 2
        living = []
        for mutant, alive in zip(mutants, pool.map(lambda one: trees.passes(one.tests, one), mutants), strict=True):
            print("lives " if alive else "killed", mutant, flush=True)
            living += [mutant] if alive else []
    print(f"{len(mutants) - len(living)} of {len(mutants)} killed")
    return 1 if living else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
