"""Server: the same checked commands as tools for language models (Model Context Protocol), over standard streams."""

from __future__ import annotations

from typing import Any

from hybrid_sysid_ros.extensions.commander.language.command_interface import CommandInterface, Reply
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import set_point_ranges
from hybrid_sysid_ros.support.extras import extra

with extra("mcp"):
    from mcp.server import MCPServer

EXAMPLES = (
    "'go to 1 {unit} slowly', 'swing between -1 and 1 {unit} at 0.2 Hz for 20 s', "
    "'ramp to 1 {unit} in 2 s then hold for 3 s then home'"
)


def server(rig: Rig, desk: CommandInterface) -> MCPServer[Any]:
    """A server of three tools. None of them carries a topic, a raw set-point or a confirmation: what an operator has
    not armed waits for the operator.
    """
    made: MCPServer[Any] = MCPServer(
        f"hybrid_sysid_ros {rig.name}",
        instructions=(
            f"Commands in plain English for the rig {rig.name}. Each is checked and simulated before anything moves; a "
            f"refusal says why and what to say instead. {described(rig)}"
        ),
    )

    @made.tool()
    def check_command(text: str) -> dict[str, Any]:
        """Simulate a command in plain English and tell what would happen; nothing moves."""
        return answer(desk.check(text))

    @made.tool()
    def give_command(text: str) -> dict[str, Any]:
        """Give the rig a command in plain English. It is checked and simulated first; what passes is carried out, or
        waits for the operator to confirm it.
        """
        return answer(desk.say(text))

    @made.tool()
    def stop() -> dict[str, Any]:
        """Bring the inputs of the rig to rest at once."""
        return answer(desk.stop())

    return made


def answer(reply: Reply) -> dict[str, Any]:
    """A reply as a tool gives it."""
    return {"accepted": reply.accepted, "line": reply.line, "values": dict(reply.values)}


def described(rig: Rig) -> str:
    """What may be asked of a rig, in words."""
    tracked = [output for output in set_point_ranges(rig) if output.tracked]
    ranges = [f"{item.name} from {item.low:.4g} to {item.high:.4g} {item.unit}".rstrip() for item in tracked]
    unit = tracked[0].unit if tracked else ""
    own = f" References to follow: {', '.join(rig.references)}." if rig.references else ""
    return f"Outputs: {'; '.join(ranges)}. Examples: {EXAMPLES.format(unit=unit)}.{own}"
