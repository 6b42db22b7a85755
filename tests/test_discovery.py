"""How nodes find one another: the file that Fast DDS is given."""

import os
from xml.etree import ElementTree

import pytest

from hybrid_sysid_ros.nodes import discovery

SPACE = {"dds": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}


def seconds(element: ElementTree.Element) -> float:
    return float(element.findtext("dds:sec", "0", SPACE)) + 1e-9 * float(element.findtext("dds:nanosec", "0", SPACE))


def test_a_node_announces_itself_while_it_starts_and_often_afterwards():
    """More often than by default: 5 times in .5 s, then every 3 s, which a lease of 20 s allows for."""
    profile = ElementTree.parse(discovery.PROFILES).getroot().find("dds:participant", SPACE)
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


@pytest.mark.parametrize("variable", discovery.VARIABLES)
def test_a_file_of_the_user_s_own_stays(monkeypatch, variable):
    for name in discovery.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, "mine.xml")
    discovery.hasten()
    assert {os.environ.get(name) for name in discovery.VARIABLES} == {"mine.xml", None}


def test_without_one_it_is_this_package_s(monkeypatch):
    for name in discovery.VARIABLES:
        monkeypatch.setenv(name, "")
    discovery.hasten()
    assert {os.environ[name] for name in discovery.VARIABLES} == {str(discovery.PROFILES)}
