"""Every parameter is declared once for all rigs, a rig has values, and what is wrong is reported by file and key."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hybrid_sysid_ros.core import RungeKutta, System
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.rigs.folder import names
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime import configuration, parameters
from hybrid_sysid_ros.runtime.configuration import NodeParameter
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.yaml_text import Dumper, parsed

NODES = tuple(parameters.declarations())


def of_residual(physics: System) -> System:
    """A model of one step and many parameters; without its extension the test is skipped."""
    system: System = pytest.importorskip("hybrid_sysid_ros.extensions.narx.tests.systems").residual(physics)
    return system


@pytest.fixture
def limited(rig: Rig) -> Rig:
    """The beam with a slow drive, and valid at low speeds only."""
    actuator = dataclasses.replace(rig.actuators[0], rate=40.0)
    validity = np.array([[-math.inf, -0.5], [math.inf, 0.5]])
    return dataclasses.replace(rig, actuators=(actuator,), validity=validity)


def test_limits_of_a_rig_are_those_of_its_mpc(limited: Rig) -> None:
    values = configuration.defaults("cam_beam", "controller")
    problem = configuration.mpc_problem(values | {"limits": "rig"}, limited)
    end = limited.travel[1, 0]
    assert (problem.state_low, problem.state_high) == ((-end, -0.5), (end, 0.5))
    assert problem.rate_limits == (40.0 * values["period"],)
    scale = limited.display[0].scale
    assert problem.soft_quadratic[0] >= 100.0 * values["output_weight"][0] / scale**2
    own = configuration.mpc_problem(values | {"limits": "own"}, limited)
    assert own == configuration.mpc_problem(values, limited)  # as the policy of the beam was trained
    assert (own.rate_limits, own.state_high) == ((math.inf,), (math.inf, math.inf))


def test_the_section_mpc_of_a_file_adds_terms_and_riccati_s_cost(rig: Rig) -> None:
    values = configuration.defaults("cam_beam", "controller")

    def with_section(**given: object) -> Rig:
        return dataclasses.replace(rig, content={**rig.content, "mpc": given})

    problem = configuration.mpc_problem(values, with_section(terms={"calm": {"value": "velocity", "weight": 2.0}}))
    assert [term.name for term in problem.terms] == ["calm"]
    plain = configuration.mpc_problem(values, rig)
    floors = [configuration.noise_cost(rig, item.sized(rig.system)) for item in (problem, plain)]
    assert floors[0] == floors[1]
    ended = configuration.mpc_problem(values, with_section(riccati_at=0.01))
    assert ended.terms
    assert all(term.final and term.name.startswith("riccati") for term in ended.terms)
    for wrong, said in (({"riccati": 0.01}, "unknown key 'riccati'"), ({"riccati_at": "here"}, "mpc: riccati_at")):
        with pytest.raises(UserError, match=said) as refused:
            configuration.mpc_problem(values, with_section(**wrong))
        assert str(rig.file) in str(refused.value)


def test_own_limits_come_before_those_of_the_rig(limited: Rig) -> None:
    values = configuration.defaults("cam_beam", "controller") | {"limits": "rig"}
    values |= {"state_high": [0.1, 1e9], "input_rate": [10.0]}
    problem = configuration.mpc_problem(values, limited)
    assert problem.state_high == (0.1, 0.5)
    assert problem.rate_limits == (10.0 * values["period"],)
    guard = configuration.guard_settings(values, limited, limited.system)
    assert guard.rate.tolist() == [10.0]  # whatever law drives
    assert guard.state_high.tolist() == [limited.travel[1, 0], 0.5]


def test_a_stated_resume_rate_holds_from_wherever_the_rig_is(rig: Rig) -> None:
    """Otherwise a rig beyond its set-points has been driven there, and comes back from the nearest one."""
    values = configuration.defaults("cam_beam", "controller")
    for rate, is_free in ((0.0, False), (30.0, True)):
        settings = configuration.guard_settings(values | {"resume_rate": [rate]}, rig, rig.system)
        assert np.isnan(settings.reach).all() == is_free
    assert settings.resume_rate == pytest.approx(30.0 * rig.display[0].scale)


def test_references_stay_within_travel_and_validity(limited: Rig) -> None:
    narrow = dataclasses.replace(limited, validity=np.array([[-0.1, -math.inf], [0.2, math.inf]]))
    assert narrow.reach[:, 0].tolist() == pytest.approx([-0.1 + 0.02 * 0.3, 0.2 - 0.02 * 0.3])


def test_a_parameter_of_another_name_says_so(rig: Rig) -> None:
    _, problems = parameters.settings(rig, "controller", {"rate_limit": [2.0]})
    assert problems == ["controller: unknown parameter rate_limit: " + parameters.RENAMED["rate_limit"]]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Write declarations of nodes."""
    path = tmp_path / "nodes.yaml"
    monkeypatch.setattr(parameters, "DECLARATIONS", path)
    parameters.read_declarations.cache_clear()

    def written(content: dict[str, Any]) -> Path:
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return path

    yield written
    parameters.read_declarations.cache_clear()


