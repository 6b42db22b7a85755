"""Where no bags are, as where a wheel was installed, a demo simulates them, and they are the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.extensions.shared import demo_recipe
from hybrid_sysid_ros.extensions.shared.demo_recipe import SHIPPED_BAGS, DemoRecipe
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.folder import names


@pytest.fixture
def nothing_shipped(monkeypatch, tmp_path):
    monkeypatch.setattr(demo_recipe, "SHIPPED_BAGS", tmp_path / "nowhere")


@pytest.mark.parametrize("rig", sorted(name for name, package in names().items() if package == "hybrid_sysid_ros"))
def test_every_rig_of_the_package_has_a_demo_without_bags(rig, nothing_shipped, tmp_path):
    described = rigs.load(rig)
    recipe = DemoRecipe.of(described)
    learnt, kept = recipe.places(described, tmp_path)
    assert [path.name for path in (*learnt, *kept)] == [*recipe.learn, *recipe.test]
    for item in recipe.simulate.values():
        assert item.kind in described.experiments.excitations


def test_a_simulated_bag_is_that_of_the_package(nothing_shipped, tmp_path):
    rig = rigs.load("wheel_motor")
    recipe = replace(DemoRecipe.of(rig), learn=("wheel_motor_multisine",), test=())
    (made,) = recipe.records(rig, tmp_path).training
    shipped = bags.read(SHIPPED_BAGS / made.name, rig.signals)
    np.testing.assert_array_equal(made.time, shipped.time)
    np.testing.assert_allclose(made.input, shipped.input, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(made.output, shipped.output, rtol=0.0, atol=1e-9)
