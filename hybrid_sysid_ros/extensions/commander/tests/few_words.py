"""Sentences of few words, for the corpus: what people say who have read no page."""

from __future__ import annotations

from typing import Any

from hybrid_sysid_ros.extensions.commander.tests.readings import (
    BEAM,
    CONE,
    DRILL,
    HOME,
    JOINT,
    WHEEL,
    Refused,
    by,
    follow,
    go,
    ramp,
    step,
    swing,
    wait,
)  # fmt: skip

FEW_WORDS: list[tuple[str, str, Any]] = [
    (BEAM, "3 V", [go(3)]),
    (BEAM, "3 V?", Refused("a question, or a command")),
    (BEAM, "50 %", Refused("verb")),
    (BEAM, "up 1 V, then 2 V", Refused("verb")),
    (BEAM, "first 3 V, then -3 V", [go(3), go(-3)]),
    (BEAM, "go to 2,5 V", [go(2.5)]),
    (BEAM, "go to 2,500 mV", Refused("2.500 or 2500")),
    (BEAM, "if it is above 1 V go to 0", Refused("if it is so now, or as soon as it is")),
    (DRILL, "drill at 5 rad/s", [go(5)]),
    (CONE, "gain 100 m", [by(100, "height")]),
    (WHEEL, "set the gain to 5", Refused("commands ask for outputs")),
    (BEAM, "home in 5 s", [{"do": "home", "seconds": 5}]),
    (BEAM, "level the beam", [HOME]),
    (WHEEL, "level the wheel", Refused("nothing here has a position")),
    (WHEEL, "full speed", [go(400)]),
    (WHEEL, "go backwards full speed", [go(-400)]),
    (BEAM, "full speed", Refused("to where")),
    (WHEEL, "turn backwards at 150 rpm", [go(-150)]),
    (WHEEL, "backwards at -150 rpm", Refused("a value with its sign")),
    (CONE, "go backwards at 20 m/s", Refused("a value with its sign")),
    (WHEEL, "gire a menos cem rpm", [go(-100)]),
    (BEAM, "step to 1 V, then 2 V, 1 s each", [step(1, hold=1), step(2, hold=1)]),
    (BEAM, "1 V, 2 V and 3 V, 2 s each", [go(1, hold=2), go(2, hold=2), go(3, hold=2)]),
    (BEAM, "3 V for 5 s each", Refused("of what")),
    (CONE, "altitude... height 0.5 km please", [go(500, "height")]),
    (DRILL, "swing the speed between 2 and 4 rad/s at 0.1 Hz for 20 s", [swing(2, 4, 0.1, 20)]),
    (BEAM, "no 2 V", Refused("say")),  # Portuguese "no" is "at"
    (BEAM, "go back by 1 V", Refused("up or down")),
    (BEAM, "mova em 2 V", Refused("to that value, or by it")),
    (BEAM, "vá a menos de 2 V", Refused("diga um numero")),
    (CONE, "fly 100 m", Refused("to that value, or by it")),
    (BEAM, "go to three quarters of a volt", [go(0.75)]),
    (BEAM, "vá para um quarto de volt", [go(0.25)]),
    (BEAM, "go to 1½ V", [go(1.5)]),
    (BEAM, "do 5 cycles of ±2 V at 0.5 Hz", [swing(-2, 2, 0.5, 10)]),
    (CONE, "height up 100 m, speed down 10 m/s", [by(100, "height"), by(-10, "speed")]),
    (BEAM, "zero the beam", [HOME]),
    (BEAM, "settle at 2 V", [go(2)]),
    (BEAM, "over 10 seconds ramp to 3 V", [ramp(3, seconds=10)]),  # "in 10 seconds" it would begin then
    (BEAM, "up 1 V, wait 2 s, down 1 V", [by(1), wait(2), by(-1)]),
    (WHEEL, "100 rpm, wait 5 s, 50 rpm", [go(100), wait(5), go(50)]),
    (BEAM, "up 1 V, wait 2 s, 2 V", Refused("verb")),
    (JOINT, "follow steps twice", [follow("steps"), follow("steps")]),
]
