"""Hybrids with networks and fuzzy rules on rates and on closures, against the same written by hand in numpy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.distance import mahalanobis

from hybrid_sysid_ros.core import RungeKutta, Sensitivities, System, bounded, rollouts, simulate
from hybrid_sysid_ros.core.mathematics import sin
from hybrid_sysid_ros.core.symbolic import symbolic_rates
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.fitting import fit
from hybrid_sysid_ros.identification.initial_values import initialised
from hybrid_sysid_ros.models import Sampling, build
from hybrid_sysid_ros.models.hybrid_system import Hybrid, averaged_hybrid, block_kinds
from hybrid_sysid_ros.models.region import FADED, Region
from hybrid_sysid_ros.models.structure import assemble
from hybrid_sysid_ros.support.errors import UserError

STEP = 0.02
KINDS = {
    kind: sizes
    for kind, sizes in {
        "network": {"units": 4},
        "affine rules": {"affine_rules": 3},
        "linked rules": {"linked_rules": 6},
    }.items()
    if set(sizes) <= set(block_kinds())
}
with_rules = pytest.mark.skipif("affine rules" not in KINDS, reason="rules are of the extension fuzzy")


@dataclass(frozen=True, kw_only=True)
class Swing(System):
    """q'' = (-p(q) - d(q) q' + u) / J: pull and damping are what a hybrid may correct."""

    states = ("angle [rad]", "rate [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("angle", "rate")
    features = ("height [1]", "angle")
    closures = ("pull [N m]", "damping [N m s/rad]")
    stepper = RungeKutta()

    inertia: float = bounded(0.5, 0.3, 0.8, unit="kg m^2")
    weight: float = bounded(2.0, 1.0, 4.0, unit="N m")

    def law(self, x, u):
        pull, damping = self.closure(x, u)
        return x[1], (u[0] - pull - damping * x[1]) / self.inertia

    def feature(self, x, u):
        return 1.0 - sin(x[0]), x[0]

    def closure(self, x, u):
        return self.weight * sin(x[0]), 0.2


@dataclass(frozen=True, kw_only=True)
class Stiffening(Swing):
    """What the model of it does not know: a pull that grows with the cube, and a damping with the square."""

    def closure(self, x, u):
        return self.weight * sin(x[0]) + 0.4 * x[0] ** 3, 0.2 + 0.1 * x[0] ** 2


def record(system: System, seed: int) -> PreparedRecord:
    random = np.random.default_rng(seed)
    inputs = np.repeat(random.uniform(-2.5, 2.5, 60), 25)[:, None]
    states = simulate(system, np.zeros(2), inputs, step=STEP)
    sampling = Sampling(step=STEP, period=STEP)
    return PreparedRecord(name="swung", sampling=sampling, inputs=inputs, outputs=states, states=states)


def started(kind: str) -> Hybrid:
    """In its training data, and without a word yet."""
    system, _ = build("hybrid", Swing(), scales=np.array([1.0, 2.0, 2.0]), seed=0, options=KINDS[kind])
    assert isinstance(system, Hybrid)
    return initialised(system, [record(Stiffening(), 0)], seed=0)


def spoken(kind: str) -> Hybrid:
    """With numbers that matter."""
    hybrid = started(kind)
    return hybrid.with_weights(hybrid.weights + np.random.default_rng(1).normal(scale=0.5, size=len(hybrid.weights)))


def learned(hybrid: Hybrid, z: np.ndarray) -> np.ndarray:
    """What a block says of scaled features, as it is written in the literature."""
    w, n, k = hybrid.weights, len(z), len(hybrid.on)
    sizes = {key: value for key, value in hybrid.design.items() if key not in ("on", "physics")}
    if rules := sizes.get("affine_rules"):
        premises = w[: 2 * rules * n].reshape(rules, 2, n)
        near = 1.0 / np.sum(((z - premises[:, 0]) / np.exp(premises[:, 1])) ** 2, axis=1)
        consequents = w[2 * rules * n :].reshape(k, rules, n + 1)
        return np.asarray((consequents[:, :, 0] + consequents[:, :, 1:] @ z) @ near / near.sum())
    if rules := sizes.get("linked_rules"):
        terms = w.reshape(n + k, 2, rules)
        fired = np.exp(-np.sum(((z[:, None] - terms[:n, 0]) / np.exp(terms[:n, 1])) ** 2, axis=0))
        areas = fired * np.exp(terms[n:, 1])
        return np.sum(areas * terms[n:, 0], axis=1) / areas.sum(axis=1)
    rows = w.reshape(sizes["units"], n + 1 + k)
    s = rows[:, :n] @ z + rows[:, n]
    return (s / (1.0 + np.abs(s))) @ rows[:, n + 1 :]


@pytest.mark.parametrize("kind", KINDS)
def test_within_its_training_data_a_hybrid_adds_to_the_closures_what_it_learned(kind):
    hybrid = spoken(kind)
    seen, sizes = np.array(hybrid.scales[:2]), np.array(hybrid.scales[2:])
    for q, v, u in ([0.3, -0.5, 1.0], [-0.6, 0.2, -2.0]):
        pull, damping = np.array([2.0 * np.sin(q), 0.2]) + sizes * learned(
            hybrid, np.array([1.0 - np.sin(q), q]) / seen
        )
        rates = np.array(symbolic_rates(hybrid)([q, v], u)[0]).ravel()
        np.testing.assert_allclose(rates, [v, (u - pull - damping * v) / 0.5], rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_far_from_its_training_data_a_hybrid_is_its_physics(kind):
    hybrid = spoken(kind)
    for point in ([6.0, 1.0], [-9.0, 0.0]):
        rates, plain = (np.array(symbolic_rates(s)(point, 0.5)[0]) for s in (hybrid, hybrid.physics))
        np.testing.assert_array_equal(rates, plain)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("start", [0.2, 2.5], ids=["within", "fading"])
def test_slopes_are_those_of_differences(kind, start):
    hybrid = spoken(kind)
    assert hybrid.region is not None
    share = float(hybrid.region.share([(1.0 - np.sin(start)) / hybrid.scales[0], start / hybrid.scales[1]]))
    assert share == 1.0 if start < 1.0 else 0.02 < share < 0.98
    starts, first, inputs = np.array([[0, 0, 5, 0]]), np.array([[start, 0.4]]), np.full((4, 1), 0.7)
    reported = Sensitivities(hybrid)
    jacobian = np.empty((5, 2, reported.count))
    reported.rollouts(hybrid, starts, first, inputs, step=STEP, every=1, out=jacobian)
    weights, columns = hybrid.weights, jacobian[:, :, 2 : 2 + len(hybrid.weights)]
    for column, nudge in zip(np.moveaxis(columns, 2, 0), 1e-5 * np.eye(len(weights)), strict=True):
        after, before = (
            rollouts(hybrid.with_weights(weights + way), starts, first, inputs, step=STEP)[1] for way in (nudge, -nudge)
        )
        np.testing.assert_allclose(column, (after - before) / 2e-5, atol=1e-8)


def test_a_region_counts_in_distances_of_mahalanobis_from_its_farthest_sample():
    random = np.random.default_rng(0)
    points = random.normal(size=(400, 3)) @ random.normal(size=(3, 3)) + [1.0, -2.0, 0.5]
    mean, inverse = points.mean(axis=0), np.linalg.inv(np.cov(points.T))
    far = max(points, key=lambda point: mahalanobis(point, mean, inverse))
    region = Region.of(points)
    assert min(float(region.share(point)) for point in points) > 1.0 - 1e-9
    for distance, share in ((0.9, 1.0), (FADED, 0.0), (5.0, 0.0)):
        assert float(region.share(mean + distance * (far - mean))) == pytest.approx(share, abs=1e-9)
    middle = np.sqrt(0.5 * (1.0 + FADED**2))  # halfway in the square of the distance
    assert float(region.share(mean + middle * (far - mean))) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_a_hybrid_is_made_again_from_its_design(kind):
    hybrid = spoken(kind)
    again = assemble("hybrid", Swing(), design=hybrid.design, weights=hybrid.weights).with_values(hybrid.values)
    np.testing.assert_array_equal(again.values, hybrid.values)
    point = [0.4, -0.3], 0.2
    np.testing.assert_array_equal(
        np.array(symbolic_rates(again)(*point)[0]), np.array(symbolic_rates(hybrid)(*point)[0])
    )


@pytest.mark.parametrize("kind", KINDS)
def test_it_learns_what_the_physics_lacks_and_leaves_the_physics_alone(kind):
    """Free run of another record, in parts of the error of the physics."""
    hybrid, other = started(kind), record(Stiffening(), 1)
    names = [item.name for item in hybrid.physics.parameters]
    found = fit(hybrid, [record(Stiffening(), 0)], stages=(20, 100), hold=names, ridge=0.1, tolerance=1e-5).system
    assert isinstance(found, Hybrid)
    np.testing.assert_array_equal(found.physics.values, Swing().values)
    errors = [
        np.std(simulate(system, np.zeros(2), other.inputs, step=STEP) - other.outputs) for system in (found, Swing())
    ]
    assert errors[0] < 0.2 * errors[1]


@with_rules
def test_rules_stand_in_place_of_a_network_on_rates_too():
    options = {"affine_rules": 2, "everywhere": 1}
    system, _ = build("hybrid", Swing(), scales=np.array([1.0, 2.0, 2.0]), seed=0, options=options)
    assert isinstance(system, Hybrid)
    assert (system.on, system.region) == (("rate",), None)
    system = initialised(system, [record(Stiffening(), 0)], seed=0)
    random = np.random.default_rng(2)
    system = system.with_weights(random.normal(size=len(system.weights)))
    z = np.clip(np.array([1.0 - np.sin(0.2), 0.2]) / system.scales[:2], -1.5, 1.5)
    more = system.scales[2] * learned(system, z)[0]
    rates, plain = (np.array(symbolic_rates(item)([0.2, 0.1], 0.3)[0]).ravel() for item in (system, Swing()))
    np.testing.assert_allclose(rates - plain, [0.0, more], rtol=1e-9)


@with_rules
def test_what_cannot_be_is_refused():
    with pytest.raises(UserError, match="a hybrid has either"):
        build("hybrid", Swing(), scales=np.ones(3), seed=0, options={"affine_rules": 2, "linked_rules": 2})
    rules = spoken("affine rules")
    with pytest.raises(UserError, match="only networks can be averaged"):
        averaged_hybrid([rules, rules])
    with pytest.raises(UserError, match="its network is on lift, which is no closure"):
        replace(rules, on=("pull", "lift"))
    with pytest.raises(UserError, match="angle is a state and a closure"):

        class Twice(System):
            states = ("angle [rad]",)
            closures = ("angle [rad]",)
