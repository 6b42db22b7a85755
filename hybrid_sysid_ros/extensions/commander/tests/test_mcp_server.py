"""The tools for language models, in one process: the same checked commands, and nothing else."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from importlib import metadata, util
from threading import Event
from typing import TYPE_CHECKING, Any

import pytest

from hybrid_sysid_ros.extensions.commander.language import grammar
from hybrid_sysid_ros.extensions.commander.language.command_interface import CommandInterface, Reply, RigState
from hybrid_sysid_ros.extensions.commander.language.rehearsal import Rehearsal
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.extensions.commander.tests.test_rehearsal import interpreter
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError

if TYPE_CHECKING:
    from mcp import Client

if util.find_spec("mcp") is None:
    pytest.skip("needs mcp: install hybrid_sysid_ros[mcp]", allow_module_level=True)

TOOLS = {"state", "limits", "picture", "preview", "plot", "say", "move", "swing", "follow", "hold", "stop"}


def client_of(rig: str, desk: CommandInterface) -> Client:
    """A client of the server. mcp is imported here, a tenth of the time of collecting all tests."""
    from mcp import Client

    from hybrid_sysid_ros.extensions.commander.language.server import server

    return Client(server(rigs.load(rig), desk))


class Noting(CommandInterface):
    """Notes what arrives, and counts how many commands are under way at once."""

    def __init__(self) -> None:
        self.arrived: list[tuple[str, str]] = []
        self.under_way = self.most = 0

    def say(self, text: str) -> Reply:
        self.arrived.append(("say", text))
        self.under_way += 1
        self.most = max(self.most, self.under_way)
        time.sleep(0.02)
        self.under_way -= 1
        return Reply(text=text, accepted=False, line="3 of what? say '3 V'")

    def check(self, text: str) -> Reply:
        self.say(text)
        self.arrived[-1] = ("check", text)
        return Reply(text=text, accepted=True, line="position from 0 V to 1 V", values={"seconds": 2.0})

    def stop(self) -> Reply:
        self.arrived.append(("stop", ""))
        return Reply(text="stop", accepted=True, line="")

    def state(self) -> RigState:
        raise UserError("no estimate has come yet: is the loop running?")


def called(desk: CommandInterface, *calls: tuple[str, Mapping[str, Any]], rig: str = "cam_beam") -> list[Any]:
    async def call() -> list[Any]:
        async with client_of(rig, desk) as client:
            return list(await asyncio.gather(*(client.call_tool(name, dict(given)) for name, given in calls)))

    return asyncio.run(call())


def test_tools_say_what_they_do_to_the_rig_and_none_confirms_or_arms() -> None:
    async def listed() -> dict[str, Any]:
        async with client_of("cam_beam", Noting()) as client:
            return {tool.name: tool.annotations for tool in (await client.list_tools()).tools}

    found = asyncio.run(listed())
    assert found.keys() == TOOLS
    assert {name for name, item in found.items() if item.read_only_hint} == {
        "state", "limits", "picture", "preview", "plot"
    }  # fmt: skip
    assert not found["stop"].destructive_hint


def test_the_server_says_which_version_it_is_of() -> None:
    async def initialized() -> str:
        async with client_of("cam_beam", Noting()) as client:
            return client.server_info.version

    assert asyncio.run(initialized()) == metadata.version("hybrid_sysid_ros")


def test_a_command_arrives_as_it_was_given_and_its_reply_comes_back() -> None:
    desk = Noting()
    (reported,) = called(desk, ("preview", {"text": "go to 1 V"}))
    assert reported.structured_content["values"] == {"seconds": 2.0}
    (refused,) = called(desk, ("say", {"text": "hold 3"}))
    assert not refused.structured_content["accepted"]
    (stopped,) = called(desk, ("stop", {}))
    assert stopped.structured_content["line"]
    (latched,) = called(desk, ("stop", {"latch": True}))
    assert latched.structured_content["said"] == "emergency stop"
    assert desk.arrived == [("check", "go to 1 V"), ("say", "hold 3"), ("stop", ""), ("say", "emergency stop")]


@pytest.mark.parametrize(
    ("rig", "name", "given"),
    [
        ("cam_beam", "move", {"value": -1.25, "seconds": 2.0, "hold": 1e-3}),
        ("winged_cone", "move", {"value": 1e2, "output": "height", "relative": True, "pace": "slowly"}),
        ("flexible_joint", "swing", {"low": -5, "high": 5, "frequency": 0.5, "seconds": 4, "shape": "square"}),
        ("drill_string", "swing", {"low": 0, "high": 2, "frequency": 0.1, "seconds": 10, "output": "bit_speed"}),
        ("wheel_motor", "follow", {"name": "moves"}),
        ("cam_beam", "hold", {}),
    ],
)
def test_a_typed_tool_says_a_sentence_that_is_understood(rig: str, name: str, given: Mapping[str, Any]) -> None:
    desk = Noting()
    (reply,) = called(desk, (name, given), rig=rig)
    assert not reply.is_error
    ((_, text),) = desk.arrived
    assert len(grammar.read(text, Vocabulary.of(rigs.load(rig))).commands) == 1


def test_anything_but_what_the_schema_has_is_refused_before_it_arrives() -> None:
    desk = Noting()
    wrong: list[Mapping[str, Any]] = [{}, {"text": 3}, {"text": None}, {"command": "hold 3 V"}]
    moves: list[Mapping[str, Any]] = [{"value": "a"}, {"value": 1, "seconds": -1}, {"value": 1, "pace": "madly"}]
    assert all(reply.is_error for reply in called(desk, *(("say", given) for given in wrong)))
    assert all(reply.is_error for reply in called(desk, *(("move", given) for given in moves)))
    for output in ("velocity", ""):
        assert called(desk, ("move", {"value": 1, "output": output}), rig="winged_cone")[0].is_error
    assert called(desk, ("state", {}))[0].is_error
    assert called(desk, ("plot", {}))[0].is_error
    assert desk.arrived == []


def test_one_command_is_checked_at_a_time_and_a_stop_waits_for_none() -> None:
    desk, released = Noting(), Event()
    called(desk, *(("preview", {"text": f"go to {k} V"}) for k in range(5)))
    assert desk.most == 1

    class Waiting(Noting):
        """Checks until it is stopped."""

        def check(self, text: str) -> Reply:
            return Reply(text=text, accepted=released.wait(5.0), line="")

        def stop(self) -> Reply:
            released.set()
            return super().stop()

    checked, stopped = called(Waiting(), ("preview", {"text": "go to 1 V"}), ("stop", {}))
    assert checked.structured_content["accepted"]
    assert stopped.structured_content["accepted"]


def test_previews_and_the_state_come_as_pictures_too() -> None:
    pytest.importorskip("PIL", reason="needs Pillow: install hybrid_sysid_ros[mcp]")
    desk = Rehearsal(interpreter("cam_beam"))

    async def call() -> list[Any]:
        async with client_of("cam_beam", desk) as client:
            reply = await client.call_tool("preview", {"text": "go to 1 V then home"})
            assert "from 0 V (0 deg) to 1 V (1.3 deg)" in reply.structured_content["line"]
            assert (await client.call_tool("state", {})).structured_content["outputs"] == {"position [V]": 0.0}
            read = [await client.read_resource(uri) for uri in ("rig://cam_beam", "docs://commander", "report://last")]
            assert all(each.contents[0].text for each in read)
            return [(await client.call_tool(name, {})).content[0] for name in ("plot", "picture")]

    for picture in asyncio.run(call()):
        assert (picture.type, picture.mime_type) == ("image", "image/png")
