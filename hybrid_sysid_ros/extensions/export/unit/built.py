"""A unit that is built on this machine, and called from Python."""

from __future__ import annotations

import ctypes
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.extensions.export.compiler import compile_source
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-pedantic")
FLAGS = ("-std=c99", "-O2", "-fno-asynchronous-unwind-tables")
"""The last: nothing unwinds a stack of C, and its tables take 8 kB."""
COLD = ("api", "daqp_prox")
"""Files of DAQP that a loop runs once, or never."""


class PeriodAnswer(NamedTuple):
    """A period's answer."""

    status: int
    inputs: Array
    """(m,)."""
    state: Array
    """(n,)."""
    ahead: Array
    """(n,)."""
    disturbance: Array
    """(m,)."""
    judged: Array
    """(2,): the level that the guard allows, and its cause."""


def renamed(name: str) -> list[str]:
    """Flags by which the solver's allocations are the unit's own, out of its memory."""
    return [f"-Dmalloc={name}_allocate", f"-Dcalloc={name}_allocate_zeros", f"-Dfree={name}_release"]


def build(compiler: str, folder: Path, name: str, into: Path, *, flags: tuple[str, ...] = ()) -> Path:
    """Build the shared library of a unit whose files are in ``folder``; return its path.

    Raises UserError where the compiler refuses a file, or finds anything to warn of in NAME.c.
    """
    common = [compiler, *FLAGS, *flags, "-fPIC", "-I", str(folder), "-c"]
    own, solver = folder / f"{name}.c", sorted((folder / "daqp").glob("*.c"))
    objects = [into / "unit.o", *(into / f"daqp_{path.stem}.o" for path in solver)]
    sized = [("-Os",) if path.stem in COLD else () for path in solver]
    kinds = [(*WARNINGS, "-Werror"), *(("-w", *size, *renamed(name)) for size in sized)]

    def compiled(source: Path, kind: tuple[str, ...], target: Path) -> None:
        compile_source([*common, *kind, str(source), "-o", str(target)], source.name)

    with ThreadPoolExecutor() as pool:  # on all cores
        list(pool.map(compiled, (own, *solver), kinds, objects))
    library = into / f"lib{name}.so"
    compile_source([compiler, *flags, "-shared", *map(str, objects), "-o", str(library), "-lm"], f"{name}.c")
    return library


class BuiltUnit:
    """Calls a unit's library."""

    def __init__(
        self, library: Path, name: str, *, states: int, inputs: int, outputs: int, horizon: int, single: bool = False
    ) -> None:
        """single: its numbers are floats."""
        number = ctypes.c_float if single else ctypes.c_double
        self._number: Any = number

        class Measurement(ctypes.Structure):
            _fields_ = (("time", ctypes.c_double), ("outputs", number * outputs), ("applied", number * inputs))

        class Command(ctypes.Structure):
            _fields_ = (
                ("inputs", number * inputs),
                ("status", ctypes.c_int),
                ("state", number * states),
                ("ahead", number * states),
                ("disturbance", number * inputs),
                ("judged", ctypes.c_int * 2),
            )

        self._measurement, self._command = Measurement(), Command()
        self._preview = np.zeros(horizon * outputs, np.float32 if single else np.float64)
        loaded = ctypes.CDLL(str(library))
        self._step, self._reset = getattr(loaded, f"{name}_step"), getattr(loaded, f"{name}_reset")
        self._sent = getattr(loaded, f"{name}_sent")
        self._prepare = getattr(loaded, f"{name}_prepare")
        self._prepare.argtypes = (ctypes.c_void_p, number)
        size = getattr(loaded, f"{name}_size")
        size.restype = ctypes.c_size_t
        self.bytes: int = size()
        """Bytes of its memory."""
        self._memory = (ctypes.c_double * (self.bytes // 8 + 1))()
        if not getattr(loaded, f"{name}_init")(ctypes.byref(self._memory)):
            raise UserError(f"{name}.c: the memory of its solver is too small; report this")
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._reset(ctypes.byref(self._memory))

    def step(self, time: float, outputs: Array, applied: Array, preview: Array) -> PeriodAnswer:
        """A period: outputs (p,), applied inputs (m,), preview (N, p)."""
        self._measurement.time = time
        self._measurement.outputs[:], self._measurement.applied[:] = outputs.tolist(), applied.tolist()
        with np.errstate(over="ignore"):  # no float is 1e300
            self._preview[:] = np.ravel(preview)
        given: Any = self._preview.ctypes.data
        self._step(
            ctypes.byref(self._memory),
            ctypes.byref(self._measurement),
            ctypes.c_void_p(given),
            ctypes.byref(self._command),
        )
        found = self._command
        return PeriodAnswer(found.status, *(np.array(getattr(found, name)) for name in PeriodAnswer._fields[1:]))

    def sent(self, inputs: Array) -> None:
        """Say which inputs the rig got (m,)."""
        given = (self._number * len(inputs))(*inputs.tolist())
        self._sent(ctypes.byref(self._memory), ctypes.byref(given))

    def prepare(self, elapsed: float) -> None:
        """Prepare for the next period."""
        self._prepare(ctypes.byref(self._memory), elapsed)
