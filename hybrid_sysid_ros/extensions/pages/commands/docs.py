"""hybrid-sysid docs: the pages of the documentation, without a network."""

from __future__ import annotations

from importlib.metadata import files
from pathlib import Path
from typing import Annotated

import typer
from rich.markdown import Markdown

from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.support import errors, extensions
from hybrid_sysid_ros.support.errors import UserError

CHECKOUT = Path(extensions.__file__).parents[2]
FIRST = "docs/concepts.md"
"""A page that tells where the others are, in a checkout and where a wheel was installed."""

APART = ("results", "tried")
"""Folders whose pages have names of others."""


def pages() -> dict[str, Path]:
    """The pages by their names. Raises UserError where none were installed."""
    folder = CHECKOUT
    if not (folder / FIRST).exists():
        installed = [Path(str(item.locate())) for item in files("hybrid_sysid_ros") or () if str(item).endswith(FIRST)]
        if not installed:
            raise UserError("no pages were installed with the package: read docs/ in its sources")
        folder = installed[0].resolve().parents[1]
    found = [*(folder / "docs").rglob("*.md"), *folder.glob("hybrid_sysid_ros/extensions/*/docs/**/*.md")]
    return {
        f"{path.parent.name}/{path.stem}" if path.parent.name in APART else path.stem: path for path in sorted(found)
    }


def command(
    page: Annotated[
        str, typer.Argument(metavar="PAGE", help="Name of the page; without it all are listed.", autocompletion=pages)
    ] = "",
) -> None:
    """Read a page of the documentation in the terminal, or list the pages with the files that hold them."""
    found = pages()
    if not page:
        for name, path in found.items():
            with path.open(encoding="utf-8") as lines:
                title = next(lines).strip("# \n")
            console.print(f"{name:<28}{title:<44}{path}")
        return
    page = page.removesuffix(".md")
    page = page if page in found else page.rsplit("/", 1)[-1]  # as pages name one another
    if page not in found:
        raise UserError(f"no page {page}: {errors.known(page, found)}")
    text = Markdown(found[page].read_text(encoding="utf-8"))
    if not console.is_terminal:
        print(found[page].read_text(encoding="utf-8"), end="")
        return
    with console.pager(styles=True):
        console.print(text, soft_wrap=False)
