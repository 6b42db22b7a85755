"""The chain rule, printed: derivatives go on through a step by products in which no zero of its Jacobian has a part.

The rows of derivatives are padded, so that vector registers are full, and stay where they are from step to step.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from hybrid_sysid_ros.core.compilation import inner

LANES = 4
"""Numbers in a register."""

_STEP = """@inner
def derive(x, u, p, w, h, s, out, by):
    own, total = scratch(ROWS * COLUMNS), scratch(ROWS * WIDTH)
    step(x, u, p, w, h, s, out, own)
    for j in range(0, WIDTH, LANES):
        PRODUCTS
    for i in range(ROWS * WIDTH):
        by[i] = total[i]
"""

_THROUGH = """@compiled(JACOBIAN)
def function(x, u, p, w, h, s, out, by):
    derive(x, u, p, w, h, s, out, by)
"""

_FROM_HERE = """@compiled(JACOBIAN)
def function(x, u, p, w, h, s, out, jacobian):
    by = scratch(SEEDS * WIDTH)
    for i in range(SEEDS * WIDTH):
        by[i] = 0.0
    for i in range(SEEDS):
        by[i * WIDTH + i] = 1.0
    derive(x, u, p, w, h, s, out, by)
    for i in range(ROWS):
        for j in range(COLUMNS):
            jacobian[i * COLUMNS + j] = by[i * WIDTH + j]
"""


@inner
def padded(columns: int) -> int:
    """The length of a row of derivatives by so many columns."""
    return (columns + LANES - 1) // LANES * LANES


@dataclass(frozen=True, kw_only=True)
class Slopes:
    """A printed function's Jacobian (rows, columns)."""

    rows: int
    columns: int
    seeds: int
    """How many of its columns, states first, are multiplied by derivatives of what they stand for; others are added."""
    filled: Collection[tuple[int, int]]
    """Rows and columns of what is not zero."""

    def products(self, own: str, by: str, use: Callable[[str], str]) -> str:
        """Lines of a loop over registers of columns, from j on: ``c`` is each row of ``own`` (rows, columns) times
        ``by`` (seeds, padded columns), and is used at the place that ``use`` is given.
        """
        width, read = padded(self.columns), sorted({column for _, column in self.filled if column < self.seeds})
        lines = [f"b{column} = load_numbers({by}, {column * width} + j, LANES)" for column in read]
        for row in range(self.rows):
            lines.append("c = zero(LANES)")
            lines += [
                f"c = plus_scaled(c, b{column}, {own}[{row * self.columns + column}])"
                for column in read
                if (row, column) in self.filled
            ]
            lines += use(f"{row * width} + j").splitlines()
        return ("\n" + 8 * " ").join(lines)

    def sized(self, source: str) -> str:
        """A source with these sizes."""
        sizes = {"ROWS": self.rows, "COLUMNS": self.columns, "SEEDS": self.seeds, "LANES": LANES}
        sizes["WIDTH"] = padded(self.columns)
        for name, size in sizes.items():
            source = source.replace(name, str(size))
        return source

    def around_step(self) -> str:
        """Source of ``derive(x, u, p, w, h, s, out, by)``, which calls ``step(x, u, p, w, h, s, out, own)``."""
        return self.sized(_STEP.replace("PRODUCTS", self.products("own", "by", "store(total, {}, c)".format)))

    def around(self, through: bool) -> str:
        """Source of the ``function`` that calls ``derive``: through: on the derivatives of [x; u] that it is given."""
        return self.sized(_THROUGH if through else _FROM_HERE)
