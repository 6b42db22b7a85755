"""Reports: what is said of a run, a recorded loop and an inspection, as data without figures."""

from hybrid_sysid_ros.report.inspection import FurtherSection, Inspection
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection, closed_loop_section
from hybrid_sysid_ros.report.run_summary import RunSummary

__all__ = ["ClosedLoopSection", "FurtherSection", "Inspection", "RunSummary", "closed_loop_section"]
