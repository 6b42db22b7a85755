"""A policy outside of Python: as an ONNX graph and as C that needs nothing but math.h, each held against the policy."""

from hybrid_sysid_ros.control.export.folder import Check, ExportFormat, export

__all__ = ["Check", "ExportFormat", "export"]
