"""Types of arrays, for annotations."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Of numbers."""
Records: TypeAlias = NDArray[np.void]
"""Of records with named fields."""
