"""The trunk: what this package offers by name without any extension, declared as an extension declares it."""

from hybrid_sysid_ros.support.manifest import Extension

COMMANDS = "hybrid_sysid_ros.commands"
NODES = "hybrid_sysid_ros.nodes"
STRUCTURES = "hybrid_sysid_ros.structures"
SECTIONS = (
    "default", "namespace", "step", "sensors", "actuators", "joints", "signals", "experiments", "references", "nodes",
    "travel", "disturbances", "validity", "offsets", "mpc",
)  # fmt: skip

NEIGHBOURS = {
    "accuracy": ("accuracy", "mockup"), "checks": ("check", "rig check"), "demo": ("demo",),
    "commander": ("say", "mcp", "commander", "--commander", "--layers"),
    "driver": ("rig driver",), "ensemble": ("ensemble",), "experiment_design": ("design",),
    "export": (
        "model export", "policy export", "export fmu", "export loop", "export board", "export page",
        "export ros2_control", "export mjcf", "export urdf", "--baud", "--board", "--body",
    ),
    "frequency_response": ("frequency-response",), "friction_atlas": ("friction", "--beside"),
    "fuzzy": ("takagi_sugeno", "difnn"), "importing": ("import", "rig from"), "input_bias": ("--adapt",),
    "graph": ("get", "set", "call", "topics", "nodes"), "horizon_bands": ("--ahead",),
    "loop_bands": ("--loop",),
    "narx": ("narx", "residual"), "native": ("--body", "--native"),
    "pages": ("docs",),
    "playback": ("play", "replay", "player"), "policies": ("policy train", "policy certify"),
    "promotion": ("promote",), "record_check": ("check-record",), "recurrent": ("recurrent",), "search": ("search",),
    "state_space": ("state_space",), "trained_range": ("trained-range",), "trim": ("trim",), "tuning": ("tune",),
    "view": ("view", "rig layouts", "--view", "--port"),
    "vision": ("film", "video", "camera", "vision", "--camera", "--layers", "--picture"),
}  # fmt: skip
"""Commands, nodes, structures, and options of trunk commands, of the extensions that come with this package, for errors
that name a missing one.
"""

TRUNK = Extension(
    name="hybrid_sysid_ros",
    summary="From a bag to a controlled rig.",
    commands={
        "simulate": (f"{COMMANDS}.simulate", "Simulate an experiment on a rig and write its bag."),
        "identify": (f"{COMMANDS}.identify", "Identify a model from bags."),
        "evaluate": (f"{COMMANDS}.evaluate", "Score a model on bags by free run and closed loop."),
        "run": (f"{COMMANDS}.run", "Run plant, estimator, controller and reference as ROS 2 nodes."),
        "parameters": (f"{COMMANDS}.parameters", "Write the ROS parameter file of a rig's nodes."),
        "rig new": (f"{COMMANDS}.rig_new", "Write a small rig to begin with."),
        "rig list": (f"{COMMANDS}.rig_list", "List the rigs that are known by name."),
    },
    nodes={
        "plant": f"{NODES}.plant",
        "estimator": f"{NODES}.estimator",
        "controller": f"{NODES}.controller",
        "reference": f"{NODES}.reference",
        "recorder": f"{NODES}.recorder",
        "composed": f"{NODES}.composed",
    },
    provides={
        "sections": dict.fromkeys(SECTIONS, ""),
        "estimators": {"ekf": "hybrid_sysid_ros.estimation.extended_kalman_filter:ExtendedKalmanFilter"},
        "structures": {
            **dict.fromkeys(("linear", "stribeck", "dahl", "lugre"), f"{STRUCTURES}.gray_box:GrayBox"),
            "black_box": f"{STRUCTURES}.hybrid:BlackBox",
            "hybrid_joint": f"{STRUCTURES}.hybrid:JointHybrid",
            "hybrid_frozen": f"{STRUCTURES}.hybrid:FrozenHybrid",
            "gray": f"{STRUCTURES}.gray_box:GrayBox",
            "hybrid": f"{STRUCTURES}.hybrid:AnchoredHybrid",
        },
    },
)
