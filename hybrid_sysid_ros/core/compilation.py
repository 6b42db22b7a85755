"""How functions are compiled: those that Python calls, and the inner ones that only compiled code calls.

By itself numba compiles with every function an entry for Python and one for C, each longer than a short function.
Without those that nobody uses, compiling takes a quarter less memory and a tenth less time in a node.
"""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable

OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
"""For ``numba.njit`` of a function that Python calls; no C code calls one."""

inner = register_jitable(**OPTIONS)
"""Decorator of a function that only compiled code calls. Called from Python it runs as it is written there."""
