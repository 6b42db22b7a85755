"""Server: the same checked commands as tools for language models (Model Context Protocol), over standard streams.

Each tool that moves the rig writes a sentence, which passes the same checks as any other. None of them carries a topic,
a raw set-point or a confirmation: what an operator has not armed waits for the operator.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Annotated, Any, Literal

from hybrid_sysid_ros.extensions.commander.language.command_interface import CommandInterface, Reply
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.versions import installed

with extra("mcp"):
    import anyio
    from mcp.server import MCPServer
    from mcp.server.mcpserver import Context, Image
    from mcp.server.mcpserver.exceptions import ToolError
    from mcp.types import ToolAnnotations
    from pydantic import Field

    from hybrid_sysid_ros.extensions.commander.language.charts import forecast_chart, state_chart

EXAMPLES = (
    "'go to 1 {unit} slowly', 'swing between -1 and 1 {unit} at 0.2 Hz for 20 s', "
    "'ramp to 1 {unit} in 2 s then hold for 3 s then home', 'once it is still go to 0'"
)
PAGE = Path(__file__).parents[1] / "docs" / "commander.md"
TICK = 0.5  # s, between two reports of progress
LONGEST_REPORT = 20_000  # characters
READS = ToolAnnotations(read_only_hint=True, open_world_hint=False)
MOVES = ToolAnnotations(read_only_hint=False, destructive_hint=True, idempotent_hint=False, open_world_hint=False)
STOPS = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=True, open_world_hint=False)
Output = Annotated[str, Field(description="Name of an output, as limits() lists them; empty where there is one only.")]
Level = Annotated[float, Field(description="In the unit in which limits() lists the output.")]
Seconds = Annotated[float | None, Field(gt=0.0, description="[s]")]


def server(rig: Rig, desk: CommandInterface) -> MCPServer[Any]:
    """A server of a rig's tools and resources."""
    made: MCPServer[Any] = MCPServer(
        f"hybrid_sysid_ros {rig.name}",
        version=installed("hybrid_sysid_ros"),
        instructions=(
            f"Tools for the rig {rig.name}. Each command is checked and simulated before anything moves; a refusal "
            f"says why, and what to say instead. Look at state and preview before you move. {described(rig)}"
        ),
    )
    tools = _Tools(rig, desk)
    for tool, hints in tools.by_kind():
        made.tool(annotations=hints)(tool)
    made.resource(f"rig://{rig.name}", name="rig", description="The rig's file.", mime_type="application/yaml")(
        lambda: rig.file.read_text(encoding="utf-8")
    )
    made.resource("docs://commander", name="docs", description="What can be said.", mime_type="text/markdown")(
        lambda: PAGE.read_text(encoding="utf-8") if PAGE.is_file() else described(rig)
    )
    made.resource("report://last", name="report", description="The newest report below out/.", mime_type="text/plain")(
        last_report
    )
    return made


