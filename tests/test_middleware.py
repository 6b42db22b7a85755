"""What Fast DDS is told: the file that it is given, and what comes of it."""

import os
from xml.etree import ElementTree

import pytest

from hybrid_sysid_ros.nodes import middleware

SPACE = {"dds": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}


def seconds(element: ElementTree.Element) -> float:
    return float(element.findtext("dds:sec", "0", SPACE)) + 1e-9 * float(element.findtext("dds:nanosec", "0", SPACE))


def test_a_node_announces_itself_while_it_starts_and_often_afterwards():
    """More often than by default: 5 times in .5 s, then every 3 s, which a lease of 20 s allows for."""
    profile = ElementTree.parse(middleware.PROFILES).getroot().find("dds:participant", SPACE)
    assert profile is not None
    assert profile.get("is_default_profile") == "true"
    initial = profile.find(".//dds:initialAnnouncements", SPACE)
    assert initial is not None
    count, period = int(initial.findtext("dds:count", "", SPACE)), initial.find("dds:period", SPACE)
    assert period is not None
    assert count * seconds(period) >= 1.0
    again = profile.find(".//dds:leaseAnnouncement", SPACE)
    assert again is not None
    assert 0.1 <= seconds(again) <= 1.0


@pytest.mark.parametrize("variable", middleware.VARIABLES)
def test_a_file_of_the_user_s_own_stays(monkeypatch, variable):
    monkeypatch.setattr(os, "environ", environment := {variable: "mine.xml"})
    middleware.prepare_middleware()
    assert environment == {variable: "mine.xml"}


def test_without_one_it_is_this_package_s(monkeypatch):
    monkeypatch.setattr(os, "environ", environment := dict.fromkeys(middleware.VARIABLES, ""))
    middleware.prepare_middleware()
    assert {environment[name] for name in middleware.VARIABLES} == {str(middleware.PROFILES)}


@pytest.mark.parametrize("kind", ["data_reader", "data_writer"])
def test_no_place_of_a_history_keeps_the_memory_of_a_large_message(kind):
    """What comes of it is measured by ``python -m benchmarks.faults "a million names"``."""
    profile = ElementTree.parse(middleware.PROFILES).getroot().find(f"dds:{kind}", SPACE)
    assert profile is not None
    assert profile.get("is_default_profile") == "true"
    assert profile.findtext("dds:historyMemoryPolicy", "", SPACE) == "DYNAMIC"
