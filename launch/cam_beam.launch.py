"""Launch the cam-driven beam: ros2 launch hybrid_sysid_ros cam_beam.launch.py [policy:=exact] [bag:=FOLDER]."""

from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

PACKAGE = "hybrid_sysid_ros"
NAMESPACE = "cam_beam"
ARGUMENTS = {
    "rate": ("200.0", "measurements per second [Hz]"),
    "policy": ("supervised", "supervised (the network, checked), network (unchecked) or exact (the MPC)"),
    "policy_path": ("", "folder of the network; empty: the shipped one"),
    "model": ("", "folder of the model; empty: the shipped one"),
    "reference": ("hardware", "hardware, constant, steps, sine or multisine"),
    "simulated": ("true", "false: the rig is real, and its driver has the topics joint_states and joint_command"),
    "bag": ("", "folder of a bag to record; empty: none"),
}


def generate_launch_description() -> LaunchDescription:
    """Plant (unless the rig is real), estimator, controller, reference and, if asked for, recorder."""

    def given(name: str, kind: type = str) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=kind)

    def node(name: str, condition: IfCondition | None = None, **parameters: object) -> Node:
        return Node(
            package=PACKAGE,
            executable=name,
            name=name,
            namespace=NAMESPACE,
            parameters=[{"rig": NAMESPACE, **parameters}],
            output="screen",
            condition=condition,
        )

    recording = PythonExpression(["'", LaunchConfiguration("bag"), "' != ''"])
    # Joint states go to the estimator, the reference and, where there is one, the recorder: the beam waits for them.
    readers = ParameterValue(PythonExpression(["2 + ('", LaunchConfiguration("bag"), "' != '')"]), value_type=int)
    reference = node("reference", kind=given("reference"))
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            reference,
            node("estimator", rate=given("rate", float), model=given("model")),
            node("controller", policy=given("policy"), policy_path=given("policy_path"), model=given("model")),
            node("recorder", IfCondition(recording), path=given("bag")),
            node(
                "plant",
                IfCondition(LaunchConfiguration("simulated")),
                rate=given("rate", float),
                wait_for_readers=readers,
            ),
            RegisterEventHandler(
                OnProcessExit(
                    target_action=reference, on_exit=EmitEvent(event=Shutdown(reason="the reference has ended"))
                )
            ),
        ]
    )