def test_parameters_are_followed_by_a_pattern_of_their_names(rig: Rig) -> None:
    values, model = configuration.defaults("cam_beam", "estimator"), of_residual(rig.system)
    found = configuration.estimator_tuning(values | {"followed": "reflection_*=0.01"}, rig, model).followed
    assert found == {"reflection_1_position": 0.01, "reflection_2_position": 0.01}
    scales = configuration.estimator_tuning(values | {"followed": "scale_*=0.01"}, rig, model)
    with pytest.raises(UserError, match=r"no parameter scale_\*"):
        scales.checked(model)


def test_a_state_that_a_disturbance_moves_stays_within_its_reach() -> None:
    rig = load("drill_string")
    tuning = configuration.estimator_tuning(configuration.defaults(rig.name, "estimator"), rig)
    assert tuning.initial_deviation == (1.5, 0.5, 0.5, 3.0)
    assert tuning.state_limit == (math.inf, math.inf, math.inf, rig.disturbances[3].numbers["amplitude"])


def test_a_model_that_holds_at_one_step_is_predicted_by_its_own(rig: Rig) -> None:
    values = configuration.defaults("cam_beam", "controller") | {"period": 0.02, "substeps": 3}
    assert configuration.mpc_problem(values, rig).substeps == 3
    model = of_residual(rig.system)  # of 5 ms
    assert configuration.mpc_problem(values, rig, model).substeps == 4
    with pytest.raises(UserError, match=r"ResidualHybrid steps by 0\.005 s, the problem by 0\.006 s"):
        configuration.mpc_problem(values | {"period": 0.006}, rig, model)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Thickening(System):
    """A joint in a medium that damps the more the further it is from the middle."""

    states = ("position [rad]", "velocity [rad/s]")
    inputs = ("voltage [V]",)
    outputs = ("position",)
    stepper = RungeKutta()
    far: float = 0.0

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0] - 10.0 * x[0] - (5.0 + self.far * x[0] ** 2) * x[1]


def test_a_prediction_takes_steps_in_which_modes_decay_that_are_fast_only_far_off(rig: Rig) -> None:
    """A step h multiplies a mode of damping d by 1 - a + a^2/2 - a^3/6 + a^4/24, a = h d: at most 1 up to a = 2.785."""
    values = configuration.defaults("cam_beam", "controller") | {"period": 0.02, "substeps": 3}
    furthest = max(item.scale * item.high for item in set_point_ranges(rig))
    for damping, steps in ((100.0, 3), (2000.0, math.ceil(0.02 * 2000.0 / 2.785))):
        system = Thickening(far=(damping - 5.0) / furthest**2)
        assert configuration.mpc_problem(values, rig, system).substeps == steps
    for damping in (2e4, 1e6):
        with pytest.raises(
            UserError, match=r"about position = -0\.18\d* .* too fast for 100 steps in an interval of 0\.02 s"
        ):
            configuration.mpc_problem(values, rig, Thickening(far=damping / furthest**2))


