"""A policy outside of Python: as an ONNX graph and as C that needs nothing but math.h, each held against the policy."""

from hybrid_sysid_ros.control.export.folder import Check, Format, export

__all__ = ["Check", "Format", "export"]
