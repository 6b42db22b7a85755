"""Launch a rig: ros2 launch hybrid_sysid_ros rig.launch.py [rig:=NAME_OR_PATH] [policy:=exact] [bag:=FOLDER]."""

from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_context import LaunchContext
from launch_ros.actions import Node

from launch import LaunchDescription, LaunchDescriptionEntity

PACKAGE = "hybrid_sysid_ros"
TRUTHS = ("true", "false")
# Name: default, choices, description.
ARGUMENTS = {
    "rig": ("", (), "the rig, by its name or by the path of its folder"),
    "namespace": ("", (), "of nodes and topics; empty: the topics are in the rig's own"),
    "rate": ("200.0", (), "measurements per second [Hz]"),
    "policy": (
        "supervised",
        ("supervised", "network", "exact"),
        "what drives: the network, checked or alone, or the MPC",
    ),
    "policy_path": ("", (), "folder of the network; empty: the shipped one"),
    "solver": ("sqp", ("sqp", "ipopt"), "of the exact MPC; ipopt is the slow reference"),
    "model": ("", (), "folder of the model; empty: the shipped one"),
    "reference": ("", (), "one of the rig's references, constant, steps, sine or multisine; empty: the rig's first"),
    "simulated": ("true", TRUTHS, "false: the rig is real: its driver has joint_states and joint_command"),
    "lockstep": ("false", TRUTHS, "true: as fast as the nodes answer, in simulated time, the same in every run"),
    "bag": ("", (), "folder of a bag to record; empty: none"),
}


def nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Plant (unless the rig is real), estimator, controller, reference and, if asked for, recorder."""
    given = context.launch_configurations
    lock = {"lockstep": given["lockstep"] == "true"}
    latency = {"latency": 0.0} if lock["lockstep"] else {}
    rate, model = {"rate": float(given["rate"])}, {"model": given["model"]}
    driven = {name: given[name] for name in ("policy", "policy_path", "solver")}

    def node(name: str, **parameters: object) -> Node:
        return Node(
            package=PACKAGE,
            executable=name,
            name=name,
            namespace=given["namespace"],
            parameters=[{"rig": given["rig"], **parameters}],
            output="screen",
        )

    found = [node("reference", kind=given["reference"], **lock), node("estimator", **rate, **model, **lock, **latency)]
    found.append(node("controller", **driven, **model, **lock, **latency))
    if given["bag"]:
        found.append(node("recorder", path=given["bag"]))
    if given["simulated"] == "true":
        # Joint states go to estimator, reference and recorder: the rig waits for those that there are.
        found.append(node("plant", wait_for_readers=3 if given["bag"] else 2, **rate, **lock))
    # The reference ends when it is over, any other node when something is wrong: the rest would wait for ever.
    end = EmitEvent(event=Shutdown(reason="a node has ended"))
    return [*found, *(RegisterEventHandler(OnProcessExit(target_action=item, on_exit=end)) for item in found)]


def generate_launch_description() -> LaunchDescription:
    """The arguments, and the nodes that they ask for."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, choices=list(choices) or None, description=description)
        for name, (default, choices, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
