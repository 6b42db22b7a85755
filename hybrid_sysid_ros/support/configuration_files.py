"""Configuration files: one YAML file for each rig, with a section for each reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from hybrid_sysid_ros.support.errors import UserError

CONFIGURATIONS = Path(__file__).parents[1] / "msgs_config"


def configuration_of(rig: str) -> Path:
    """Path of the configuration of a rig.

    Raises:
        UserError: there is none; the message names those that exist.
    """
    path = CONFIGURATIONS / f"{rig}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in CONFIGURATIONS.glob("*.yaml"))) or "none"
        raise UserError(f"no configuration for a rig {rig!r}: known are {known}")
    return path


def load_configuration(path: Path | str) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises:
        UserError: no such file, not readable, no YAML or no mapping.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is no text file, so no YAML") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        raise UserError(
            f"{path}: is no valid YAML{where} ({getattr(error, 'problem', None) or 'unreadable'})"
        ) from error
    if not isinstance(content, dict):
        raise UserError(f"{path}: holds no keys: it needs sections such as 'signals:'")
    return content
