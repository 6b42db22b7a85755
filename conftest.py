"""Where the Python that runs the tests lacks what only pip has, as that of colcon may, the one in front runs them. And
what all tests share.
"""

from __future__ import annotations

import gc
import importlib.util
import os
from typing import Any

from hybrid_sysid_ros.nodes.executable import SECOND_TRY, start_again

collect_ignore = ["hybrid_sysid_ros/extensions/driver/template"]  # its test runs beside the files of a rig


def pytest_addoption(parser: Any, pluginmanager: Any) -> None:
    """Start again, before what the tests share is imported, which needs it all."""
    if importlib.util.find_spec("casadi") is None:
        capture = pluginmanager.getplugin("capturemanager")
        if capture is not None:  # it holds the standard output
            capture.suspend_global_capture(in_=True)
        start_again("pytest")
    os.environ.pop(SECOND_TRY, None)  # not for what the tests start


def pytest_configure(config: Any) -> None:
    """Give what tests share to those of the extensions, too, which stand in their own folders."""
    config.pluginmanager.import_plugin("tests.shared")


def pytest_collection_finish() -> None:
    """Leave what was imported to no garbage collector, which took a fifth of the time, and call it more seldom."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
