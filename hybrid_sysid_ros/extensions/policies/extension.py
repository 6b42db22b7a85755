"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.policies"
EXTENSION = Extension(
    name="policies",
    summary="Networks trained to imitate the exact MPC, and their certificates.",
    commands={
        "policy train": (f"{HERE}.commands.policy_train", "Train a network that imitates the exact MPC."),
        "policy certify": (
            f"{HERE}.commands.policy_certify",
            "State how a policy does beside the exact MPC, and how surely.",
        ),
    },
    provides={
        "sections": {
            "policy_training": "hybrid_sysid_ros.extensions.shared.drawn_scenarios:spread_of",
            "policy_certificate": "",
        },
        "policies": {"train": f"{HERE}.configured:train_configured_policy", "certify": f"{HERE}.configured:certified"},
    },
)