class _Tools:
    """What the tools do; one command at a time, but a stop waits for none."""

    def __init__(self, rig: Rig, desk: CommandInterface) -> None:
        self.rig, self.desk = rig, desk
        self.busy = Lock()
        self.previewed: Reply | None = None

    def by_kind(self) -> list[tuple[Callable[..., Any], ToolAnnotations]]:
        """Tools with what they do to the rig."""
        tools: list[tuple[Callable[..., Any], ToolAnnotations]] = [
            *((tool, READS) for tool in (self.state, self.limits, self.picture, self.preview, self.plot)),
            *((tool, MOVES) for tool in (self.say, self.move, self.swing, self.follow)),
            *((tool, STOPS) for tool in (self.hold, self.stop)),
        ]
        return tools

    async def run(self, action: Callable[[], Any], context: Context[Any] | None, what: str) -> Any:
        """An action in a thread of its own, with progress until it is done."""
        done = anyio.Event()

        async def tell() -> None:
            count = 0
            while not done.is_set():
                with anyio.move_on_after(TICK):
                    await done.wait()
                count += 1
                if context is not None and not done.is_set():
                    await context.report_progress(count * TICK, None, what)

        async with anyio.create_task_group() as group:
            group.start_soon(tell)
            try:
                found = await anyio.to_thread.run_sync(action)
            except UserError as error:
                raise ToolError(str(error)) from error
            finally:
                done.set()
        return found

    def alone(self, action: Callable[[str], Reply], text: str) -> Reply:
        """One command, when the one before is answered."""
        with self.busy:
            return action(text)

    async def command(self, text: str, context: Context[Any]) -> dict[str, Any]:
        action = partial(self.alone, self.desk.say, text)
        return answer(await self.run(action, context, "checking and simulating"), text)

    async def state(self) -> dict[str, Any]:
        """Where the rig is now: outputs, what is asked of them, inputs."""
        return asdict(await self.run(self.desk.state, None, ""))

    async def limits(self) -> dict[str, Any]:
        """What may be asked for: outputs with the ends of their set-points, inputs with their limits, references."""
        about = self.rig.system.operating_point
        outputs = [
            {"name": item.name, "unit": item.unit, "low": item.low, "high": item.high,
             "counted_from": about.get(item.name, 0.0) / item.scale}
            for item in set_point_ranges(self.rig) if item.tracked
        ]  # fmt: skip
        inputs = [
            {"name": item.name, "unit": item.unit, "low": actuator.low, "high": actuator.high}
            for item, actuator in zip(self.rig.system.inputs, self.rig.actuators, strict=True)
        ]
        return {"outputs": outputs, "inputs": inputs, "references": list(self.rig.references)}

    async def picture(self) -> Image:
        """A picture of where the rig is: outputs between the ends of their set-points, inputs between their limits."""
        found = await self.run(self.desk.state, None, "")
        return Image(data=state_chart(self.rig, found), format="png")

    async def preview(
        self,
        text: Annotated[str, Field(description="A command in English or Portuguese.")],
        context: Context[Any],
    ) -> dict[str, Any]:
        """Simulate a command from where the rig is now, and tell what would happen; nothing moves."""
        reply = await self.run(partial(self.alone, self.desk.check, text), context, "simulating")
        self.previewed = reply if reply.forecast is not None else self.previewed
        return answer(reply, text)

    async def plot(self) -> Image:
        """The last preview as a picture: outputs with their references, and inputs, over time."""
        if self.previewed is None or self.previewed.forecast is None:
            raise ToolError("nothing was previewed yet: call preview before")
        return Image(data=forecast_chart(self.rig, self.previewed.forecast), format="png")

    async def say(
        self,
        text: Annotated[str, Field(description="A command in English or Portuguese.")],
        context: Context[Any],
    ) -> dict[str, Any]:
        """Give the rig a command in words. What passes is carried out, or waits for the operator to confirm it."""
        return await self.command(text, context)

    async def move(
        self,
        value: Level,
        context: Context[Any],
        output: Output = "",
        relative: Annotated[bool, Field(description="Whether the value is a change from where it is.")] = False,
        seconds: Seconds = None,
        pace: Literal["slowly", "", "quickly"] = "",
        hold: Seconds = None,
    ) -> dict[str, Any]:
        """Move an output smoothly to a value, or by one, in a time or at a pace, and hold it there."""
        name, unit = self.of(output)
        words = [f"move {name} {'by' if relative else 'to'} {value!r} {unit}"]
        words += [f"in {seconds!r} s"] if seconds is not None else []
        words += [pace] if pace else []
        words += [f"for {hold!r} s"] if hold is not None else []
        return await self.command(" ".join(words), context)

    async def swing(
        self,
        low: Level,
        high: Level,
        frequency: Annotated[float, Field(gt=0.0, description="[Hz]")],
        seconds: Annotated[float, Field(gt=0.0, description="[s]")],
        context: Context[Any],
        output: Output = "",
        shape: Literal["sine", "square", "triangle"] = "sine",
    ) -> dict[str, Any]:
        """Let an output swing between two values."""
        name, unit = self.of(output)
        kind = {"sine": "swing", "square": "square wave", "triangle": "triangle wave"}[shape]
        text = f"{kind} of {name} between {low!r} {unit} and {high!r} {unit} at {frequency!r} Hz for {seconds!r} s"
        return await self.command(text, context)

    async def follow(
        self,
        name: Annotated[str, Field(description="One of the rig's references, or a file of columns in its folder.")],
        context: Context[Any],
    ) -> dict[str, Any]:
        """Follow a reference or a file."""
        return await self.command(f"follow {name}", context)

    async def hold(self, context: Context[Any]) -> dict[str, Any]:
        """Keep the outputs where they are asked to be, instead of what runs."""
        return await self.command("wait 0.1 s", context)

    async def stop(
        self,
        latch: Annotated[bool, Field(description="An emergency stop, which an operator must reset.")] = False,
    ) -> dict[str, Any]:
        """Bring the inputs of the rig to rest at once; waits for nothing."""
        text = "emergency stop" if latch else "stop"
        action = partial(self.desk.say, text) if latch else self.desk.stop
        return answer(await self.run(action, None, ""), text)

    def of(self, output: str) -> tuple[str, str]:
        """How an output is said, and its unit. Raises ToolError for a name that there is not, or that is needed."""
        tracked = [item for item in set_point_ranges(self.rig) if item.tracked]
        found = [item for item in tracked if item.name == output or (not output and len(tracked) == 1)]
        if not found:
            raise ToolError(f"no output {output!r} is steered: name one of {', '.join(item.name for item in tracked)}")
        return found[0].name.replace("_", " "), found[0].unit


def answer(reply: Reply, text: str) -> dict[str, Any]:
    """A reply as a tool gives it, with the words that were checked."""
    line = reply.line or ("stopped: the inputs go to rest" if reply.accepted else "")
    return {"accepted": reply.accepted, "said": text, "line": line, "values": dict(reply.values)}


def last_report() -> str:
    """The text of the newest report below out/, without its figures."""
    found = sorted(Path("out").glob("**/report.html"), key=lambda path: path.stat().st_mtime)
    if not found:
        return "no report yet: 'hybrid-sysid demo' writes one"
    page = found[-1].read_text(encoding="utf-8", errors="replace")
    page = re.sub(r"<(script|style|svg)\b.*?</\1>", " ", page, flags=re.DOTALL)
    text = re.sub(r"\s*\n\s*", "\n", re.sub(r"<[^>]+>", " ", page))
    return f"{found[-1]}\n{text[:LONGEST_REPORT]}"


def described(rig: Rig) -> str:
    """What may be asked of a rig, in words."""
    tracked = [output for output in set_point_ranges(rig) if output.tracked]
    ranges = [f"{item.name} from {item.low:.4g} to {item.high:.4g} {item.unit}".rstrip() for item in tracked]
    unit = tracked[0].unit if tracked else ""
    own = f" References to follow: {', '.join(rig.references)}." if rig.references else ""
    return f"Outputs: {'; '.join(ranges)}. Examples: {EXAMPLES.format(unit=unit)}.{own}"
