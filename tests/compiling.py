"""What is compiled so far."""

import sys
from collections import Counter

from numba.core.dispatcher import Dispatcher


def compiled_functions() -> Counter[str]:
    """How many specialisations there are of each of the package's functions that Python calls, in this process."""
    found: Counter[str] = Counter()
    for name, module in list(sys.modules.items()):
        if name.startswith("hybrid_sysid_ros"):
            for item in vars(module).values():
                if isinstance(item, Dispatcher) and item.py_func.__module__ == name:
                    found[f"{name}.{item.py_func.__name__}"] = len(item.signatures)
    return found


def twice(x: float) -> float:
    """What is soon compiled."""
    return 2.0 * x
