"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.report"
EXTENSION = Extension(
    name="report",
    summary="Pages of HTML on models, and figures in notebooks.",
    provides={
        **{kind: {"stages": f"{HERE}.stages:stages"} for kind in ("comparisons", "inspections")},
        "pages": {"model": f"{HERE}.model_page:ModelPage"},
        "figures": {"free_run": f"{HERE}.drawing:free_run_figure", "loop": f"{HERE}.drawing:loop_figure"},
    },
)
