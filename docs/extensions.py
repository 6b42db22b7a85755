"""Pages of extensions in the built site, a hook of mkdocs: texts, places in the navigation, and links."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
DOCS, EXTENSIONS = "docs", "hybrid_sysid_ros/extensions"
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")


def _pages(folder: Path) -> Iterator[tuple[str, Path]]:
    """Pages of an extension by their addresses in the site: its guides, then its results."""
    found = sorted((folder / DOCS).rglob("*.md"), key=lambda path: (len(path.parts), path.name))
    yield from ((f"extensions/{folder.name}/{path.relative_to(folder / DOCS).as_posix()}", path) for path in found)


def _extensions() -> dict[str, dict[str, Path]]:
    folders = sorted(path.parent for path in (ROOT / EXTENSIONS).glob("*/docs"))
    return {folder.name: dict(_pages(folder)) for folder in folders}


def _title(page: Path) -> str:
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def on_config(config: Any) -> Any:
    """Put the pages of the extensions that are there where mkdocs.yml names their folders, or at the end."""
    group = next(entry["Extensions"] for entry in config.nav if "Extensions" in entry)
    found = {
        name: [{_title(path): address} for address, path in pages.items()] for name, pages in _extensions().items()
    }
    for entry in [entry for entry in group if isinstance(next(iter(entry.values())), list)]:
        ((title, names),) = entry.items()
        entry[title] = [page for name in names for page in found.pop(name, [])]
        if not entry[title]:
            group.remove(entry)
    group.extend({name: pages} for name, pages in found.items())
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add these pages, and their pictures, to those of docs/."""
    for name, pages in _extensions().items():
        for address, path in pages.items():
            files.append(File.generated(config, address, content=path.read_text(encoding="utf-8")))
        folder = ROOT / EXTENSIONS / name / DOCS
        for path in sorted((*folder.rglob("*.svg"), *folder.rglob("*.png"))):
            address = _address(path.relative_to(ROOT).as_posix())
            files.append(File.generated(config, address, abs_src_path=str(path)))
    return files


def _source(address: str) -> str:
    """Where a page of the site stands in the repository."""
    _, name, *rest = [*address.split("/"), "", ""]
    if address.startswith("extensions/"):
        return f"{EXTENSIONS}/{name}/{DOCS}/{'/'.join(part for part in rest if part)}"
    return f"{DOCS}/{address}"


def _address(source: str) -> str:
    """Where a file of the repository stands in the site."""
    name, _, rest = source.removeprefix(f"{EXTENSIONS}/").partition(f"/{DOCS}/")
    return f"extensions/{name}/{rest}" if source.startswith(EXTENSIONS) else source.removeprefix(f"{DOCS}/")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead links between docs/ and the folders of extensions to the pages of the site; what is away is text."""
    here = _source(page.file.src_uri)

    def changed(link: re.Match[str]) -> str:
        image, text, target, anchor = link[1], link[2], link[3], link[4] or ""
        source = posixpath.normpath(posixpath.join(posixpath.dirname(here), target))
        if EXTENSIONS not in (here[: len(EXTENSIONS)], source[: len(EXTENSIONS)]):
            return link[0]
        if not (ROOT / source).exists():
            return text
        way = posixpath.relpath(_address(source), posixpath.dirname(page.file.src_uri) or ".")
        return f"{image}[{text}]({way}{anchor})"

    return LINK.sub(changed, markdown)