def test_a_prediction_takes_steps_in_which_its_fastest_mode_decays() -> None:
    """The engine's poles are w (-z +- i sqrt(1 - z^2)), and a step multiplies a mode by 1 + a + a^2/2 + a^3/6 + a^4/24
    of a = pole h.
    """
    rig = load("winged_cone")
    values = configuration.defaults(rig.name, "controller")
    named = rig.system.named
    w, z = named["engine_rate"], named["engine_damping"]
    problem = configuration.mpc_problem(values, rig, configuration.controller_model(rig, rig.system))
    stable = [
        abs(np.polyval([1 / 24, 1 / 6, 1 / 2, 1, 1], w * complex(-z, np.sqrt(1 - z**2)) * problem.period / count)) < 1.0
        for count in (problem.substeps - 1, problem.substeps)
    ]
    assert values["substeps"] < problem.substeps
    assert stable == [False, True]


@pytest.mark.parametrize("node", NODES)
def test_every_parameter_is_described_and_its_default_allowed(node: str) -> None:
    for name, parameter in configuration.parameters("cam_beam", node).items():
        assert parameter.description, name
        assert parameter.checked(parameter.default) == parameter.default
        assert not parameter.each or len(parameter.default) == parameter.count, name
        assert parameter.kind not in (int, float) or math.isfinite(parameter.low + parameter.high), name


def test_what_two_nodes_share_has_one_default() -> None:
    plant, estimator, controller = (configuration.defaults("cam_beam", node) for node in NODES[:3])
    assert plant["rate"] == estimator["rate"]
    assert estimator["latency"] == controller["latency"]
    assert estimator["model"] == controller["model"]


def test_the_preview_reaches_beyond_the_horizon(rig: Rig) -> None:
    reference, controller = (configuration.defaults("cam_beam", node) for node in ("reference", "controller"))
    needed = controller["horizon"] * controller["period"] + controller["latency"] + rig.system.delay
    assert reference["preview_seconds"] >= needed + reference["publish_period"]


def test_the_library_gets_the_numbers_of_the_nodes_in_si_units(rig: Rig) -> None:
    values = configuration.defaults("cam_beam", "estimator")
    tuning = configuration.estimator_tuning(values, rig)
    assert tuning.measurement_noise == pytest.approx([values["measurement_noise"][0] * math.radians(1.3)])
    problem = configuration.mpc_problem(configuration.defaults("cam_beam", "controller"), rig)
    assert (problem.input_low, problem.input_high) == ((-10.0,), (10.0,))
    assert problem.output_scales == pytest.approx([math.radians(1.3)])


@pytest.mark.parametrize(
    ("parameter", "value", "message"),
    [
        (
            NodeParameter(name="rate", default=200.0, description="", unit="Hz", low=1.0, high=1e3),
            5e3,
            "5000.0 Hz: it must",
        ),
        (
            NodeParameter(name="rate", default=200.0, description="", low=1.0, high=1e3),
            math.nan,
            "nan: it must be within",
        ),
        (NodeParameter(name="rate", default=200.0, description=""), "fast", "'fast': it needs a number"),
        (NodeParameter(name="rate", default=200.0, description=""), True, "True: it needs a number"),
        (NodeParameter(name="seed", default=0, description="", low=0, high=9), 1.0, "1.0: it needs a whole number"),
        (NodeParameter(name="seed", default=0, description="", low=0, high=9), -1, "-1: it must be within [0, 9]"),
        (NodeParameter(name="lockstep", default=False, description=""), 1, "1: it needs true or false"),
        (NodeParameter(name="policy", default="a", description="", choices=("a", "b")), "c", "choose one of a, b"),
        (NodeParameter(name="model", default="", description=""), None, "None: it needs text"),
    ],
)
def test_a_value_that_is_not_allowed_is_reported(parameter: NodeParameter, value: Any, message: str) -> None:
    with pytest.raises(UserError) as reported:
        parameter.checked(value)
    assert message in str(reported.value)
    assert parameter.name in str(reported.value)


