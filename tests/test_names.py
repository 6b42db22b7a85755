"""One name has one meaning in the whole package, and names that have gone do not come back."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
FILES = sorted({path.resolve() for folder in ("hybrid_sysid_ros", "nodes") for path in (ROOT / folder).rglob("*.py")})
PUBLIC = [path for path in FILES if "tests" not in path.parts]
FRONT_DOOR = {"Model", "Policy", "identify", "certify", "export", "simulate"}
"""Of ``import hybrid_sysid_ros as hs``, beside what they wrap."""
SHARED = FRONT_DOOR | {"FreeRun", "EXTENSION"}
GONE = re.compile(
    r"told|_told\w*|sloped|stepped|fly|flown|hears|HEARS|aside|patient|strangers?|way_of|Leftover|beginning|Desk|Pictured"
    r"|Fired|Shooting|Whereabouts|Understanding|Inquiry|Playhead|Drifting|belongings|Border|Pilot|Plan|Problem|Prediction"
    r"|Observer|Experiment|Outcome|Motion|Layout|Place|Order|Mode|Form|Format|Windows|Still|Speaker|Channel|Estimate"
    r"|Schedule|Quality|DemoRecords|telling|_off|take_back|believed?|sight|motion_ahead|pictures_ahead|begun|placed|forced"
    r"|observed|miss|remembered"
)
"""Names that had several meanings, or that nobody outside of this project would have guessed."""
ANYWHERE = re.compile(rf"\b(?:{GONE.pattern})\b")
"""The same in any text, whose names are only looked at where there is one."""


def _module(path: Path) -> str:
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    return name if name.startswith("hybrid_sysid_ros") else f"hybrid_sysid_ros.{name}"


class Named(NamedTuple):
    """Names of a file: of its types and functions at the top, and of what it imports from modules."""

    types: list[str]
    functions: list[str]
    imported: list[tuple[str, str]]


@cache
def _named(path: Path) -> Named:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return Named(
        types=_types(tree),
        functions=[node.name for node in tree.body if isinstance(node, ast.FunctionDef)],
        imported=[(node.module or "", item.name) for node in imports for item in node.names],
    )


def _types(tree: ast.Module) -> list[str]:
    """Classes and aliases of types at the top of a file, without private ones."""
    assigned = [target for node in tree.body if isinstance(node, ast.Assign) for target in node.targets]
    names = [node.name for node in tree.body if isinstance(node, ast.ClassDef)]
    names += [
        node.target.id for node in tree.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    ]
    names += [target.id for target in assigned if isinstance(target, ast.Name)]
    return [name for name in names if re.match(r"[A-Z]\w*[a-z]", name)]


def test_a_type_has_a_name_of_its_own():
    found = defaultdict(list)
    for path in PUBLIC:
        for name in _named(path).types:
            found[name].append(_module(path))
    assert {name: where for name, where in found.items() if len(where) > 1 and name not in SHARED} == {}


def test_a_function_that_is_imported_by_its_name_is_one():
    """Functions of one name are called by their modules: ``metadata.load``, ``policy.load``."""
    defined, imported = defaultdict(set), defaultdict(set)
    for path in PUBLIC:
        for name in _named(path).functions:
            defined[name].add(_module(path))
    for path in (path for path in PUBLIC if path.name != "__init__.py"):
        for module, name in _named(path).imported:
            if module in defined.get(name, ()):
                imported[name].add(module)
    assert {name: where for name, where in imported.items() if len(where) > 1 and name not in FRONT_DOOR} == {}


def test_names_that_have_gone_do_not_come_back():
    found = {}
    for path in (path for path in FILES if ANYWHERE.search(path.read_text(encoding="utf-8"))):
        tokens = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
        names = {token.string for token in tokens if token.type == tokenize.NAME}
        if gone := sorted(name for name in names if GONE.fullmatch(name)):
            found[str(path.relative_to(ROOT))] = gone
    assert found == {}
