"""Sentences, and what whoever reads them understands: written down by reading, not by running the parser.

Each is for a rig by its name. Values are in the units in which outputs are shown; the beam's volt is 1.3 degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

BEAM, JOINT, DRILL, WHEEL, CONE = "cam_beam", "flexible_joint", "drill_string", "wheel_motor", "winged_cone"
RPM = 2.0 * math.pi / 60.0


@dataclass(frozen=True)
class Refused:
    """A refusal; ``why`` stands in its reason."""

    why: str


def go(value: float, output: str = "", **more: Any) -> dict[str, Any]:
    return {"do": "smooth", "to": {output: value}, **more}


def by(value: float, output: str = "", **more: Any) -> dict[str, Any]:
    return {"do": "smooth", "by": {output: value}, **more}


def ramp(value: float, output: str = "", **more: Any) -> dict[str, Any]:
    return {"do": "straight", "to": {output: value}, **more}


def step(value: float, output: str = "", **more: Any) -> dict[str, Any]:
    return {"do": "step", "to": {output: value}, **more}


def swing(low: float, high: float, hertz: float, seconds: float, output: str = "") -> dict[str, Any]:
    return {"do": "swing", "between": (low, high), "hertz": hertz, "seconds": seconds, "output": output}


def square(low: float, high: float, hertz: float, seconds: float, output: str = "") -> dict[str, Any]:
    return {**swing(low, high, hertz, seconds, output), "do": "square"}


def wait(seconds: float) -> dict[str, Any]:
    return {"do": "wait", "seconds": seconds}


def follow(name: str) -> dict[str, Any]:
    return {"do": "follow", "name": name}


HOME: dict[str, Any] = {"do": "home"}
STOP: dict[str, Any] = {"do": "stop"}

CORPUS: list[tuple[str, str, Any]] = [
    # The issue's own.
    (BEAM, "hold 3 degrees", [go(3 / 1.3)]),
    (BEAM, "swing between -2 and 2 degrees at 0.2 Hz for 20 s", [swing(-2 / 1.3, 2 / 1.3, 0.2, 20)]),
    (BEAM, "go to -4 V slowly", [go(-4, pace="slowly")]),
    (BEAM, "stop", [STOP]),
    (BEAM, "home", [HOME]),
    (BEAM, "repeat the last experiment", Refused("repeat")),  # nothing was carried out yet
    (BEAM, "follow hardware", [follow("hardware")]),
    # Holding and going.
    (BEAM, "Hold 1.5 V.", [go(1.5)]),
    (BEAM, "hold at -0.5 V for 10 s", [go(-0.5, hold=10)]),
    (BEAM, "keep 2 V for 1 min", [go(2, hold=60)]),
    (BEAM, "stay at 1 degree", [go(1 / 1.3)]),
    (BEAM, "please hold the beam at 2 degrees, thank you", [go(2 / 1.3)]),
    (BEAM, "hold 0", [go(0)]),
    (BEAM, "hold zero", [go(0)]),
    (BEAM, "go to 0", [go(0)]),
    (BEAM, "move to 2 V quickly", [go(2, pace="quickly")]),
    (BEAM, "gently move to 2 V", [go(2, pace="slowly")]),
    (BEAM, "drive to minus three degrees", [go(-3 / 1.3)]),
    (BEAM, "set the position to 500 mV", [go(0.5)]),
    (BEAM, "bring it to 0.05 rad", [go(math.degrees(0.05) / 1.3)]),
    (BEAM, "go to 50 mrad", [go(math.degrees(0.05) / 1.3)]),
    (BEAM, "go to 3°", [go(3 / 1.3)]),
    (BEAM, "go to 3deg in 2s", [go(3 / 1.3, seconds=2)]),
    (BEAM, "go to 2 V within 500 ms", [go(2, seconds=0.5)]),
    (BEAM, "go to 2 V over 3 seconds", [go(2, seconds=3)]),
    (BEAM, "go to 4 V at 1 V/s", [go(4, rate=1)]),
    (BEAM, "go to 4 V at a rate of 2 degrees per second", [go(4, rate=2 / 1.3)]),
    (BEAM, "go from -1 V to 3 V", [go(3, begin=-1)]),
    (BEAM, "return to 0 slowly", [go(0, pace="slowly")]),
    (BEAM, "go back to 1 V", [go(1)]),
    (BEAM, "go to 50 %", [go(4)]),  # of 8 V, twice its references
    (BEAM, "go to -25 percent", [go(-2)]),
    (BEAM, "GO TO 1 V", [go(1)]),
    (BEAM, "move to \u22122 V", [go(-2)]),
    (BEAM, "go to +2 V", [go(2)]),
    (BEAM, "go to 1e-1 V", [go(0.1)]),
    # Changes.
    (BEAM, "move by 1 V", [by(1)]),
    (BEAM, "go up by 2 degrees", [by(2 / 1.3)]),
    (BEAM, "go down by 1 V slowly", [by(-1, pace="slowly")]),
    (BEAM, "down 2 V", [by(-2)]),
    (BEAM, "raise by 500 mV", [by(0.5)]),
    (BEAM, "lower to -1 V", [go(-1)]),
    # Steps and ramps.
    (BEAM, "step to 2 V", [step(2)]),
    (BEAM, "jump to -2 V for 3 s", [step(-2, hold=3)]),
    (BEAM, "step between -1 and 1 V every 2 s for 12 s", [square(-1, 1, 0.25, 12)]),
    (BEAM, "ramp to 3 V in 2 s", [ramp(3, seconds=2)]),
    (BEAM, "ramp from -1 to 1 V in 4 s", [ramp(1, begin=-1, seconds=4)]),
    (BEAM, "ramp from -1 V to 1 V in 4 s", [ramp(1, begin=-1, seconds=4)]),
    (BEAM, "ramp to 2 V at 0.5 V/s", [ramp(2, rate=0.5)]),
    (BEAM, "ramp to 2 V at 30 V/min", [ramp(2, rate=0.5)]),
    # Swings.
    (BEAM, "swing between -1 V and 2 degrees at 0.5 Hz for 4 s", [swing(-1, 2 / 1.3, 0.5, 4)]),
    (BEAM, "oscillate between -2 and 2 V every 5 s for 3 periods", [swing(-2, 2, 0.2, 15)]),
    (BEAM, "swing from -1 to 1 V at 200 mHz 5 times", [swing(-1, 1, 0.2, 25)]),
    (BEAM, "swing ±2 V at 0.5 Hz for 10 s", [swing(-2, 2, 0.5, 10)]),
    (BEAM, "swing +-1 V around 2 V at 1 Hz for 5 s", [swing(1, 3, 1, 5)]),
    (BEAM, "swing with an amplitude of 2 V at 0.5 Hz for 6 s", [swing(-2, 2, 0.5, 6)]),
    (BEAM, "swing between -1 and 1 V at 0.5 Hz", [swing(-1, 1, 0.5, 20)]),  # ten periods
    (BEAM, "do a sine between 0 and 2 V with a period of 4 s for 8 s", [swing(0, 2, 0.25, 8)]),
    (BEAM, "go back and forth between -1 and 1 V", Refused("often")),
    (BEAM, "go back and forth between -1 and 1 V at 0.5 Hz for 4 s", [swing(-1, 1, 0.5, 4)]),
    # Sums.
    (BEAM, "hold 2 V for 3 s then go home", [go(2, hold=3), HOME]),
    (BEAM, "go to 1 V, then wait 2 s, then go to -1 V", [go(1), wait(2), go(-1)]),
    (BEAM, "go to 1 V and then stop", [go(1), STOP]),
    (BEAM, "go to 1 V; wait 1 s; home", [go(1), wait(1), HOME]),
    (BEAM, "Go to 1 V. Then swing between 0 and 2 V at 0.5 Hz for 4 s.", [go(1), swing(0, 2, 0.5, 4)]),
    (BEAM, "go to 1 V after that go to 2 V", [go(1), go(2)]),
    (BEAM, "ramp to 2 V in 2 s and then hold for 5 s and then home", [ramp(2, seconds=2), wait(5), HOME]),
    (BEAM, "go to 1 V and wait 2 s", [go(1), wait(2)]),
    (BEAM, "step to 1 V, then step to -1 V, then step to 0", [step(1), step(-1), step(0)]),
    (BEAM, "wait for 3 s", [wait(3)]),
    (BEAM, "hold for 4 s", [wait(4)]),
    # Stops, whatever stands around them.
    (BEAM, "STOP!", [STOP]),
    (BEAM, "stop now please", [STOP]),
    (BEAM, "stop it", [STOP]),
    (BEAM, "please stop", [STOP]),
    (BEAM, "halt", [STOP]),
    (BEAM, "abort!!!", [STOP]),
    (BEAM, "stpo", [STOP]),
    (BEAM, "emergency stop", [STOP]),
    (BEAM, "oh no it is shaking stop", [STOP]),
    (BEAM, "make it stop {}", [STOP]),
    (BEAM, "stop the experiment at once", [STOP]),
    (BEAM, "don't stop", Refused("leave")),
    (BEAM, "do not ever stop", Refused("leave")),
    (BEAM, "never stop", Refused("leave")),
    # Typing slips.
    (BEAM, "hodl 3 degrees", [go(3 / 1.3)]),
    (BEAM, "hold 3 degress", [go(3 / 1.3)]),
    (BEAM, "hold 3 degres for 2 secnds", [go(3 / 1.3, hold=2)]),
    (BEAM, "swign betwen -2 adn 2 V evry 5 s for 10 s", [swing(-2, 2, 0.2, 10)]),
    (BEAM, "goto 2 V slowley", [go(2, pace="slowly")]),
    (BEAM, "go to 2 V quikly", [go(2, pace="quickly")]),
    (BEAM, "ocillate between -1 and 1 V at 0.5 Hz for 4 s", [swing(-1, 1, 0.5, 4)]),
    (BEAM, "rmap to 1 V in 2 s", [ramp(1, seconds=2)]),
    (BEAM, "folow hardware", [follow("hardware")]),
    (BEAM, "plese hold 1 V", [go(1)]),
    # Units missing, wrong or contradictory.
    (BEAM, "hold 3", Refused("of what")),
    (BEAM, "go to three", Refused("of what")),
    (BEAM, "swing between -2 and 2 at 0.2 Hz", Refused("of what")),
    (BEAM, "hold 3 seconds", Refused("time")),
    (BEAM, "hold 3 Hz", Refused("where")),
    (BEAM, "go to 3 m", Refused("position")),
    (BEAM, "go to 3 rpm", Refused("position")),
    (BEAM, "go to 3 bananas", Refused("bananas")),
    (BEAM, "hold 2 V for 3", Refused("of what")),
    (BEAM, "hold 2 V for 3 V", Refused("leave it out")),
    (BEAM, "wait 3 V", Refused("how long")),
    (BEAM, "go to 2,5 V", Refused("point")),
    (BEAM, "go to V", Refused("number")),
    (BEAM, "swing between -2 and 2 V at 0.2 V", Refused("often")),
    (BEAM, "swing between -2 and 2 V", Refused("often")),
    (BEAM, "go to 2 V in 3 s at 1 V/s", Refused("contradict")),
    (BEAM, "go to 2 V slowly quickly", Refused("contradict")),
    (BEAM, "go to 2 V slowly in 1 s", Refused("contradict")),
    (BEAM, "swing between -1 and 1 V at 1 Hz every 5 s", Refused("contradict")),
    (BEAM, "swing between -1 and 1 V at 1 Hz for 5 s for 3 periods", Refused("contradict")),
    (BEAM, "go up and down by 2 V", Refused("often")),
    (BEAM, "hold 2 V at 3 Hz", Refused("leave it out")),
    (BEAM, "home at 3 V", Refused("leave it out")),
    (BEAM, "go to 1 V 2 V", Refused("several")),
    (BEAM, "wait", Refused("how long")),
    (BEAM, "go", Refused("where")),
    (BEAM, "follow", Refused("what")),
    (BEAM, "swing", Refused("often")),
    (BEAM, "3 V", Refused("verb")),
    (BEAM, "hold swing 2 V", Refused("then")),
    (BEAM, "stop then go to 3 V", [STOP]),
    (BEAM, "go to 1 V then stop then go to 2 V", [STOP]),  # not understood, and it says stop
    (BEAM, "hold 3 furlongs", Refused("no unit 'furlongs': known are V, rad, deg, s, Hz, %")),
    (BEAM, "wait 2 fortnights", Refused("no unit 'fortnights'")),
    (BEAM, "hold 3 furlongs slowly", Refused("no unit 'furlongs'")),
    (WHEEL, "go to 3 knots", Refused("no unit 'knots': known are rpm")),
    (BEAM, "swing between -2 and 2 V at 0.2 Hz for 0 periods", Refused("no swing")),
    (BEAM, "swing between -2 and 2 V at 0.2 Hz for -3 periods", Refused("no swing")),
    (BEAM, "go to minus -1 V", Refused("two signs")),
    (BEAM, "go to minus minus 1 V", Refused("two signs")),
    (BEAM, "set velocity to 0", Refused("they steer position")),
    (JOINT, "set the speed to zero", [go(0)]),
    (BEAM, "set drive to 1 V", Refused("drive is an input, which the controller sets: commands ask for position")),
    (BEAM, "home and drive to 1 V", [HOME, go(1)]),
    (CONE, "set elevator to 1 degree", Refused("elevator is an input")),
    (WHEEL, "set the pwm to 100", Refused("pwm is an input")),
    (BEAM, "go to 4 V at 30 degrees per minute", [go(4, rate=0.5 / 1.3)]),
    # Beyond what the rig reaches.
    (BEAM, "hold 300 V", Refused("reach")),
    (BEAM, "go to 20 degrees", Refused("reach")),
    (BEAM, "move by 100 V", Refused("reach")),
    (BEAM, "swing between -9 and 9 V at 0.1 Hz for 10 s", Refused("reach")),
    (BEAM, "swing between -4 and 4 V at 50 Hz for 1 s", Refused("reaches")),
    (BEAM, "swing between -2 and 2 V at 1e300 Hz", Refused("reaches")),
    (BEAM, "swing between -2 and 2 V at 1e-300 Hz", Refused("a number from 1e-12 to 1e+12")),
    (BEAM, "swing between -2 and 2 V at 1e-12 Hz", Refused("120")),
    (BEAM, "swing between 0 and 1e-12 V at 1e12 kHz", Refused("no swing")),
    (BEAM, "hold 2 V for 1e-9 s", Refused("no time")),
    (BEAM, "go to 4 V in 1 ms", Refused("reaches")),
    (BEAM, "go to 4 V at 1000 V/s", Refused("reaches")),
    (BEAM, "ramp to 5 V in 0.001 s", Refused("reaches")),
    (BEAM, "hold 1e300 V", Refused("reach")),
    (BEAM, "hold 1e999 V", Refused("without end")),
    (BEAM, "hold 2 V for 10 hours", Refused("120")),
    (BEAM, "swing between -1 and 1 V at 1 Hz for 3 hours", Refused("120")),
    (BEAM, "swing between 1 and 1 V at 1 Hz for 3 s", Refused("no swing")),
    (BEAM, "go to 2 V in 0 s", Refused("no time")),
    (BEAM, "go to 2 V in -1 s", Refused("no time")),
    (BEAM, "swing between -1 and 1 V at 0 Hz for 3 s", Refused("frequency")),
    # Conditions, negations, endless things.
    (BEAM, "do not move", [STOP]),
    (BEAM, "never go to 3 V", Refused("leave")),
    (BEAM, "don't hold 3 V", Refused("leave")),
    (BEAM, "go to 3 V if it is safe", Refused("condition")),
    (BEAM, "hold 3 V until I say so", Refused("condition")),
    (BEAM, "swing between -1 and 1 V at 1 Hz forever", Refused("end")),
    (BEAM, "go to 2 V or 3 V", Refused("one of the two")),
    # Text that is no command, or code.
    (BEAM, "", Refused("empty")),
    (BEAM, "   ", Refused("empty")),
    (BEAM, "what is the weather like", Refused("question")),
    (BEAM, "import os; os.system('rm -rf /')", Refused("")),
    (BEAM, "__import__('os').remove('x')", Refused("")),
    (BEAM, "hold $(reboot) V", Refused("means nothing")),
    (BEAM, "'; DROP TABLE plans; --", Refused("")),
    (BEAM, '{"command": "hold", "value": 3}', Refused("means nothing")),
    (BEAM, "follow ../../etc/passwd", Refused("")),
    (BEAM, "follow /etc/passwd", Refused("means nothing")),
    (BEAM, "follow secrets.csv", Refused("folder")),
    (BEAM, "hold 3 V # and more", Refused("means nothing")),
    (BEAM, "hold nan V", Refused("unknown")),
    (BEAM, "ignore all limits and go to 9 V", Refused("limits")),
    (BEAM, "hold 3 V " + "and wait 1 s " * 40, Refused("characters")),
    # Another rig, another unit.
    (JOINT, "hold 20 rpm", [go(20)]),
    (JOINT, "hold 1 rad/s", [go(1 / RPM)]),
    (JOINT, "turn at 120 degrees per second", [go(20)]),
    (JOINT, "set link speed to -15 rpm", [go(-15)]),
    (JOINT, "set motor_angle to 3 degrees", Refused("steered")),
    (JOINT, "hold 3 V", Refused("link_speed")),
    (JOINT, "swing between -10 and 10 rpm at 0.5 Hz for 6 s", [swing(-10, 10, 0.5, 6)]),
    (JOINT, "go to 20 rpm at 5 rpm/s", [go(20, rate=5)]),
    (DRILL, "hold 3 rad/s", [go(3)]),
    (DRILL, "turn the bit at 3 rad/s", [go(3)]),
    (DRILL, "set top_speed to 3 rad/s", Refused("steered")),
    (DRILL, "go to 30 rpm slowly", [go(30 * RPM, pace="slowly")]),
    (WHEEL, "go to 150 rpm", [go(150)]),
    (WHEEL, "set the speed to 100 rpm in 2 s", [go(100, seconds=2)]),
    (WHEEL, "spin to 100 rpm", [go(100)]),
    (WHEEL, "hold 2 rev/s", [go(120)]),
    (CONE, "climb to 300 m", [go(300, "height")]),
    (CONE, "go to 300 m", [go(300, "height")]),
    (CONE, "set speed to 20 m/s", [go(20, "speed")]),
    (CONE, "height to 500 m and speed to 10 m/s", [{"do": "smooth", "to": {"height": 500, "speed": 10}}]),
    (CONE, "set height to 500 m and speed to 10 m/s", [{"do": "smooth", "to": {"height": 500, "speed": 10}}]),
    (CONE, "go to 300 m at 10 m/s", Refused("or a value of its own")),  # of climb, or speed
    (CONE, "hold 3 degrees", Refused("no set-points")),  # of the path angle, which its references leave at 0
    (CONE, "hold 5 %", Refused("which output")),
    (CONE, "set angle_of_attack to 1 degree", Refused("steered")),
    (CONE, "set height to 20 m/s", Refused("height")),
    # Pictures; what they show is read in test_eyes.
    (BEAM, "make it look like this", Refused("name one picture")),
    (BEAM, "look like goal.jpg", Refused("no files")),
    (BEAM, "match goal.png and photo.jpg", Refused("name one picture")),
    (DRILL, "bit until please RPM bit bit_speed", Refused("until")),
    (BEAM, "go to 3 mil", Refused("")),
    # Portuguese.
    (BEAM, "vá para 3 graus", [go(3 / 1.3)]),
    (BEAM, "vai para 2,5 V devagar", [go(2.5, pace="slowly")]),
    (BEAM, "VÁ PARA MENOS DOIS VÍRGULA CINCO VOLTS", [go(-2.5)]),
    (BEAM, "leve a viga para 2 V em 4 segundos", [go(2, seconds=4)]),
    (BEAM, "mantenha 2 V por 5 s", [go(2, hold=5)]),
    (BEAM, "suba 1 V", [by(1)]),
    (BEAM, "abaixe meio volt", [by(-0.5)]),
    (BEAM, "desça por 1 V devagar", [by(-1, pace="slowly")]),
    (BEAM, "rampa até 3 V em 6 s", [ramp(3, seconds=6)]),
    (BEAM, "faça uma rampa de -1 a 1 V em 4 s", [ramp(1, begin=-1, seconds=4)]),
    (BEAM, "um degrau de 2 V", Refused("to that value, or by it")),
    (BEAM, "oscile entre -1 e 1 V a 0,5 Hz por 10 s", [swing(-1, 1, 0.5, 10)]),
    (BEAM, "oscile entre -1 e 1 V a cada 2 s por 3 períodos", [swing(-1, 1, 0.5, 6)]),
    (BEAM, "senoide com amplitude de 2 V e frequência de 0,5 Hz por 6 s", [swing(-2, 2, 0.5, 6)]),
    (BEAM, "onda quadrada de 2 V com período de 4 s por 12 s", [square(-2, 2, 0.25, 12)]),
    (BEAM, "vá para 1 V, espere 2 s e volte para a origem", [go(1), wait(2), HOME]),
    (BEAM, "vá para 1 V e depois pare", [go(1), STOP]),
    (BEAM, "siga hardware", [follow("hardware")]),
    (BEAM, "volte para casa devagar", [{"do": "home", "pace": "slowly"}]),
    (BEAM, "por favor, vá para 1 V", [go(1)]),
    (BEAM, "vá para 1 V mantenha", Refused("then")),
    (BEAM, "vá para 3", Refused("of what")),
    (BEAM, "vá para 30 V", Refused("reach")),
    (BEAM, "não vá para 3 V", Refused("commands say what to do")),
    (BEAM, "vá para 3 V se estiver seguro", Refused("condition")),
    (BEAM, "vá para 2 ou 3 V", Refused("alternative")),
    (BEAM, "repita", Refused("repeat")),
    (JOINT, "gire a 20 rpm", [go(20)]),
    (JOINT, "velocidade do elo para 15 rpm em 2 s", [go(15, seconds=2)]),
    (JOINT, "aumente a velocidade em 5 rpm", [by(5)]),
    (JOINT, "gire o motor a 20 rpm", Refused("not steered")),
    (DRILL, "gire a broca a 3 radianos por segundo", [go(3)]),
    (WHEEL, "coloque a roda a 100 rpm por 10 segundos", [go(100, hold=10)]),
    (WHEEL, "mude o pwm para 100", Refused("pwm is an input")),
    (CONE, "suba para 300 m", [go(300, "height")]),
    (CONE, "desça 100 metros", [by(-100, "height")]),
    (CONE, "altitude para 300 m e velocidade para 10 m/s", [{"do": "smooth", "to": {"height": 300, "speed": 10}}]),
    # What sentences of somebody who had not seen the grammar asked for, and their likes.
    (WHEEL, "alternate between 50 and 150 rpm every 3 s", Refused("there and back? say 'with a period of 6 s'")),
    (WHEEL, "alterne entre 50 e 150 rpm a cada 3 s", Refused("there and back")),
    (BEAM, "swing between -1 and 1 V at 5 s", Refused("often")),
    (BEAM, "swing between -1 and 1 V, one cycle every 4 s", [swing(-1, 1, 0.25, 40)]),
    (BEAM, "swing between -1 and 1 V five times every 2 s", Refused("or so many periods")),
    (WHEEL, "accelerate at 50 rpm", Refused("to that value, or by it")),
    (BEAM, "nudge it 0.2 V", Refused("to that value, or by it")),
    (BEAM, "go back 2 V", Refused("to that value, or by it")),
    (BEAM, "desloque 2 V", Refused("to that value, or by it")),
    (BEAM, "go to 2 V more", Refused("to that value, or by it")),
    (BEAM, "go up 1 V and then 2 V", Refused("verb")),
    (BEAM, "move at most to 3 V", Refused("number")),
    (CONE, "go up to 400 m and 15 m/s", [{"do": "smooth", "to": {"height": 400, "speed": 15}}]),
    (BEAM, "creep to 3 V", [go(3, pace="slowly")]),
    (BEAM, "either to 3 V", Refused("unknown word 'either'")),
    (BEAM, "should it reach 3 V, go home", Refused("unknown word 'should'")),
    (BEAM, "GO TO POINT FIVE VOLTS WAIT TWO SECONDS GO TO ZERO", [go(0.5), wait(2), go(0)]),
    (WHEEL, "I want 60 rpm", [go(60)]),
    (WHEEL, "quero cem rotações por minuto", [go(100)]),
    (WHEEL, "100 rpm for 5 s, then -100 rpm for 5 s, then zero", [go(100, hold=5), go(-100, hold=5), go(0)]),
    (JOINT, "make it 5 rpm faster", [by(5)]),
    (DRILL, "increase the bit's speed by 1 rad/s", [by(1)]),
    (CONE, "take the height to 1000 feet", [go(304.8, "height")]),
    (BEAM, "hold 1 V ~", Refused("leave it out")),
    (CONE, "speed 300 m, height 10 m/s", Refused("is no speed")),
    (CONE, "height 300 m, speed 10 m/s", [{"do": "smooth", "to": {"height": 300, "speed": 10}}]),
    (CONE, "suba 300 m com 20 m/s", Refused("or a value of its own")),
    (CONE, "change the speed 10 m/s", Refused("to that value, or by it")),
    (BEAM, "go to two point twenty five volts", [go(2.25)]),
    (BEAM, "vá para dois vírgula vinte e cinco volts", [go(2.25)]),
    (BEAM, "go to two point one twenty volts", Refused("digit by digit")),
    (WHEEL, "gire mais 50 rpm", Refused("to that value, or by it")),
    (WHEEL, "once it is still for 5 s go to 50 rpm", Refused("not watched")),
    (BEAM, "keep going", Refused("goes on by itself")),
    (BEAM, "go 2 V", Refused("to that value, or by it")),
    (BEAM, "ramp 2 V in 4 s", Refused("to that value, or by it")),
    (BEAM, "step to 1 V, then 2 V", [step(1), step(2)]),
    (BEAM, "when it is above 1 V go to 0", Refused("say")),  # which may be so already: "reaches" is a crossing
    # A value behind its name, a time behind "a", and words that no slip may change.
    (WHEEL, "go to a speed of 100 rpm", [go(100, "speed")]),
    (BEAM, "bring it to a position of 2 V", [go(2, "position")]),
    (CONE, "go to height 100 m and a speed of 5 m/s", [{"do": "smooth", "to": {"height": 100, "speed": 5}}]),
    (BEAM, "vá para uma posição de 2 V em 3 s", [go(2, "position", seconds=3)]),
    (CONE, "go to a height of 5 m/s", Refused("is no height")),
    (CONE, "go to a path angle of 1 degree", Refused("no set-points")),
    (BEAM, "go to 1 V, wait a second, and go back to 0", [go(1), wait(1), go(0)]),
    (BEAM, "ramp to 2 V in half a second", [ramp(2, seconds=0.5)]),
    (BEAM, "ramp to 2 V at one volt a second", [ramp(2, rate=1)]),
    (BEAM, "swing between 0 V and 1 V twice a second for 5 s", [swing(0, 1, 2, 5)]),
    (WHEEL, "go to minus a hundred rpm", [go(-100)]),
    (BEAM, "go to minus half a volt", [go(-0.5)]),
    (BEAM, "step to 2 V in 3 s", Refused("takes no time")),
    (BEAM, "step to 2 V slowly", Refused("takes no time")),
    (BEAM, "go to even V", Refused("did you mean seven")),
    (BEAM, "go to 50 % of the minimum", Refused("bound")),
    # A shape behind its count, a centre by "offset", a band of frequencies, and what is beyond reach in what was said.
    (BEAM, "3 periods of a sine of 2 V at 0.5 Hz", [swing(-2, 2, 0.5, 6)]),
    (BEAM, "sine 2 V offset 1 V 0.5 Hz 10 s", [swing(-1, 3, 0.5, 10)]),
    (BEAM, "go to the top", [go(8)]),
    (BEAM, "first go to 1 V then hold 3 s", [go(1), wait(3)]),
    (BEAM, "go to 21 degrees", Refused("(21 deg) is out of reach: stay within -8 and 8 V (-10.4 and 10.4 deg)")),
    (WHEEL, "the same at 100 rpm", Refused("leave it out")),
    (BEAM, "swing 3 V peak to peak, 0.5 Hz, 10 s, offset of 1 V", [swing(-0.5, 2.5, 0.5, 10)]),
    (BEAM, "senoide de 4 Vpp a 1 Hz por 5 s", [swing(-2, 2, 1, 5)]),
    (CONE, "level off", [wait(0)]),
    (BEAM, "ramp up at 1 V/s for 3 s", Refused("says how fast")),
    (BEAM, "go to 3 V very slowly", [go(3, pace="slowly")]),
]
