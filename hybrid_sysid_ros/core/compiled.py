"""A system compiled: the addresses of its printed functions, made when they are asked for and kept on disk."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from functools import cached_property
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.core.compilation import CACHE
from hybrid_sysid_ros.core.printing import Columns, columns_of, slopes_source, value_source
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.support.errors import UserError


class Compiled:
    """The compiled functions of a form of system, by address; values of parameters and weights are arguments.

    step, output: functions of the signature :data:`~.call.VALUE`. The others are of :data:`~.call.SLOPES`.
    """

    def __init__(self, system: System) -> None:
        self._system = system

    @cached_property
    def step(self) -> int:
        """One step."""
        return _address(value_source(self._system))

    @cached_property
    def output(self) -> int:
        """The output map."""
        return _address(value_source(self._system, output=True))

    def slopes(self, *, output: bool = False, smooth: bool = False, learn: bool = False) -> tuple[int, Columns]:
        """A step or the output map with slopes by states and inputs, for fits also by parameters and weights; smooth:
        stick-slip is rounded.
        """
        key = (output, smooth, learn)
        if key not in self._slopes:
            columns = columns_of(self._system, learn=learn)
            address = _address(slopes_source(self._system, columns, output=output, smooth=smooth))
            self._slopes[key] = address, columns
        return self._slopes[key]

    @cached_property
    def _slopes(self) -> dict[tuple[bool, bool, bool], tuple[int, Columns]]:
        return {}


_COMPILED: dict[Any, Compiled] = {}


def compiled(system: System) -> Compiled:
    """The compiled functions of a system's form, one set in a process."""
    if system.form not in _COMPILED:
        _COMPILED[system.form] = Compiled(system)
    return _COMPILED[system.form]


_LOADED: dict[str, Any] = {}


def _address(source: str) -> int:
    """Address of the function of a printed module."""
    name = "printed_" + hashlib.sha256(source.encode()).hexdigest()[:24]
    if name not in _LOADED:
        path = _kept(name, source)
        specification = importlib.util.spec_from_file_location(name, path)
        assert specification is not None
        assert specification.loader is not None
        module = importlib.util.module_from_spec(specification)
        sys.modules[name] = module
        specification.loader.exec_module(module)
        _LOADED[name] = module
    return int(_LOADED[name].function.address)


def _kept(name: str, source: str) -> Path:
    """The file of a printed module. One that is there is not written again: compiled code goes by its time."""
    for folder in (CACHE / "systems", Path(tempfile.gettempdir()) / f"hybrid_sysid_ros_{os.getuid()}" / CACHE.name):
        path = folder / f"{name}.py"
        try:
            if path.is_file() and path.read_text(encoding="utf-8") == source:
                return path
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            handle, partial = tempfile.mkstemp(dir=folder, suffix=".partial")
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(source)
            os.replace(partial, path)
            return path
        except OSError:
            continue
    raise UserError(f"{CACHE}: compiled code can't be kept there; set HYBRID_SYSID_CACHE to another folder")
