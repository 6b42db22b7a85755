"""Reports: HTML pages of a model and its loop, a replay, an accuracy, a film, a mock-up; each needs no network."""

from hybrid_sysid_ros.extensions.accuracy.report.accuracy_page import accuracy_rows, write_accuracy
from hybrid_sysid_ros.extensions.accuracy.report.mockup_page import parameter_rows, write_mockup
from hybrid_sysid_ros.extensions.playback.report.replay_page import write_replay
from hybrid_sysid_ros.extensions.vision.report.video_page import write_video
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection, closed_loop_section
from hybrid_sysid_ros.report.rendering import check_available, write
from hybrid_sysid_ros.report.sections import (
    FreeRun,
    IdentificationSection,
    Provenance,
    identification_section,
    provenance,
)

__all__ = [
    "ClosedLoopSection",
    "FreeRun",
    "IdentificationSection",
    "Provenance",
    "accuracy_rows",
    "check_available",
    "closed_loop_section",
    "identification_section",
    "parameter_rows",
    "provenance",
    "write",
    "write_accuracy",
    "write_mockup",
    "write_replay",
    "write_video",
]
