"""FMPy: the headers of FMI, and what it finds in an FMU that was written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import numpy as np

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

HEADERS = ("fmi3PlatformTypes.h", "fmi3FunctionTypes.h", "fmi3Functions.h")


def fmpy() -> ModuleType:
    """The package. Raises UserError where it is missing."""
    try:
        import fmpy as found
        import fmpy.fmi3
        import fmpy.validation
    except ImportError as error:
        raise UserError(
            f"export: an FMU is checked by FMPy, which is missing ({error}): pip install 'hybrid_sysid_ros[fmu]'"
        ) from error
    module: ModuleType = found
    return module


def headers() -> dict[str, str]:
    """The headers of FMI 3.0 (2-Clause BSD, stated at the head of each) by their file names."""
    folder = Path(str(fmpy().__file__)).parent / "c-code"
    try:
        return {name: (folder / name).read_text(encoding="utf-8") for name in HEADERS}
    except OSError as error:
        raise UserError(f"export: this FMPy has no header of FMI 3.0 ({error}); install another edition") from error


def validate(path: Path) -> None:
    """Raise UserError for what FMPy finds wrong in an FMU's files."""
    if problems := fmpy().validation.validate_fmu(str(path)):
        raise UserError(f"export: FMPy finds in the FMU: {'; '.join(problems)}; nothing is written: report this")


class RunningFmu:
    """An FMU that FMPy has loaded, from its first moment on."""

    def __init__(self, path: Path) -> None:
        self._module = fmpy()
        self._folder = TemporaryDirectory()
        self.messages: list[str] = []
        """What it has logged."""
        self._module.extract(str(path), self._folder.name)
        self.description: Any = self._module.read_model_description(self._folder.name)
        self.references = {item.name: item.valueReference for item in self.description.modelVariables}
        self.fmu: Any = self._module.fmi3.FMU3Slave(
            guid=self.description.instantiationToken,
            unzipDirectory=self._folder.name,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="checked",
        )
        self.fmu.instantiate(logMessage=self._tell)

    def __enter__(self) -> RunningFmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.fmu.freeInstance()
        self._folder.cleanup()

    def _tell(self, environment: Any, status: int, category: bytes, message: bytes) -> None:
        self.messages.append(message.decode())

    def start(self, at: float = 0.0) -> None:
        """Leave the initialization."""
        self.fmu.enterInitializationMode(startTime=at)
        self.fmu.exitInitializationMode()

    def set(self, names: Sequence[str], values: Sequence[float] | Array) -> None:
        """Set numbers; of an array all its elements."""
        self.fmu.setFloat64([self.references[name] for name in names], np.ravel(values).tolist())

    def get(self, names: Sequence[str], *, count: int | None = None) -> Array:
        """Numbers."""
        return np.array(self.fmu.getFloat64([self.references[name] for name in names], nValues=count))
