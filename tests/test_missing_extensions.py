"""What is asked of an extension of ours that is not there, or that fails, is refused in a line that names it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hybrid_sysid_ros import models
from hybrid_sysid_ros.commands import evaluate, identify, run
from hybrid_sysid_ros.commands.app import arguments_of
from hybrid_sysid_ros.extensions.demo.commands import demo
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.trunk import NEIGHBOURS
from tests.command_line import Answer, refused


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder of extensions."""
    monkeypatch.setattr(extensions, "HOME", tmp_path)
    extensions.registry.cache_clear()
    yield tmp_path
    extensions.registry.cache_clear()


@pytest.mark.parametrize("words", [words for names in NEIGHBOURS.values() for words in names])
def test_a_missing_extension_of_ours_is_named(home: Path, words: str, command: Callable[..., Answer]) -> None:
    owner = next(owner for owner, names in NEIGHBOURS.items() if words in names)
    why = f"its extension {owner} is missing: {home / owner} is not there"
    assert extensions.missing(words).startswith(why)
    if words in ("say", "policy train"):
        refused(command(*words.split()), f"error: command {words}: {why}")
    if words.startswith("--"):
        refused(command("run", words, "1"), f"error: option {words}: {why}")


@pytest.mark.usefixtures("home")
def test_an_extension_of_ours_that_fails_is_named() -> None:
    extensions.registry().problems.append("extension narx is left out: no moon")
    with pytest.raises(UserError, match="structure 'residual_gray': extension narx is left out: no moon"):
        models.structure_of("residual_gray", None)  # type: ignore[arg-type]


def _options(extension: extensions.Extension) -> set[str]:
    """Options that it adds to commands of others."""
    commands: dict[str, Callable[..., None]] = {
        "companions": run.command,
        "demos": demo.command,
        "inspections": evaluate.command,
        "comparisons": identify.command,
    }
    makers = [extensions.loaded(item) for kind in commands for item in extension.provides.get(kind, {}).values()]
    added = {name for make in makers for name in arguments_of(make)}
    return {f"--{name}" for name in added.difference(*map(arguments_of, commands.values()))}


def test_what_ours_add_is_known_without_them() -> None:
    ours = {path.parent.name for path in extensions.HOME.glob(f"*/{extensions.MANIFEST}")}
    named = {
        item.name: {*item.commands, *item.nodes, *item.provides.get("structures", ()), *_options(item)}
        for item in extensions.installed()
        if item.name in ours
    }
    known = {name: set(names) for name, names in NEIGHBOURS.items() if name in ours}
    assert known == {name: added for name, added in named.items() if added}
