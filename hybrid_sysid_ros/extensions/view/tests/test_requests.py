"""What a page may ask for: a rig's own things, within its limits, and nothing else."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from hybrid_sysid_ros.extensions.view.requests import POINTS, Fault, RequestMenu, SetPointRequest, read_request
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.errors import UserError

NONSENSE = [
    "",
    "{",
    "[]",
    "null",
    "7",
    '"stop"',
    "{}",
    '{"do": 1}',
    '{"do": ["stop"]}',
    '{"do": "exec"}',
    '{"do": "__import__"}',
    '{"do": "next", "more": 1}',
    '{"do": "next", "id": -1}',
    '{"do": "next", "id": "7"}',
    '{"do": "next", "id": true}',
    '{"do": "next", "id": 1' + "0" * 400 + "}",
    '{"do": "next", "id": 1' + "0" * 5000 + "}",
    '{"do": "set_point"}',
    '{"do": "set_point", "times": [0], "values": [[NaN]]}',
    '{"do": "set_point", "times": [0], "values": [[Infinity]]}',
    '{"do": "set_point", "times": [0], "values": [[1e999]]}',
    '{"do": "set_point", "times": [0], "values": [["1"]]}',
    '{"do": "set_point", "times": [0], "values": [[true]]}',
    '{"do": "set_point", "times": [0], "values": [[null]]}',
    '{"do": "set_point", "times": [0], "values": [1]}',
    '{"do": "set_point", "times": [0], "values": [[1' + "0" * 400 + "]]}",
    '{"do": "set_point", "times": 0, "values": [[0]]}',
    '{"do": "set_point", "times": [0], "values": [[0, 0]]}',
    '{"do": "set_point", "times": [0, 1], "values": [[0]]}',
    '{"do": "set_point", "times": [], "values": []}',
    '{"do": "set_point", "times": [1, 0], "values": [[0], [0]]}',
    '{"do": "set_point", "times": [0, 0], "values": [[0], [0]]}',
    '{"do": "set_point", "times": [-1], "values": [[0]]}',
    '{"do": "set_point", "times": [1e9], "values": [[0]]}',
    '{"do": "set_point", "times": [0], "values": [[1e6]]}',
    json.dumps({"do": "set_point", "times": [k / POINTS for k in range(POINTS + 1)], "values": [[0.0]] * (POINTS + 1)}),
    '{"do": "experiment", "kind": "../../etc/passwd"}',
    '{"do": "experiment", "kind": 3}',
    '{"do": "fault", "name": "fire", "on": true}',
    '{"do": "fault", "name": "brake", "on": 1}',
    '{"do": "policy", "policy": "mine"}',
    '{"do": "call", "service": "shutdown"}',
    '{"do": "record"}',
    '{"do": "record", "on": true, "path": "/tmp/bag"}',
    '{"do": "weight", "name": "policy_path", "values": [1]}',
    '{"do": "weight", "name": "rate_weight", "values": [-1]}',
    '{"do": "weight", "name": "rate_weight", "values": [1, 2]}',
    '{"do": "weight", "name": "rate_weight", "values": []}',
    "[" * 50_000,
    '{"do": ' + "[" * 900 + "]" * 900 + "}",
    '{"do": "next", "id": ' + '{"a": ' * 900 + "1" + "}" * 900 + "}",
]


@pytest.fixture(scope="module")
def offer(rig: Rig) -> RequestMenu:
    return RequestMenu.of(rig, ("constant", "sine"))


@pytest.mark.parametrize("text", NONSENSE, ids=lambda text: text[:40])
def test_nonsense_is_refused_in_a_line(text: str, offer: RequestMenu) -> None:
    with pytest.raises(UserError) as refused:
        read_request(text, offer)
    assert "\n" not in str(refused.value)


def test_bytes_are_refused(offer: RequestMenu) -> None:
    with pytest.raises(UserError, match="text"):
        read_request(b'{"do": "next"}', offer)


def test_a_set_point_is_read_as_it_is(offer: RequestMenu) -> None:
    asked = read_request('{"do": "set_point", "id": 4, "times": [0, 0.5], "values": [[1], [-2.5]]}', offer)
    assert asked == SetPointRequest(id=4, times=(0.0, 0.5), values=((1.0,), (-2.5,)))


def test_set_points_are_held_within_the_travel_and_twice_the_amplitude(rig: Rig, offer: RequestMenu) -> None:
    (output,) = offer.tracked
    assert (output.low, output.high) == (-8.0, 8.0)  # of 4 V; the travel ends at +-10 V
    wide = replace(rig, content={**rig.content, "nodes": {**rig.content["nodes"], "reference": {"amplitude": [10.0]}}})
    (output,) = RequestMenu.of(wide, ()).tracked
    assert (output.low, output.high) == pytest.approx((-9.6, 9.6))  # 2 % of 20 V before its ends


def test_the_faults_of_every_rig_are_parameters_of_its_plant() -> None:
    for name in ("cam_beam", "flexible_joint", "drill_string", "wheel_motor"):
        offer = RequestMenu.of(load(name), ())
        assert offer.faults
        assert read_request(json.dumps({"do": "fault", "name": next(iter(offer.faults)), "on": True}), offer) == Fault(
            name=next(iter(offer.faults)), on=True
        )


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({"fire": {"heat": 1.0}}, "faults.fire: heat is no parameter"),
        ({"fire": {"rate": 1.0}}, "faults.fire: rate is no parameter of the plant that may change"),
        ({"fire": {"sensor_out": 2.0}}, r"sensor_out is 2.0: it must be within \[0, 1\]"),
        ({"fire": {"brake": [1.0, 2.0, 3.0]}}, "brake has 3 numbers"),
        ({"fire": 3}, "needs parameters"),
    ],
)
def test_a_fault_that_is_none_is_reported_by_file_and_key(faults: dict[str, Any], words: str, rig: Rig) -> None:
    with pytest.raises(UserError, match=words):
        RequestMenu.of(replace(rig, content={**rig.content, "faults": faults}), ())
