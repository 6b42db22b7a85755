"""The import of a record of ten minutes."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

SECONDS, RATE = 600.0, 1000.0


def measured() -> dict[str, Any]:
    """Seconds from the start of the command to its end, for a CSV of ten minutes at 1 kHz."""
    with TemporaryDirectory() as folder:
        times = np.arange(round(SECONDS * RATE)) / RATE
        table = np.column_stack([times, 5.0 * np.sin(times), 0.1 * np.sin(times)])
        file = Path(folder) / "log.csv"
        np.savetxt(file, table, delimiter=",", header="time,drive,position", comments="", fmt="%.6f")
        command = [sys.executable, "-m", "hybrid_sysid_ros", "import", str(file)]
        command += ["--rig", "cam_beam", "--out", f"{folder}/bags"]
        begun = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return {"seconds": time.perf_counter() - begun, "samples": len(times)}