def test_a_whole_number_does_for_a_number() -> None:
    value = NodeParameter(name="rate", default=200.0, description="").checked(100)
    assert (value, type(value)) == (100.0, float)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (3.0, "nodes.plant: rate needs keys"),
        ({"description": "", "range": [1.0, 2.0]}, "nodes.plant.rate: default is missing"),
        ({"default": 1.5, "description": "", "range": [2.0, 1.0, 0.0]}, "nodes.plant.rate.range"),
        ({"default": 1.5, "description": "", "colour": "red"}, "nodes.plant.rate: unknown key 'colour'"),
        ({"default": 3.0, "description": "", "range": [1.0, 2.0]}, "nodes.plant.rate: parameter rate is 3.0"),
        ({"default": [1], "description": ""}, "nodes.plant.rate: parameter rate: the default [1]"),
    ],
)
def test_a_wrong_description_is_reported_by_file_and_key(rig: Rig, write: Any, entry: Any, message: str) -> None:
    path = write({"nodes": {"plant": {"rate": entry}}})
    with pytest.raises(UserError) as reported:
        configuration.parameters(dataclasses.replace(rig, content={}), "plant")
    assert str(reported.value).startswith(f"{path}: {message}")


def test_a_missing_section_is_reported(write: Any) -> None:
    write({"nodes": {"plant": {}}})
    with pytest.raises(UserError, match=r"no section nodes\.estimator: known are plant"):
        configuration.parameters("cam_beam", "estimator")


def test_an_unknown_rig_is_reported() -> None:
    with pytest.raises(UserError, match="no rig 'crane'"):
        configuration.defaults("crane", "plant")
    with pytest.raises(UserError, match="no model comes with the package for the rig crane"):
        configuration.shipped("crane", "model")


@pytest.mark.parametrize("content", [1e9, 1.0e-9, "1e9", "1.0E+9", "12e", 3, None])
def test_numbers_and_text_are_read_as_they_were_written(content: Any) -> None:
    assert parsed(yaml.dump({"a": content}, Dumper=Dumper)) == {"a": content}


def test_a_number_needs_no_sign_in_its_exponent() -> None:
    assert parsed("[1e9, 1.0e9, -.5E-3]") == [1e9, 1e9, -0.5e-3]


@pytest.mark.parametrize("name", names())
def test_every_number_of_every_node_has_a_range(name: str) -> None:
    for node in parameters.declarations():
        for item in configuration.parameters(name, node).values():
            if item.each or type(item.default) in (int, float):
                assert -math.inf < item.low < item.high < math.inf, (node, item.name)
                assert all(low <= high for low, high in item.ranges), (node, item.name)


def test_the_range_of_a_parameter_is_that_of_each_input_and_output_of_the_rig() -> None:
    """A constant on the vehicle's elevator that its throttle would take is refused; a default is within the range."""
    bias = parameters.parameters("winged_cone", "plant")["bias"]
    assert bias.checked([1.8, 0.3]) == [1.8, 0.3]
    for wrong in ([1.9, 0.0], [0.0, 0.4], 0.4):
        with pytest.raises(UserError, match="parameter bias is"):
            bias.checked(wrong)
    assert "[-0.356011, 0.356011]" in bias.within
    beam = parameters.parameters("cam_beam", "reference")["amplitude"]
    assert beam.within == "[-10, 10]"  # V of the sensor
    for rig in names():
        for node in NODES:
            for name, item in parameters.parameters(rig, node).items():
                assert item.kind in (str, bool) or item.choices or math.isfinite(item.high - item.low), name


def test_a_velocity_can_be_braked_and_a_position_not() -> None:
    brake = parameters.parameters("cam_beam", "plant")["brake"]
    assert brake.checked([0.0, 5.0]) == [0.0, 5.0]
    with pytest.raises(UserError, match="parameter brake is"):
        brake.checked([5.0, 0.0])
