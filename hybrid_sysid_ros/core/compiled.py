"""A compiled system: the addresses of its printed functions, which are compiled at first use and cached on disk."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from functools import cached_property
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

from hybrid_sysid_ros.core.compilation import folder, kept_in
from hybrid_sysid_ros.core.printing import JacobianColumns, jacobian_columns, source_of
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.support.errors import warn


class Compiled:
    """Addresses of the compiled functions of a system's form; values of parameters and weights are their arguments.

    step and output have the signature :data:`~.call.VALUE`, the others :data:`~.call.JACOBIAN`.
    """

    def __init__(self, system: System) -> None:
        self._system = system
        self._jacobians: dict[tuple[bool, ...], tuple[int, JacobianColumns]] = {}

    @cached_property
    def step(self) -> int:
        """Address of one step."""
        return self._address(source_of(self._system))

    @cached_property
    def smooth_step(self) -> int:
        """Address of one step where the corners of stick-slip are rounded."""
        return self._address(source_of(self._system, smooth=True))

    @cached_property
    def output(self) -> int:
        """Address of the output map."""
        return self._address(source_of(self._system, output=True))

    def jacobian(
        self, *, output: bool = False, smooth: bool = False, learn: bool = False, through: bool = False
    ) -> tuple[int, JacobianColumns]:
        """Address of the step or the output map with its Jacobian by states and inputs, and the Jacobian's columns.

        learn: also by parameters and weights, for fits. smooth: the corners of stick-slip are rounded. through: a step
        is given derivatives of [x; u] by anything, by default with as many columns, padded
        (:func:`~.chain_rule.padded`), and replaces those of x by those of its end.
        """
        key = (output, smooth, learn, through)
        if key not in self._jacobians:
            columns = jacobian_columns(self._system, learn=learn)
            source = source_of(self._system, columns, output=output, smooth=smooth, through=through)
            self._jacobians[key] = self._address(source), columns
        return self._jacobians[key]

    def _address(self, source: str) -> int:
        """Address of the function of a printed module."""
        version = hashlib.sha256(source.encode()).hexdigest()[:24]
        name = f"printed_{version}"
        if name not in sys.modules:
            path = _kept(folder(type(self._system).__name__, version), source)
            loader = _SourceLoader(name, str(path))
            specification = importlib.util.spec_from_loader(name, loader)
            assert specification is not None
            module = importlib.util.module_from_spec(specification)
            sys.modules[name] = module  # cached code looks up its module by name
            try:
                with kept_in(path.parent):
                    loader.exec_module(module)
            except BaseException:
                del sys.modules[name]  # Ctrl-C must not leave half of a module
                raise
        return int(sys.modules[name].function.address)


_COMPILED: dict[Any, Compiled] = {}


def compiled(system: System) -> Compiled:
    """The compiled functions of a system's form, one set for each process."""
    form = system.form
    if form not in _COMPILED:
        _COMPILED[form] = Compiled(system)
    return _COMPILED[form]


class _SourceLoader(SourceFileLoader):
    """Keeps no bytecode beside the source, which would need a checksum, too."""

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


def _kept(place: Path, source: str) -> Path:
    """The file of a printed module. Every process gives it the same time, on which cached code depends."""
    path = place / "printed.py"
    if path.exists():
        if path.read_bytes() == source.encode():
            return path
        warn(f"{path} is damaged: it is printed again")
    handle, partial = tempfile.mkstemp(dir=place, suffix=".partial")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(source)
    os.utime(partial, (0, 0))
    os.replace(partial, path)
    return path
