"""Turns of speech, by their kinds: what people add to a command, or leave out of it."""

from __future__ import annotations

from typing import Any

from hybrid_sysid_ros.extensions.commander.tests.readings import (
    BEAM,
    CONE,
    DRILL,
    JOINT,
    STOP,
    WHEEL,
    Refused,
    by,
    follow,
    go,
    ramp,
    square,
    swing,
    wait,
)

TURNS_OF_SPEECH: list[tuple[str, str, Any]] = [
    # Third persons, gerunds, passives.
    (BEAM, "I want that the beam goes to 3 V and stays there", [go(3), wait(0)]),
    (BEAM, "it has to be raised by 1 V", [by(1)]),
    (BEAM, "would you mind moving it to 2 V", [go(2)]),
    (BEAM, "get it swinging between -1 and 1 V at 0.2 Hz", [swing(-1, 1, 0.2, 50)]),
    (BEAM, "let the reference be a square wave between 0 and 1 V with a period of 10 s", [square(0, 1, 0.1, 100)]),
    # Of somebody who thinks aloud.
    (BEAM, "ok so, um, go to 2 V", [go(2)]),
    (BEAM, "um, go to 2 V", [go(2)]),
    (BEAM, "actually go to 2 V", [go(2)]),
    (BEAM, "go to 1 V, actually 2 V", Refused("actually")),
    (BEAM, "go to 2 V instead", [go(2)]),
    (BEAM, "go to 1 V then 2 V instead", Refused("instead")),
    (BEAM, "beam, go to 2 V", [go(2)]),
    (JOINT, "10 rpm. Slowly.", [go(10, pace="slowly")]),
    # Numbers and times.
    (CONE, "climb one two zero metres", [by(120, "height")]),
    (WHEEL, "five zero rpm", [go(50)]),
    (BEAM, "two tenths of a volt up", [by(0.2)]),
    (BEAM, "stay at 2 V for 1 min 30 s", [go(2, hold=90)]),
    (BEAM, "stay at 2 V for a minute and 30 seconds", [go(2, hold=90)]),
    (BEAM, "take 5 seconds to go to 2 V", [go(2, seconds=5)]),
    (BEAM, "stay at 2 V a minute", [go(2, hold=60)]),
    (BEAM, "give it 5 s to settle, then go to 1 V", [wait(5), go(1)]),
    (BEAM, "go to 1 V and 5 s later to 2 V", [go(1), wait(5), go(2)]),
    (BEAM, "go to 2 V hold 5 s go to 1 V", [go(2), wait(5), go(1)]),
    # Ends of the range.
    (BEAM, "all the way down", [go(-8)]),
    (BEAM, "vá até o topo", [go(8)]),
    (WHEEL, "minimum speed", Refused("backwards, or at rest")),
    (BEAM, "swing over the full range at 0.01 Hz for 100 s", [swing(-8, 8, 0.01, 100)]),
    # What leaves no doubt, and what does.
    (WHEEL, "accelerate until 100 rpm", [go(100)]),
    (BEAM, "hold until 1 V", Refused("and then what")),
    (CONE, "climb 100 m at 2 m/s", [by(100, "height", rate=2)]),
    (CONE, "speed 4610", [go(4610 - 4590.29, "speed")]),
    (BEAM, "apply a step of 1 V", [{**by(1), "do": "step"}]),
    (BEAM, "apply 1 V", Refused("the controller sets the inputs")),
    (BEAM, "aplique 1 V", Refused("controlador")),
    (DRILL, "slow the bit down by 0.2 rad/s", Refused("turns it around")),
    (WHEEL, "go to 50 rpm simultaneously", Refused("simultaneously")),
    (CONE, "height 100 m and speed 10 m/s at the same time", [{"do": "smooth", "to": {"height": 100, "speed": 10}}]),
    (BEAM, "go to 1 V and go to 2 V at the same time", Refused("at the same time")),
    (BEAM, "go to 20 V", Refused("the nearest is 8 V")),
    # As Brazilians speak.
    (BEAM, "opa, beleza, vai pra 2 V", [go(2)]),
    (BEAM, "tem como ir para 2 V?", [go(2)]),
    (BEAM, "a referência deve ser 2 V", [go(2)]),
    (BEAM, "oscile um volt para cada lado a 0,2 Hz", [swing(-1, 1, 0.2, 50)]),
    (BEAM, "sobe mais um pouco", [by(0.4)]),
    (WHEEL, "75% da velocidade máxima", [go(300)]),
    (JOINT, "gire para o outro lado a 20 rpm", [go(-20)]),
    (CONE, "volte à altura original", [go(0, "height")]),
    (CONE, "oscile a altura em 50 m com período de 60 s", [swing(-50, 50, 1 / 60, 480, "height")]),
    (BEAM, "can it go to 3 V?", Refused("")),
    (JOINT, "reverse to 10 rpm", Refused("backwards, or around")),
    (BEAM, "larger position", Refused("last swing")),
    (BEAM, "a bit more", Refused("more of what")),
    (BEAM, "two volts ten seconds", Refused("in that time, or for so long")),
    # Lists, and what lasts how long.
    (JOINT, "go 10, 20, 30 rpm with 5 s each", [go(10, hold=5), go(20, hold=5), go(30, hold=5)]),
    (JOINT, "alternate between 30 and -30 rpm, 5 s each", [square(30, -30, 0.1, 100)]),
    (JOINT, "up to 50 rpm in 10 s, stay 10 s, down to 0 in 10 s", [go(50, seconds=10), wait(10), go(0, seconds=10)]),
    (JOINT, "decelerate to rest in 5 s", [go(0, seconds=5)]),
    (CONE, "decelerate to rest in 5 s", [STOP]),
    (WHEEL, "sweep speed from 50 to 150 rpm over 20 s", [ramp(150, begin=50, seconds=20)]),
    (WHEEL, "repeat moves twice", [follow("moves"), follow("moves")]),
    (CONE, "descend and maintain 33500 m", [go(33500 - 33528, "height")]),
    (CONE, "climb 100 m and accelerate by 10 m/s together", [{"do": "smooth", "by": {"height": 100, "speed": 10}}]),
]
