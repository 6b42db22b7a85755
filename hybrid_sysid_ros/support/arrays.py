"""Types of arrays, for annotations, and where arrays begin."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Of numbers."""
Records: TypeAlias = NDArray[np.void]
"""Of records with named fields."""
Floats: TypeAlias = list[float] | Array
"""Numbers for kernels that Python runs on lists, and that are printed as C for arrays."""
NamedArrays: TypeAlias = dict[str, NDArray[Any]]
"""Of any numbers, by name."""
Numbers: TypeAlias = tuple[float, ...]
"""A number for each of some variables."""

LINE = 64
"""Bytes of a line of the processor's cache, and of its widest register."""


def aligned(values: Array) -> Array:
    """A copy of numbers that begins with a line of the cache: a register across two lines takes twice as long.

    It is not a view of a longer array, whose rest would be printed with it as C.
    """
    memory = np.empty(values.size + LINE // 8)
    begin = -memory.ctypes.data % LINE // 8
    found = np.asarray(memory.data[begin : begin + values.size]).reshape(values.shape)
    found[...] = values
    return found
