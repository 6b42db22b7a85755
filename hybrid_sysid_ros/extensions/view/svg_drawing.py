"""A rig's drawing as SVG, for reports and for the pages of the documentation."""

from __future__ import annotations

from collections.abc import Iterator

from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.rigs.rig import Rig

STYLE = ".still { fill: #b9c1ca } .body { fill: #1f6fb2 } .mark { stroke: #fff; stroke-width: .012 }"
MARGIN = 0.02  # m


def svg_of(rig: Rig) -> str:
    """The bodies of a rig where its joints are at zero, "" where its file draws none."""
    if not rig.content.get("drawing"):
        return ""
    drawing = Drawing(rig)
    left, low, right, high = drawing.extent()
    box = f"{left - MARGIN:.4g} {-high - MARGIN:.4g} {right - left + 2 * MARGIN:.4g} {high - low + 2 * MARGIN:.4g}"
    parts = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" role="img">',
        f"<title>Drawing of {rig.name}</title><style>{STYLE}</style>",
        '<g transform="scale(1 -1)">',
        *bodies(drawing),
        "</g></svg>",
    )
    return "\n".join(parts)


def bodies(drawing: Drawing) -> Iterator[str]:
    """The bodies as SVG, y upwards, each a group of class ``body`` or ``still`` and ``joint-NAME``."""
    origins = {"": (0.0, 0.0)}
    for name, body in drawing.bodies.items():
        x, y = origins[name] = tuple(a + b for a, b in zip(origins[body.on], body.at, strict=True))  # type: ignore[assignment]
        kind = "body" if body.joint else "still"
        yield f'<g transform="translate({x} {y})"><g class="{kind} joint-{body.joint}">'
        for shape in body.shapes:
            x, y = shape.at
            if shape.box:
                width, height = shape.box
                yield f'<rect x="{x - width / 2:.4g}" y="{y - height / 2:.4g}" width="{width}" height="{height}"/>'
            else:
                yield f'<circle cx="{x}" cy="{y}" r="{shape.disc}"/>'
                if body.joint:
                    yield f'<path class="mark" d="M{x} {y}V{y + 0.8 * shape.disc:.4g}"/>'
        yield "</g></g>"
