"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.graph"
EXTENSION = Extension(
    name="graph",
    summary="Running nodes: their services, parameters, states and topics.",
    commands={
        "call": (f"{HERE}.commands.call", "Call a service of running nodes, such as stop."),
        "get": (f"{HERE}.commands.get", "Show the parameters of a running node."),
        "set": (f"{HERE}.commands.set", "Set parameters of a running node."),
        "nodes": (f"{HERE}.commands.nodes", "List the running nodes and how they are."),
        "topics": (f"{HERE}.commands.topics", "List the topics and how fast messages come."),
    },
)
