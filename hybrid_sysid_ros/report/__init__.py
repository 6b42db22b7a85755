"""Reports: HTML pages of a model and its loop, which need no network."""

from hybrid_sysid_ros.report.further import FurtherSection, Inspection
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection, closed_loop_section, ideal_errors
from hybrid_sysid_ros.report.rendering import check_available, write_report
from hybrid_sysid_ros.report.run_summary import RunSummary
from hybrid_sysid_ros.report.sections import (
    FreeRunSection,
    IdentificationSection,
    Provenance,
    identification_section,
    provenance,
)

__all__ = [
    "ClosedLoopSection",
    "FreeRunSection",
    "FurtherSection",
    "IdentificationSection",
    "Inspection",
    "Provenance",
    "RunSummary",
    "check_available",
    "closed_loop_section",
    "ideal_errors",
    "identification_section",
    "provenance",
    "write_report",
]
