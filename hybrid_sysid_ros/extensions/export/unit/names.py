"""Names in a kernel: which it sets and where it reads them, and what they are called in C."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator, Set
from functools import cache

KEYWORDS = (
    " auto break case char const continue default do double else enum extern float for goto if inline int long "
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while "
    "y0 y1 j0 j1 index exp log sin cos tan tanh sqrt pow ceil floor gamma time delete new this class template "
    "operator and or not private public protected bool true false try catch throw unit "
)
"""Names that a variable in C, or in C++, must not have."""


@cache
def counts_of(tree: ast.AST) -> Counter[str]:
    """How often a function sets each name; those of loops only if they are set otherwise, too."""
    return Counter(_assigned(tree))


def _assigned(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AugAssign) else []
        )
        for target in targets:
            for item in ast.walk(target):
                if isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store):
                    yield item.id


@cache
def used_where_made(tree: ast.FunctionDef) -> Set[str]:
    """Names that are only read within the block in which they are set."""
    made: dict[str, tuple[int, ...]] = {}
    used: list[tuple[str, tuple[int, ...]]] = []

    def visit(node: ast.AST, path: tuple[int, ...]) -> None:
        for _, part in ast.iter_fields(node):
            if isinstance(part, list) and part and isinstance(part[0], ast.stmt):
                for item in part:
                    visit(item, (*path, id(part)))
            else:
                for item in part if isinstance(part, list) else [part]:
                    if isinstance(item, ast.Name):
                        if isinstance(item.ctx, ast.Store):
                            made[item.id] = path
                        else:
                            used.append((item.id, path))
                    elif isinstance(item, ast.AST):
                        visit(item, path)

    visit(tree, ())
    outside = {name for name, path in used if name in made and path[: len(made[name])] != made[name]}
    return made.keys() - outside


def variables_of(text: str) -> set[str]:
    """The words of a text in C that are neither arrays nor members."""
    return set(re.findall(r"(?<![@$.>\w])[A-Za-z_]\w*(?![\w@$])", text))


def safe(name: str) -> str:
    """The name of a variable in C."""
    return f"{name}_" if f" {name} " in KEYWORDS else name
