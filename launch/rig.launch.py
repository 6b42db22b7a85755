"""Launch a rig: ros2 launch hybrid_sysid_ros rig.launch.py [rig:=NAME_OR_PATH] [namespace:=NAME] [bag:=FOLDER] ..."""

import os
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit, OnProcessIO
from launch.events import Shutdown
from launch.events.process import ProcessExited, ProcessIO
from launch.launch_context import LaunchContext
from launch.logging import get_logger
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from hybrid_sysid_ros.bags import markers
from hybrid_sysid_ros.commands.app import arguments_of
from hybrid_sysid_ros.nodes.parameters import OF_QUALITY, OF_ROS
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import node_commands, preflight, processes
from hybrid_sysid_ros.runtime.companion import LOOP, Companion, RequestedLoop, join
from hybrid_sysid_ros.runtime.parameters import declarations, defaults, of_file
from hybrid_sysid_ros.support import errors, extensions
from hybrid_sysid_ros.support.files import check_folder
from launch import LaunchDescription, LaunchDescriptionEntity

PACKAGE = "hybrid_sysid_ros"
PUBLISHER = "robot_state_publisher"
REFUSED = 2
"""Status of a node that says in a line what is wrong: to start it again would not help."""
WORDS = {"at rest": True, "may move": False}
"""What a controller announces, and whether one that is started again has to stay at rest."""
TRUTHS = ("true", "false")
LEVELS = ("debug", "info", "warn", "error", "fatal")
# Name: default, choices, description.
ARGUMENTS = {
    "rig": ("", (), "Rig, by its name or by the path of its folder; empty: the default rig."),
    "namespace": ("", (), "Namespace of nodes and topics, for one of several rigs."),
    "params_file": ("", (), "ROS parameter file of the nodes, as `hybrid-sysid parameters` writes it."),
    "rate": ("", (), "Measurements per second [Hz]; empty: the rig's rate."),
    "policy": (
        "supervised",
        ("supervised", "network", "exact"),
        "What drives the rig: the network, checked or alone, or the exact MPC.",
    ),
    "policy_path": ("", (), "Folder of the network; empty: the shipped one."),
    "solver": ("sqp", ("sqp", "ipopt"), "Solver of the exact MPC; ipopt is the slow reference."),
    "model": ("", (), "Folder of the model; empty: the shipped one."),
    "reference": (
        "",
        (),
        "One of the rig's references, constant, steps, sine or multisine; empty: the rig's first. Its last value is "
        "held until Ctrl-C.",
    ),
    "duration": ("0", (), "Length of the run [s], after which the launch ends; 0: until Ctrl-C."),
    "simulated": (
        "true",
        TRUTHS,
        "false: the rig is real: a driver has joint_states and joint_command, and the loop waits for the service arm.",
    ),
    "lockstep": ("false", TRUTHS, "true: as fast as the nodes answer, in simulated time, the same in every run."),
    "composed": ("false", TRUTHS, "true: plant, estimator, controller and reference in one process and one loop."),
    "respawn": ("3", (), "How often a node that dies is started again before the launch ends; never in lockstep."),
    "autostart": ("true", TRUTHS, "false: a manager configures and activates the nodes (ros2 lifecycle)."),
    "bag": ("", (), "Folder of a bag to record; empty: none."),
    "priority": (
        "",
        (),
        "Real-time priority of plant, estimator and controller; empty: a modest one where permitted, 0: none.",
    ),
    "use_sim_time": ("false", TRUTHS, "true: the nodes take their time from /clock."),
    "log_level": ("info", LEVELS, "Least severe messages that the nodes log."),
    PUBLISHER: (
        "true",
        TRUTHS,
        f"true: {PUBLISHER} publishes the rig's URDF and transforms, where the rig has joints and it is installed.",
    ),
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
        values[name] = given[name] == "true" if kind is bool else number(given, name) if kind is int else given[name]
    makers = extensions.provided("companions").values()
    made = [make(**{name: values[name] for name in arguments_of(make)}) for make in makers]
    return [companion for companion in made if companion is not None]


def number(given: Mapping[str, str], name: str, kind: type[Any] = int) -> Any:
    """A number of the arguments. Raises UserError where it is none."""
    try:
        return kind(given[name])
    except ValueError as error:
        words = "a whole number" if kind is int else "a number"
        raise errors.UserError(f"argument {name} is {given[name]!r}: it needs {words}") from error


def parameters(given: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Of the nodes that are asked for, by node and name: plant (unless the rig is real), estimator, controller,
    reference, and what is asked for beside them. Raises UserError where an argument makes no sense.
    """
    asked = {name: given[name] for name, (default, *_) in ARGUMENTS.items() if given[name] != default}
    lock = {"lockstep": True} if "lockstep" in asked else {}
    latency = {"latency": 0.0} if lock else {}
    rate = {"rate": number(asked, "rate", float)} if "rate" in asked else {}
    model = {name: asked[name] for name in ("model",) if name in asked}
    driven = {name: asked[name] for name in ("policy", "policy_path", "solver") if name in asked}
    readers = 3 if given["bag"] else 2  # of joint_states: estimator, reference and recorder, whom the rig waits for
    loop = loop_of(given)
    lasting = {"duration": loop.duration} if loop.duration else {"stay": True}
    values: dict[str, dict[str, Any]] = {
        "reference": {**({"kind": asked["reference"]} if "reference" in asked else {}), **lasting, **lock},
        "estimator": {**model, **rate, **lock, **latency},
        "controller": {**model, **driven, **lock, **latency},
        "plant": {"wait_for_readers": readers, **rate, **lock},
    }
    if given["bag"]:
        values["recorder"] = {"path": given["bag"], "resume": respawns(given) > 0}
    further: dict[str, dict[str, Any]] = {}
    for companion in companions(given):
        companion.check(loop)
    join(loop, further, companions(given))
    for node, own in further.items():
        usual = defaults(rigs.load(loop.rig), node)  # it is left to the parameter file
        values[node] = {**values.get(node, {}), **{name: own[name] for name in own if own[name] != usual[name]}}
    if given["simulated"] == "false":
        del values["plant"]
        values["controller"]["armed"] = False  # a real rig does not move before somebody has said so
    usual_priority = 0 if lock else processes.permitted_priority()
    priority = number(given, "priority") if given["priority"] else usual_priority
    for node in values:
        values[node] |= {"priority": processes.priority_of(node, priority)} if priority else {}
        values[node] |= {"autostart": False} if given["autostart"] == "false" else {}
    return values


def loop_of(given: Mapping[str, str]) -> RequestedLoop:
    """What companions join."""
    return RequestedLoop(
        rig=given["rig"] or rigs.default(),
        reference=given["reference"],
        duration=number(given, "duration", float),
        lockstep=given["lockstep"] == "true",
        recorded=bool(given["bag"]),
        simulated=given["simulated"] == "true",
        companions=tuple(companion.name for companion in companions(given)),
    )


def respawns(given: Mapping[str, str]) -> int:
    """How often a node that dies is started again."""
    return 0 if given["lockstep"] == "true" else number(given, "respawn")


def check(given: Mapping[str, str], values: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise UserErrors, a line for each thing that is wrong with a loop of these parameters and the file."""
    rig, problems, together = rigs.load(given["rig"] or rigs.default()), list[str](), dict[str, dict[str, Any]]()
    for node, own in values.items():
        in_file = of_file(given["params_file"], f"/{given['namespace'].strip('/')}/{node}".replace("//", "/"))
        others = {name for names in declarations().values() for name in names} - declarations()[node].keys()
        left = {name for name in in_file if name in (*others, "rig") or name.startswith((*OF_ROS, OF_QUALITY))}
        together[node] = {**{name: in_file[name] for name in in_file if name not in left}, **own}
    with errors.collected(problems):
        preflight.check(rig, together)
    if given["bag"]:
        with errors.collected(problems):
            check_folder(given["bag"], marker=markers(Path(given["bag"])), replace=False)
    if problems:
        raise errors.UserErrors(problems)


def stayed(values: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Parameters of nodes whose controller stays at rest until it is armed."""
    return {**values, "controller": {**values["controller"], "armed": False}}


class Watch:
    """Counts the ends of nodes: a node that dies is started again so often, and then, or when one ends by itself,
    all end. A controller that died at rest, as after an emergency stop, comes back disarmed.
    """

    def __init__(self, respawns: int) -> None:
        self.respawns = respawns
        self.deaths: Counter[str] = Counter()
        self.resting = False
        """Whether the controller has said that it stays at rest."""

    def heard(self, event: ProcessIO) -> None:
        """What a controller says on its standard output."""
        for line in event.text.decode(errors="replace").splitlines():
            if (word := line.partition(":")[0].strip()) in WORDS:
                self.resting = WORDS[word]

    def started(self, make: Callable[[bool], Node], *, moves: bool = False) -> list[LaunchDescriptionEntity]:
        """A node, and what follows of its end. make: gets whether the node has to stay at rest, in which ``moves`` has
        a part.
        """
        item = make(moves and self.resting)
        found = [
            item,
            RegisterEventHandler(OnProcessExit(target_action=item, on_exit=partial(self.ended, make, moves))),
        ]
        return [*found, RegisterEventHandler(OnProcessIO(target_action=item, on_stdout=self.heard))] if moves else found

    def ended(
        self, make: Callable[[bool], Node], moves: bool, event: ProcessExited, context: LaunchContext
    ) -> list[LaunchDescriptionEntity]:
        """What follows of the end of a node."""
        name, status = event.process_name.rpartition("-")[0], event.returncode
        if context.is_shutdown:
            return []
        self.deaths[name] += 1
        if status in (0, REFUSED) or self.deaths[name] > self.respawns:
            return [EmitEvent(event=Shutdown(reason=f"{name} has ended with status {status}"))]
        words = f"{name} ended with status {status}; started again, {self.deaths[name]} of {self.respawns}"
        get_logger(PACKAGE).warning(words)
        return self.started(make, moves=moves)


def maker(given: Mapping[str, str]) -> Callable[..., Node]:
    """What makes a node of the launch's arguments: an executable's, with its parameters and options."""
    shared = {**({"rig": given["rig"]} if given["rig"] else {}), "use_sim_time": given["use_sim_time"] == "true"}
    # A loop's matrices are too small for more threads.
    threads = {name: os.environ.get(name, "1") for name in processes.THREADS}

    def node(
        executable: str,
        parameters: dict[str, Any],
        arguments: tuple[str, ...] = (),
        file: str = "",
        **more: Any,
    ) -> Node:
        # Text is text, whatever quotes and colons are in it.
        given_to_it = {
            name: ParameterValue(value, value_type=str) if isinstance(value, str) else value
            for name, value in {**shared, **parameters}.items()
        }
        return Node(
            package=PACKAGE,
            executable=executable,
            namespace=given["namespace"],
            parameters=[*filter(None, (given["params_file"], file)), given_to_it],
            arguments=[*arguments],
            ros_arguments=["--log-level", given["log_level"]],
            additional_env=threads,
            output="screen",
            **more,
        )

    return node


def nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Those that are asked for, once all questions about them are answered, and what follows of their ends."""
    given = context.launch_configurations
    # Launch says nothing of what nobody declares; a file that includes this one may have more.
    for text in context.argv:
        if (name := text.partition(":=")[0]) not in ARGUMENTS:
            why = extensions.missing(f"--{name}") or errors.known(name, ARGUMENTS)
            get_logger(PACKAGE).warning(f"rig.launch.py has no argument {name}: {why}")
    try:
        values = parameters(given)
        check(given, values)
    except errors.UserError as error:
        for line in errors.lines_of(error):
            get_logger(PACKAGE).error(line)
        raise errors.UserError("nothing was started") from error
    node = maker(given)
    watch = Watch(respawns(given))
    apart = {name for item in companions(given) if item.beside for name in item.nodes(loop_of(given))}
    beside = [node(name, values.pop(name), name=name) for name in sorted(apart)]
    found = list[LaunchDescriptionEntity]()
    if given["composed"] == "true":  # each takes what is its own
        loop = {name: values.pop(name) for name in LOOP if name in values}

        def composed(resting: bool) -> Node:
            with NamedTemporaryFile(
                "w", prefix="hybrid_sysid_", suffix=".yaml", delete=False
            ) as file:  # as launch has its own
                file.write(node_commands.parameter_text(stayed(loop) if resting else loop))
            return node("composed", {}, ("--nodes", *loop), file.name)

        found += watch.started(composed, moves=True)

    def alone(name: str, resting: bool) -> Node:
        return node(name, (stayed(values) if resting else values)[name], name=name)

    for name in values:
        found += watch.started(partial(alone, name), moves=name == "controller")
    return [*found, *beside, *described(given)]


def described(given: Mapping[str, str]) -> list[Node]:
    """The publisher of the rig's URDF and transforms, where it has joints and there is one."""
    texts = [make(rigs.load(given["rig"] or rigs.default())) for make in extensions.provided("descriptions").values()]
    try:
        get_package_prefix(PUBLISHER)
    except (PackageNotFoundError, OSError):  # OSError: no ROS is sourced
        return []
    if given[PUBLISHER] == "false" or not any(texts):
        return []
    urdf = ParameterValue(next(filter(None, texts)), value_type=str)
    prefix = f"{given['namespace'].strip('/')}/".lstrip("/")
    return [
        Node(
            package=PUBLISHER,
            executable=PUBLISHER,
            namespace=given["namespace"],
            parameters=[{"robot_description": urdf, "frame_prefix": prefix}],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """The arguments, and the nodes that they ask for."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, choices=list(choices) or None, description=description)
        for name, (default, choices, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
