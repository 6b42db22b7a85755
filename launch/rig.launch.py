"""Launch a rig: ros2 launch hybrid_sysid_ros rig.launch.py [rig:=NAME_OR_PATH] [namespace:=NAME] [bag:=FOLDER] ..."""

from collections.abc import Mapping
from typing import Any

from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_context import LaunchContext
from launch.logging import get_logger
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from hybrid_sysid_ros.commands.app import arguments_of
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.companion import Companion, RequestedLoop, join
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.support import errors, extensions
from launch import LaunchDescription, LaunchDescriptionEntity

PACKAGE = "hybrid_sysid_ros"
OF_THE_LOOP = ("reference", "estimator", "controller", "plant")
"""Those that may be composed."""
TRUTHS = ("true", "false")
# Name: default, choices, description.
ARGUMENTS = {
    "rig": ("", (), "the rig, by its name or by the path of its folder"),
    "namespace": ("", (), "of nodes and topics, for one of several rigs"),
    "params_file": ("", (), "ROS parameter file of the nodes, as `hybrid-sysid parameters` writes it"),
    "rate": ("", (), "measurements per second [Hz]; empty: the rig's"),
    "policy": (
        "supervised",
        ("supervised", "network", "exact"),
        "what drives: the network, checked or alone, or the MPC",
    ),
    "policy_path": ("", (), "folder of the network; empty: the shipped one"),
    "solver": ("sqp", ("sqp", "ipopt"), "of the exact MPC; ipopt is the slow reference"),
    "model": ("", (), "folder of the model; empty: the shipped one"),
    "reference": ("", (), "one of the rig's references, constant, steps, sine or multisine; empty: the rig's first"),
    "simulated": (
        "true",
        TRUTHS,
        "false: the rig is real: its driver has joint_states and joint_command, and the loop waits for the service arm",
    ),
    "lockstep": ("false", TRUTHS, "true: as fast as the nodes answer, in simulated time, the same in every run"),
    "composed": ("false", TRUTHS, "true: all but the recorder in one process and one loop"),
    "respawn": ("false", TRUTHS, "true: a node that dies is started again; false: the launch ends with it"),
    "autostart": ("true", TRUTHS, "false: a manager configures and activates the nodes"),
    "bag": ("", (), "folder of a bag to record; empty: none"),
}
OPTIONS = {
    name: item for make in extensions.provided("companions").values() for name, item in arguments_of(make).items()
}
"""Arguments of what extensions add to a loop, as `hybrid-sysid run` has them."""
for name, item in OPTIONS.items():
    default = str(item.default).lower() if isinstance(item.default, bool) else str(item.default or "")
    description = next(
        (str(one.help) for one in getattr(item.annotation, "__metadata__", ()) if hasattr(one, "help")), ""
    )
    ARGUMENTS[name] = (default, TRUTHS if isinstance(item.default, bool) else (), description)


def companions(given: Mapping[str, str]) -> list[Companion]:
    """Those that are asked for."""
    values: dict[str, Any] = {}
    for name, item in OPTIONS.items():
        kind = type(item.default)
        values[name] = given[name] == "true" if kind is bool else kind(given[name]) if kind is int else given[name]
    makers = extensions.provided("companions").values()
    made = [make(**{name: values[name] for name in arguments_of(make)}) for make in makers]
    return [companion for companion in made if companion is not None]


def parameters(given: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Of the nodes that are asked for, by node and name: plant (unless the rig is real), estimator, controller,
    reference, and what is asked for beside them.
    """
    asked = {name: given[name] for name, (default, *_) in ARGUMENTS.items() if given[name] != default}
    lock = {"lockstep": True} if "lockstep" in asked else {}
    latency = {"latency": 0.0} if lock else {}
    rate = {"rate": float(asked["rate"])} if "rate" in asked else {}
    model = {name: asked[name] for name in ("model",) if name in asked}
    driven = {name: asked[name] for name in ("policy", "policy_path", "solver") if name in asked}
    readers = 3 if given["bag"] else 2  # of joint_states: estimator, reference and recorder, whom the rig waits for
    values: dict[str, dict[str, Any]] = {
        "reference": {**({"kind": asked["reference"]} if "reference" in asked else {}), **lock},
        "estimator": {**model, **rate, **lock, **latency},
        "controller": {**model, **driven, **lock, **latency},
        "plant": {"wait_for_readers": readers, **rate, **lock},
    }
    if given["bag"]:
        values["recorder"] = {"path": given["bag"]}
    further: dict[str, dict[str, Any]] = {}
    for companion in companions(given):
        companion.check(loop_of(given))
    join(loop_of(given), further, companions(given))
    for node, own in further.items():
        usual = defaults(rigs.load(loop_of(given).rig), node)  # it is left to the parameter file
        values[node] = {**values.get(node, {}), **{name: own[name] for name in own if own[name] != usual[name]}}
    if given["simulated"] == "false":
        del values["plant"]
        values["controller"]["armed"] = False  # a real rig does not move before somebody has said so
    return values


def loop_of(given: Mapping[str, str]) -> RequestedLoop:
    """What companions join."""
    return RequestedLoop(
        rig=given["rig"] or rigs.default(),
        reference=given["reference"],
        lockstep=given["lockstep"] == "true",
        recorded=bool(given["bag"]),
        simulated=given["simulated"] == "true",
        companions=tuple(companion.name for companion in companions(given)),
    )


def nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Those that are asked for, and the end of all with the end of one without which there is no loop."""
    given = context.launch_configurations
    # Launch says nothing of what nobody declares; a file that includes this one may have more.
    for text in context.argv:
        if (name := text.partition(":=")[0]) not in ARGUMENTS:
            get_logger(PACKAGE).warning(f"rig.launch.py has no argument {name}: {errors.known(name, ARGUMENTS)}")
    values = parameters(given)
    shared = {**({"rig": given["rig"]} if given["rig"] else {}), "autostart": given["autostart"] == "true"}
    respawn = given["respawn"] == "true"

    def node(executable: str, parameters: dict[str, Any], arguments: tuple[str, ...] = (), **more: Any) -> Node:
        # Text is text, whatever quotes and colons are in it.
        given_to_it = {
            name: ParameterValue(value, value_type=str) if isinstance(value, str) else value
            for name, value in {**shared, **parameters}.items()
        }
        return Node(
            package=PACKAGE,
            executable=executable,
            namespace=given["namespace"],
            parameters=[*([given["params_file"]] if given["params_file"] else []), given_to_it],
            arguments=[*arguments],
            output="screen",
            respawn=respawn,
            respawn_delay=1.0,
            **more,
        )

    found = list[Node]()
    apart = {name for item in companions(given) if item.beside for name in item.nodes(loop_of(given))}
    beside = [node(name, values.pop(name), name=name) for name in sorted(apart)]
    if given["composed"] == "true":  # each takes what is its own
        loop = {name: values.pop(name) for name in OF_THE_LOOP if name in values}
        together = {name: value for parameters in loop.values() for name, value in parameters.items()}
        found = [node("composed", together, ("--nodes", *loop))]
    found += [node(name, parameters, name=name) for name, parameters in values.items()]
    if respawn:
        return [*found, *beside]
    # The reference ends when it is over, any other node when something is wrong: the rest would wait for ever.
    end = EmitEvent(event=Shutdown(reason="a node has ended"))
    return [*found, *beside, *(RegisterEventHandler(OnProcessExit(target_action=item, on_exit=end)) for item in found)]


def generate_launch_description() -> LaunchDescription:
    """The arguments, and the nodes that they ask for."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, choices=list(choices) or None, description=description)
        for name, (default, choices, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
