"""Pages of HTML on models and loops, which need no network, and the figures on them."""

from hybrid_sysid_ros.extensions.shared.report.rendering import check_available, write_report
from hybrid_sysid_ros.extensions.shared.report.sections import (
    FreeRunSection,
    IdentificationSection,
    Provenance,
    identification_section,
    provenance,
)

__all__ = [
    "FreeRunSection",
    "IdentificationSection",
    "Provenance",
    "check_available",
    "identification_section",
    "provenance",
    "write_report",
]
