"""What a node has read may change under it: it goes on, and says so."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from diagnostic_msgs.msg import DiagnosticStatus

from hybrid_sysid_ros.nodes.base import ModelSource
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from tests.node_bench import Bench


def test_a_folder_is_the_same_until_a_file_in_it_is_another_one(tmp_path: Path) -> None:
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "model.yaml").write_text("gain: 1")
    source = ModelSource(folder)
    assert source.changed() == ""
    (tmp_path / "new").write_text("gain: 1")
    (tmp_path / "new").replace(folder / "model.yaml")
    assert f"{folder} has changed" in source.changed()
    folder.rename(tmp_path / "old")
    assert f"{folder} is gone" in source.changed()
    (tmp_path / "old").rename(folder)
    assert "has changed" in source.changed()  # of the text that was read nothing is left


@pytest.mark.parametrize("kind", [EstimatorNode, ControllerNode])
def test_a_node_says_that_its_model_is_gone(bench: Bench, tmp_path: Path, model_folder: Path, kind: type) -> None:
    folder = tmp_path / "model"
    shutil.copytree(model_folder, folder)
    more = {"policy": "exact"} if kind is ControllerNode else {}
    node = bench.start(kind, model=str(folder), **more)
    node.look_at_sources()
    assert next(task for task in node.tasks() if task.name == "model").level == DiagnosticStatus.OK
    shutil.rmtree(folder)
    node.look_at_sources()
    reported = next(task for task in node.tasks() if task.name == "model")
    assert reported.level == DiagnosticStatus.WARN
    assert str(folder) in reported.message
