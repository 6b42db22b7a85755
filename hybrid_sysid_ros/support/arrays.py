"""Types of arrays, for annotations."""

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
