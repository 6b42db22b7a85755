"""The pages of the reference, made of the code while the site is built (mkdocs-gen-files)."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path

import mkdocs_gen_files

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.commands.app import LateCommand
from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.parameters import declarations, parameters
from hybrid_sysid_ros.support import extensions

ROOT = Path(__file__).parents[1]
LIBRARY = (
    "core", "rigs", "bags", "models", "identification", "estimation", "control", "runtime",
    "extensions.accuracy.statistics",
)  # fmt: skip


def page(name: str, lines: Iterator[str]) -> None:
    """Write a page of the reference."""
    with mkdocs_gen_files.open(f"reference/{name}.md", "w") as file:
        file.write("\n".join(lines) + "\n")


def commands() -> Iterator[str]:
    """Every command with its help, as it prints it."""
    yield "# Commands\n\nFor everybody who looks up a command's arguments and options, as `-h` prints them.\n"
    for words, description in extensions.commands().items():
        made, called = LateCommand(words, *description).made(), f"hybrid-sysid {words}"
        context = made.context_class(made, info_name=called, terminal_width=110, max_content_width=110)
        yield f"## {called}\n\n```text\n{made.get_help(context)}\n```\n"


def every_parameter() -> Iterator[str]:
    """Every parameter of every node, as msgs_config declares it."""
    example = rigs.load(rigs.default())
    yield (
        "# Parameters\n\nFor everybody who sets a parameter of a node. The defaults are those of the rig "
        f"{example.name}. A live parameter may be set while the node runs.\n"
    )
    for node in declarations():
        yield f"\n## {node}\n\n| parameter | default | what it is |\n|---|---|---|"
        for name, item in parameters(example, node).items():
            yield f"| `{name}` | `{item.default!r}` | {item.comment.replace('|', '/')} |"


def every_topic() -> Iterator[str]:
    """Every topic, who publishes and hears it, and how it is carried."""
    nodes = {node: _class_of(node) for node in declarations()}
    yield "# Topics and services\n\nFor engineers who connect other nodes. All names are relative but `/diagnostics`.\n"
    yield "| topic | type | published by | subscribed by | reliability | durability | depth |\n" + "|---" * 7 + "|"
    for name, kind in topics.TYPES.items():
        quality = topics.qualities()[name]
        by = ", ".join(node for node, made in nodes.items() if name in made.PUBLISHES) or "all"
        to = (
            ", ".join(node for node, made in nodes.items() if name in made.SUBSCRIBES and node != "recorder") or "tools"
        )
        package, message = kind.__module__.split(".")[0], kind.__name__
        words = (quality["reliability"].name.lower(), quality["durability"].name.lower(), str(quality["depth"]))
        yield f"| `{name}` | `{package}/{message}` | {by} | {to} | {' | '.join(words)} |"
    yield "\n[What they carry, and the services](../guides/loop.md)."


def _class_of(node: str) -> type[RigNode]:
    module = importlib.import_module(extensions.node_module(node))
    return next(
        item
        for item in vars(module).values()
        if isinstance(item, type) and issubclass(item, RigNode) and node == item.NAME
    )


def library() -> Iterator[str]:
    """The public names, then the packages behind them: what their __init__ offers."""
    yield "# Library\n\nFor everybody who calls the package from Python.\n"
    yield "\n## `import hybrid_sysid_ros as hs`\n\nThese names are public. All else may change.\n"
    for name in hs.__all__:
        found = getattr(hs, name)
        yield f"\n::: {found.__module__}.{found.__qualname__}\n"
    yield "\n# Packages behind these names\n"
    for name in (f"hybrid_sysid_ros.{package}" for package in LIBRARY):
        if not (ROOT / name.replace(".", "/")).is_dir():  # an extension that was taken away
            continue
        module = importlib.import_module(name)
        yield f"\n# `{name}`\n\n{' '.join((module.__doc__ or '').split())}\n"
        for item in getattr(module, "__all__", ()):
            yield f"\n::: {name}.{item}\n"


page("commands", commands())
page("parameters", every_parameter())
page("topics", every_topic())
page("library", library())
