"""From a bag to a controlled rig: hybrid models, estimators, exact and learned MPC.

``import hybrid_sysid_ros as hs`` offers the names of ``__all__``, each loaded when it is first asked for. All else is
private, and may change.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hybrid_sysid_ros.bags.record import Record
    from hybrid_sysid_ros.library.loops import simulate
    from hybrid_sysid_ros.library.models import Model, identify, load_model
    from hybrid_sysid_ros.library.mpc import mpc
    from hybrid_sysid_ros.library.policies import Policy, certify, export, load_policy, train_policy
    from hybrid_sysid_ros.library.records import load_rig, read_bag, record
    from hybrid_sysid_ros.rigs.rig import Rig
    from hybrid_sysid_ros.support.errors import UserError

__all__ = [
    "Model",
    "Policy",
    "Record",
    "Rig",
    "UserError",
    "certify",
    "export",
    "identify",
    "load_model",
    "load_policy",
    "load_rig",
    "mpc",
    "read_bag",
    "record",
    "simulate",
    "train_policy",
]

_ROOMS = {
    "library.records": ("load_rig", "read_bag", "record"),
    "library.models": ("Model", "identify", "load_model"),
    "library.loops": ("simulate",),
    "library.mpc": ("mpc",),
    "library.policies": ("Policy", "certify", "export", "load_policy", "train_policy"),
    "bags.record": ("Record",),
    "rigs.rig": ("Rig",),
    "support.errors": ("UserError",),
}
"""Where each name is."""

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """A public name, from the room that has it (PEP 562)."""
        from importlib import import_module

        for room, names in _ROOMS.items():
            if name in names:
                found = globals()[name] = getattr(import_module(f"{__name__}.{room}"), name)
                return found
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")

    def __dir__() -> list[str]:
        return list(__all__)
