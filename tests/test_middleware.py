"""What Fast DDS is told: the file that it is given, and what comes of it."""

import os
import subprocess
import sys
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from std_msgs.msg import Float64MultiArray

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
    monkeypatch.delenv(middleware.WHOLE, raising=False)
    for name in middleware.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, "mine.xml")
    middleware.prepare()
    assert {os.environ.get(name) for name in middleware.VARIABLES} == {"mine.xml", None}
    assert middleware.WHOLE not in os.environ


def test_without_one_it_is_this_package_s(monkeypatch):
    monkeypatch.delenv(middleware.WHOLE, raising=False)
    for name in middleware.VARIABLES:
        monkeypatch.setenv(name, "")
    middleware.prepare()
    assert {os.environ[name] for name in middleware.VARIABLES} == {str(middleware.PROFILES)}


LISTENER = """
import os
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray
from hybrid_sysid_ros.nodes import middleware

def hear(data):
    with open("/proc/self/statm") as file:
        print(int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") * 1e-6, flush=True)

middleware.prepare()
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(Float64MultiArray, "values", hear, QoSProfile(depth=1000), raw=True)
rclpy.spin(node)
"""
"""Tells its resident memory at each message [MB]."""


def test_large_messages_leave_nothing_behind(bench, domain, monkeypatch):
    """Without the profiles, some of the places of a reader's history keep the memory of one: 16 to 40 MB."""
    for name in (*middleware.VARIABLES, middleware.WHOLE):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("PYTHONWARNINGS", "ignore")
    small, large = (Float64MultiArray(data=[0.0] * size) for size in (10, 500_000))
    publisher = bench.probe.create_publisher(Float64MultiArray, "/values", 100)
    with subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout is not None
        bench.until(publisher.get_subscription_count)
        memory = []
        for _ in range(20):
            messages = [*[small] * 9, large]  # which takes whatever place the small ones have left it
            for message in messages:
                publisher.publish(message)
            memory += [float(listener.stdout.readline()) for _ in messages]
        listener.kill()
    assert memory[-1] - memory[20] < 10.0
