"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.fuzzy"
EXTENSION = Extension(
    name="fuzzy",
    summary="Fuzzy models: Takagi-Sugeno and fuzzy-neural ones, and their rules as blocks of hybrids.",
    provides={
        "structures": {
            "takagi_sugeno": f"{HERE}.structures:TakagiSugenoStructure",
            "difnn": f"{HERE}.structures:DifnnStructure",
        },
        "blocks": {"affine_rules": f"{HERE}.blocks:AffineRulesKind", "linked_rules": f"{HERE}.blocks:LinkedRulesKind"},
    },
)
