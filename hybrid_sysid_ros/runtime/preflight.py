"""Preflight: all that is wrong with a loop, found before any of its nodes is started."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.companion import NodeValues
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.runtime.parameters import declarations, settings
from hybrid_sysid_ros.runtime.references import signal_of
from hybrid_sysid_ros.runtime.rig_values import TOLERANCE, needed_preview, rounded_up
from hybrid_sysid_ros.support.errors import UserErrors, collected


def check(rig: Rig, given: NodeValues) -> None:
    """Raise UserErrors, a line for each problem of the loop with these parameters of the nodes that are to run. What
    they name is read as the nodes will read it, and compiled where it never was.
    """
    loop, problems = settings_of(rig, given)
    problems += _of_nodes(rig, given, loop)
    if problems and not rig.content.get("nodes"):
        problems = [f"{rig.file}: {needed_of(problems)}"]
    if problems:
        raise UserErrors(problems)


def needed_of(problems: Sequence[str]) -> str:
    """What a rig without values of nodes lacks for a loop, of which these are the problems."""
    return f"no section nodes: a rig for identification alone; a loop would need: {problems[0]}"


def of_rig(rig: Rig) -> list[str]:
    """What is wrong with the values of a rig's nodes and with what they make of its own system, a line each."""
    loop, problems = settings_of(rig, {node: {} for node in declarations()})
    if loop.keys() < declarations().keys():
        return problems
    controller = loop["controller"]
    period = 1.0 / loop["plant"]["rate"]

    made: tuple[tuple[str, Callable[[], object]], ...] = (
        ("nodes.plant.rate", lambda: rig.steps(period, "its period")),
        ("nodes.controller.period", lambda: rig.steps(controller["period"], "it")),
        (
            "nodes.controller",
            lambda: configuration.mpc_problem(controller, rig, configuration.controller_model(rig, rig.system)),
        ),
        ("nodes.estimator", lambda: configuration.estimator_tuning(loop["estimator"], rig)),
    )
    problems += _disagreements(rig, {}, loop, controller["horizon"] * controller["period"])
    for key, make in made:
        with collected_in_file(problems, rig, key):
            make()
    return problems


@contextmanager
def collected_in_file(problems: list[str], rig: Rig, key: str) -> Iterator[None]:
    """Add what is wrong with a part of the rig's file to the problems, with its place where it does not say that."""
    with collected(found := list[str]()):
        yield
    problems += (line if line.startswith(str(rig.file)) else f"{rig.file}: {key}: {line}" for line in found)


def settings_of(rig: Rig, given: NodeValues) -> tuple[NodeValues, list[str]]:
    """All values of the nodes whose parameters are given, but of those that have wrong ones, and what is wrong."""
    loop, problems = NodeValues(), list[str]()
    for node, values in given.items():
        found, lines = settings(rig, node, values)
        problems += lines
        if found is not None:
            loop[node] = found
    return loop, list(dict.fromkeys(problems))


def _disagreements(rig: Rig, given: NodeValues, loop: NodeValues, horizon: float) -> Iterator[str]:
    """Values of one node that do not go with those of another. horizon: of the controller [s]."""

    def at(node: str, name: str) -> str:
        place = f"{node}: parameter {name}" if name in given.get(node, {}) else f"{rig.file}: nodes.{node}.{name}"
        return f"{place} is {loop[node][name]:g}"

    controller, estimator = loop["controller"], loop["estimator"]
    if estimator["latency"] != controller["latency"]:
        yield f"{at('estimator', 'latency')} s: the controller's is {controller['latency']:g} s; both need the same"
    if "plant" in loop and estimator["rate"] != loop["plant"]["rate"]:
        yield f"{at('estimator', 'rate')} Hz: the plant's is {loop['plant']['rate']:g} Hz; both need the same"
    if "reference" not in loop:
        return
    reference = loop["reference"]
    needed = needed_preview(rig, controller, reference, horizon)
    if reference["preview_seconds"] < needed * (1.0 - TOLERANCE):
        yield (
            f"{at('reference', 'preview_seconds')} s: the controller's horizon, the delays and a publish period take "
            f"{needed:g} s; write preview_seconds: {rounded_up(needed):g} for the node reference"
        )
    count = reference["publish_period"] / reference["point_spacing"]
    if abs(count - round(count)) > TOLERANCE * count:
        yield (
            f"{at('reference', 'publish_period')} s: it must be a multiple of point_spacing, "
            f"{reference['point_spacing']:g} s"
        )


def _of_nodes(rig: Rig, given: NodeValues, loop: NodeValues) -> list[str]:
    """Why the nodes would not start, or not go together."""
    problems, models = list[str](), dict[str, Model]()
    if "plant" in loop:
        with collected(problems):
            rig.steps(1.0 / loop["plant"]["rate"], f"plant: parameter rate is {loop['plant']['rate']:g} Hz: its period")
    if "reference" in loop:
        with collected(problems, "reference: "):
            signal_of(loop["reference"]["kind"] or rig.reference, loop["reference"], rig)
    if not loop.keys() >= {"estimator", "controller"}:
        return problems
    estimator, controller = loop["estimator"], loop["controller"]
    for name in {estimator["model"], controller["model"]}:
        with collected(problems):
            model = load_model(name or configuration.shipped(rig.name, "model"), rig=rig.source)
            models[name] = configuration.estimator_model(rig, model)
    if estimator["model"] in models:
        with collected(problems, "estimator: "):
            configuration.estimator_tuning(estimator, rig, models[estimator["model"]].system)
    horizon = controller["horizon"] * controller["period"]
    if controller["model"] in models:
        with collected(problems, "controller: "):
            made = controller_of(rig, models[controller["model"]], controller).controller
            horizon = made.horizon * made.period  # a network has its own
    elif (folder := controller["policy_path"]) and controller["policy"] != "exact":
        with collected(problems, "controller: "):
            policy.load(folder)
    return [*problems, *_disagreements(rig, given, loop, horizon)]
