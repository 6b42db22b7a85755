"""The plots of the notebooks' pages: the site has their library once, and no page asks another server."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import plotly.offline

LIBRARY = "plotly.js"
OWN = re.compile(r"<script>/\*\*\n\* plotly\.js v.*?</script>", re.S)
FOREIGN = re.compile(r'<script src="(https://[^"]*)?"> ?</script>')


def on_startup(**_: Any) -> None:
    """Let the notebooks draw their plots as HTML: what a notebook's own page shows is nothing on another page."""
    os.environ["PLOTLY_RENDERER"] = "notebook"


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Replace the library in a page by a link to it, and drop what another server has (formulas in plots)."""
    depth = page.url.count("/")
    return FOREIGN.sub("", OWN.sub(lambda _: f'<script src="{"../" * depth}{LIBRARY}"></script>', output))


def on_post_build(config: Any, **_: Any) -> None:
    """Write the library into the site."""
    Path(config.site_dir, LIBRARY).write_text(plotly.offline.get_plotlyjs(), encoding="utf-8")
