"""What the command line says of itself: version, help, choices, completion."""

from __future__ import annotations

import importlib.metadata
from typing import get_args

import pytest

from hybrid_sysid_ros.commands.app import LateCommand, program
from hybrid_sysid_ros.commands.options import DriverChoice
from hybrid_sysid_ros.runtime.parameters import parameters
from hybrid_sysid_ros.support import extensions

COMMANDS = extensions.commands()
SHARED = {"--rig", "--overwrite", "--seed", "--json", "--recover", "--model", "--domain"}
"""Options that take the same wherever a command has them."""
FILES_ALONE = {
    *("simulate", "film", "import", "parameters", "play", "rig new", "rig driver", "rig from", "rig layouts"),
    *("export fmu", "export board", "export mjcf", "export page", "export ros2_control", "export urdf", "export loop"),
    *("model export", "policy export", "friction", "trained-range"),
    *("docs", "say", "mcp", "view"),  # which talk, or show a page
}
"""Commands whose result is no numbers on the screen."""


def test_the_version_is_that_of_the_package(command):
    assert command("--version") == (0, f"hybrid-sysid {importlib.metadata.version('hybrid_sysid_ros')}\n", "")


@pytest.mark.parametrize("words", [(), ("policy",), ("rig", "list")])
def test_a_short_option_asks_for_help_everywhere(command, words):
    status, out, _ = command(*words, "-h")
    assert status == 0
    assert out == command(*words, "--help")[1]


@pytest.mark.parametrize("words", COMMANDS)
def test_help_names_kinds_in_words_and_fits_a_terminal(words, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    made = LateCommand(words, *COMMANDS[words]).made()
    text = made.get_help(made.context_class(made, info_name=words))
    assert max(map(len, text.splitlines())) <= 80
    for kind in ("list[", "range>", "<str>", "<float>", "<int>", "Path"):
        assert kind not in text, text


def test_an_option_is_the_same_wherever_it_is():
    kinds: dict[str, set[object]] = {}
    for words, entry in COMMANDS.items():
        for item in LateCommand(words, *entry).made().params:
            for name in SHARED.intersection(item.opts):
                kinds.setdefault(name, set()).add((type(item).__name__, getattr(item, "is_flag", False)))
    assert kinds.keys() == SHARED
    assert {name for name, found in kinds.items() if len(found) > 1} == set()


def options(words: str) -> set[str]:
    """Names of a command's options, and of its arguments in small letters."""
    return {name for item in LateCommand(words, *COMMANDS[words]).made().params for name in item.opts}


def test_numbers_for_people_are_there_for_scripts():
    assert {words for words in COMMANDS if "--json" not in options(words)} == FILES_ALONE


def test_what_a_command_writes_is_replaced_when_asked():
    """Pages and pictures always are, and so is what a command that goes on from there has written itself."""
    writing = {words for words in COMMANDS if not {"--out", "--bag", "out", "folder"}.isdisjoint(options(words))}
    assert {words for words in writing if "--overwrite" not in options(words)} == {
        *("rig new", "rig driver", "rig from"),  # which their user edits
        *("mockup", "friction"),
    }


def test_a_default_is_shown_as_it_is_typed(command):
    shown = " ".join(command("run", "-h")[1].split())
    assert "[default: cam_beam]" in shown
    assert "hybrid-sysid call [OPTIONS] [SERVICE] " in " ".join(command("call", "-h")[1].split())


def test_the_choices_of_who_drives_are_those_of_the_controller():
    assert get_args(DriverChoice) == parameters("cam_beam", "controller")["policy"].choices


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("hybrid-sysid policy tr", ["train"]),
        ("hybrid-sysid run --rig flex", ["flexible_joint"]),
        ("hybrid-sysid export loop --rig flex", ["flexible_joint"]),
        ("hybrid-sysid tune flex", ["flexible_joint"]),
        ("hybrid-sysid run --policy ", [*get_args(DriverChoice)]),
        ("hybrid-sysid identify --structure dah", ["dahl"]),
    ],
)
def test_a_shell_completes_commands_options_and_values(command, monkeypatch, line, offered):
    """A shell runs the program with the line in its environment."""
    monkeypatch.setenv("_HYBRID_SYSID_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(line.count(" ")))
    assert command()[1].split() == offered


def test_completion_is_offered_for_the_common_shells(command):
    names = {name for item in program().params for name in item.opts}
    assert {"--install-completion", "--show-completion"} <= names
