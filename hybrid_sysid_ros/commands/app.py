"""The command line as a program: its commands, each imported when it is called; an error or interrupt is one line."""

from __future__ import annotations

import importlib.metadata
import inspect
import logging
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Any, cast, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import Interrupted, UserError, lines_of

UsageError = cast(type[typer.BadParameter], typer.BadParameter.__mro__[1])
"""The error of typer for wrong arguments of any kind, which has no public name."""
HELP = ("--help", "-h")
KINDS = {"str": "text", "int": "integer", "int range": "integer", "float": "number", "float range": "number",
         "list[str]": "text", "list[Path]": "path"}  # fmt: skip
"""Names of the kinds of values in help texts."""


class LateCommand(TyperCommand):
    """A command that is imported when it is called, since the list of commands needs only summaries."""

    def __init__(self, name: str, module: str, summary: str) -> None:
        """module: its full name; its function ``command`` is the command."""
        super().__init__(name, short_help=summary)
        self.module = module

    def made(self) -> Any:
        """The command itself, with the options that extensions add to it."""
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        with extensions.blaming(f"command {self.name} ({self.module})", self.module):
            module = importlib.import_module(self.module)
            kind = getattr(module, "EXTENDED_BY", "")
            app.command(self.name)(extended(module.command, kind) if kind else module.command)
            made = typer.main.get_command(app)
        for item in made.params:
            if display := getattr(item, "display_type", None):  # typers for Python 3.10 have none, and need none
                item.display_type = partial(_kind, display)  # type: ignore[attr-defined]
        return made

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        made = self.made()
        if not {*HELP}.isdisjoint(args):
            from hybrid_sysid_ros.rigs.rig import default

            for option in made.params:
                if option.name == "rig" and not option.required and not option.callback:
                    option.default = default()
        return made.make_context(info_name, args, parent=parent, **extra)


def _kind(display: Callable[[Any], str], ctx: Any) -> str:
    """The kind of an option's value, in a word that is no Python."""
    kind = display(ctx).strip("<>")
    return f"<{KINDS.get(kind, kind)}>"


def extended(function: Callable[..., None], kind: str) -> Callable[..., None]:
    """A command with the options that extensions add to it.

    kind: the kind of functions that extensions provide for it, and the name of the argument that receives their
    results. Their arguments are further options, or options of the command with the same names; an option that two
    functions declare is one option. Results that are None are left out.
    """
    makers = list(extensions.provided(kind).values())
    own = {name: item for name, item in arguments_of(function).items() if name != kind}
    options = dict(own)
    for make in makers:
        options |= {name: item for name, item in arguments_of(make).items() if name not in options}

    def command(**given: Any) -> None:
        made = [make(**{name: given[name] for name in arguments_of(make)}) for make in makers]
        function(**{name: given[name] for name in own}, **{kind: [item for item in made if item is not None]})

    command.__doc__ = function.__doc__
    command.__annotations__ = {name: item.annotation for name, item in options.items()}
    command.__signature__ = inspect.Signature(list(options.values()))  # type: ignore[attr-defined]
    return command


def arguments_of(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """The arguments of a function by name, with their types, as keyword arguments."""
    hints = get_type_hints(function, include_extras=True)
    return {
        name: item.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY)
        for name, item in inspect.signature(function).parameters.items()
    }


class Commands(TyperGroup):
    """All commands. An interrupt becomes Interrupted, since typer ends without a message at KeyboardInterrupt."""

    def __init__(self, name: str, commands: Sequence[TyperCommand | TyperGroup], **settings: Any) -> None:
        super().__init__(name=name, commands=commands, no_args_is_help=True, rich_markup_mode=None, **settings)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name. Raises UserError for one of an extension of ours that is missing."""
        found = super().get_command(ctx, cmd_name)
        words = " ".join([*ctx.command_path.split()[1:], cmd_name])
        if found is None and (why := extensions.missing(words)):
            raise UserError(f"command {words}: {why}")
        return found

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise Interrupted from error


def _usage(error: typer.BadParameter) -> str:
    """The error of wrong arguments in one line; the help where there are none."""
    message, context = error.format_message(), error.ctx
    if context is not None and message == context.get_help():
        return message
    option = str(getattr(error, "option_name", ""))
    if why := extensions.missing(option):
        return f"error: option {option}: {why}"
    line = " ".join(message.split()).rstrip(".").replace("Value error, ", "")  # as pydantic begins it
    return f"error: {line[0].lower()}{line[1:]}{f': see {context.command_path} --help' if context else ''}"


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"hybrid-sysid {importlib.metadata.version('hybrid_sysid_ros')}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Options of the program itself; typer adds those that install completion for bash, zsh and fish."""


def run_program(make: Callable[[], Commands]) -> None:
    """Make a program and run its command. Exit with 2 and one line for an error of the user, and with 130 and one line
    for an interrupt.
    """
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    reported = None
    try:
        reported = _tell_problems(0)
        program = make()
        sys.exit(program(prog_name=program.name, standalone_mode=False))
    except UsageError as error:
        sys.stderr.write(_usage(error) + "\n")
        sys.exit(2)
    except UserError as error:
        sys.stderr.writelines(f"error: {' '.join(line.split())}\n" for line in lines_of(error))
        sys.exit(2)
    except BrokenPipeError:
        from hybrid_sysid_ros.commands.terminal import reader_gone  # which imports what a list of commands needs not

        reader_gone()
    except OSError as error:  # such as a full disk behind standard output
        sys.stderr.write(f"error: {error.filename or 'standard output'}: {error.strerror or error}\n")
        sys.exit(2)
    except (Interrupted, KeyboardInterrupt) as error:
        sys.stderr.write(": ".join(filter(None, ("interrupted", str(error)))) + "\n")
        sys.exit(130)
    finally:
        _ = reported is None or _tell_problems(reported)  # an interrupt may come before any problem is found


def _tell_problems(reported: int) -> int:
    """Print which extensions are left out, after the first ``reported`` ones; return the number of all."""
    problems = extensions.registry().problems
    for line in problems[reported:]:
        sys.stderr.write(f"warning: {UserError(line)}\n")
    return len(problems)


GROUPS = {
    "export": "Whole loops outside of Python.",
    "model": "Models outside of Python.",
    "policy": "Approximate MPC.",
    "rig": "Rigs, a folder each.",
}
"""First words of commands with two words, and their subjects."""


def program() -> Commands:
    """All commands, the trunk's first, then those of the extensions."""
    single, groups = list[LateCommand](), {name: list[LateCommand]() for name in GROUPS}
    for words, (module, summary) in extensions.commands().items():
        group, _, name = words.rpartition(" ")
        place = groups.setdefault(group, []) if group else single
        place.append(LateCommand(name, module, summary))
    made = [Commands(name, commands, help=GROUPS.get(name, "")) for name, commands in groups.items()]
    options = typer.main.get_command(typer.Typer(callback=_root)).params
    return Commands("hybrid-sysid", [*single, *made], params=options, context_settings={"help_option_names": HELP})


def main() -> None:
    """Run a command of the command line."""
    run_program(program)
