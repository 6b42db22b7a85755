"""The tools for language models, in one process: the same checked commands, and nothing else."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

import pytest

pytest.importorskip("mcp", reason="needs mcp: install hybrid_sysid_ros[mcp]")

from mcp import Client

from hybrid_sysid_ros.extensions.commander.language.command_interface import CommandInterface, Reply
from hybrid_sysid_ros.extensions.commander.language.server import server
from hybrid_sysid_ros.rigs import rig as rigs


class Noting(CommandInterface):
    """Notes what arrives."""

    def __init__(self) -> None:
        self.arrived: list[tuple[str, str]] = []

    def say(self, text: str) -> Reply:
        self.arrived.append(("say", text))
        return Reply(text=text, accepted=False, line="3 of what? say '3 V'")

    def check(self, text: str) -> Reply:
        self.arrived.append(("check", text))
        return Reply(text=text, accepted=True, line="go to 1 V", values={"seconds": 2.0})

    def stop(self) -> Reply:
        self.arrived.append(("stop", ""))
        return Reply(text="stop", accepted=True, line="stopped")


def called(desk: CommandInterface, name: str, arguments: Mapping[str, Any]) -> Any:
    async def call() -> Any:
        async with Client(server(rigs.load("cam_beam"), desk)) as client:
            return await client.call_tool(name, dict(arguments))

    return asyncio.run(call())


def test_there_are_three_tools_and_none_confirms_or_arms() -> None:
    async def listed() -> set[str]:
        async with Client(server(rigs.load("cam_beam"), Noting())) as client:
            return {tool.name for tool in (await client.list_tools()).tools}

    assert asyncio.run(listed()) == {"check_command", "give_command", "stop"}


def test_a_command_arrives_as_it_was_given_and_its_reply_comes_back() -> None:
    desk = Noting()
    reported = called(desk, "check_command", {"text": "go to 1 V"}).structured_content
    assert reported == {"accepted": True, "line": "go to 1 V", "values": {"seconds": 2.0}}
    refused = called(desk, "give_command", {"text": "hold 3"}).structured_content
    assert not refused["accepted"]
    assert called(desk, "stop", {}).structured_content["accepted"]
    assert desk.arrived == [("check", "go to 1 V"), ("say", "hold 3"), ("stop", "")]


def test_anything_but_text_is_refused_before_it_arrives() -> None:
    desk = Noting()
    for arguments in ({}, {"text": 3}, {"text": None}, {"command": "hold 3 V"}):
        assert called(desk, "give_command", arguments).is_error
    assert desk.arrived == []
