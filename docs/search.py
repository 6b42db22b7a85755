"""Order of the search results of the built site, a hook of mkdocs: pages to read stand before lists of names."""

from __future__ import annotations

from typing import Any

WEIGHTS = {"reference": 0.001, "results": 0.1, "examples": 0.1, "extensions": 0.5, "rigs": 0.5}
"""Of folders. The reference has so little because the title of a class is a word or two, which weigh much."""


def on_page_markdown(markdown: str, page: Any, **_: Any) -> None:
    """Weigh a page by its folders."""
    found = [WEIGHTS[name] for name in page.file.src_uri.split("/")[:-1] if name in WEIGHTS]
    page.meta.setdefault("search", {"boost": min(found, default=1.0)})
