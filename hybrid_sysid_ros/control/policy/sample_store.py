"""Samples on disk, so that an interrupted training goes on where it was."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file

from hybrid_sysid_ros.control.policy.sampling import Samples
from hybrid_sysid_ros.models.storage import save_arrays
from hybrid_sysid_ros.support.files import written_file


class SampleStore:
    """Finished closed loops of one training, one file each.

    purpose: everything that the samples depend on, as text; loops of another purpose are not found again.
    """

    def __init__(self, folder: Path, purpose: str) -> None:
        self.folder = folder
        self._key = hashlib.sha256(purpose.encode()).hexdigest()[:16]

    def find(self, seed: int) -> Samples | None:
        """The loop of a seed, None where it is not there or was not written whole."""
        path = self._path(seed)
        if not path.is_file():
            return None
        try:
            arrays = load_file(path)
            dropped = int(arrays.pop("dropped")[0])
            return Samples(**arrays, dropped=dropped)
        except (SafetensorError, OSError, KeyError, TypeError):
            return None

    def keep(self, seed: int, samples: Samples) -> None:
        """Write a finished loop."""
        arrays = {name: np.atleast_1d(np.asarray(getattr(samples, name))) for name in samples.__dataclass_fields__}
        with written_file(self._path(seed)) as partial:
            save_arrays(partial, arrays)

    def remove(self) -> None:
        """Remove the folder: the training is finished."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, seed: int) -> Path:
        return self.folder / f"{self._key}-{seed}.safetensors"
