"""A command line as a program: its errors and interrupts, one line each."""

from __future__ import annotations

import importlib
import logging
import sys
from collections.abc import Sequence
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

from hybrid_sysid_ros.support.errors import Interrupted, UserError

UsageError = cast(type[typer.BadParameter], typer.BadParameter.__mro__[1])
"""What typer raises for wrong arguments of any kind; it gives a name to this kind only."""


class LateCommand(TyperCommand):
    """A command that is imported when it is called: the list of all needs its summary only."""

    def __init__(self, name: str, module: str, summary: str) -> None:
        """module: its full name; its function ``command`` is the command."""
        super().__init__(name, short_help=summary)
        self.module = module

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        app.command(self.name)(importlib.import_module(self.module).command)
        made: Any = typer.main.get_command(app)
        if "--help" in args:
            from hybrid_sysid_ros.rigs.rig import default

            for option in made.params:
                if option.name == "rig" and not option.required and not option.callback:
                    option.show_default = default()
        return made.make_context(info_name, args, parent=parent, **extra)


class Commands(TyperGroup):
    """All commands. An interrupt leaves them by a name of its own: at KeyboardInterrupt typer ends without a word."""

    def __init__(self, name: str, commands: Sequence[TyperCommand | TyperGroup], **settings: Any) -> None:
        super().__init__(name=name, commands=commands, no_args_is_help=True, rich_markup_mode=None, **settings)

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise Interrupted from error


def _usage(error: typer.BadParameter) -> str:
    """What is wrong with the arguments, in one line; the help where there are none."""
    told, context = error.format_message(), error.ctx
    if context is not None and told == context.get_help():
        return told
    line = " ".join(told.split()).rstrip(".")
    return f"error: {line[0].lower()}{line[1:]}{f': see {context.command_path} --help' if context else ''}"


def run_program(program: Commands) -> None:
    """Run a command of a program; exit with 2 and one line for what a user can cause, with 130 and one for an
    interrupt.
    """
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    try:
        sys.exit(program(prog_name=program.name, standalone_mode=False))
    except UsageError as error:
        sys.stderr.write(_usage(error) + "\n")
        sys.exit(2)
    except UserError as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        sys.exit(2)
    except OSError as error:  # such as a full disk behind standard output, or a pipe that closed
        sys.stderr.write(f"error: {error.filename or 'standard output'}: {error.strerror or error}\n")
        sys.exit(2)
    except (Interrupted, KeyboardInterrupt) as error:
        sys.stderr.write(": ".join(filter(None, ("interrupted", str(error)))) + "\n")
        sys.exit(130)
