"""Random texts, and what a text may not do: move a rig's reference beyond its set-points, or faster than it can."""

from __future__ import annotations

from random import Random

import numpy as np

from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.extensions.commander.language.plan import LONGEST, POINTS
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability, ReferencePlan
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

WORDS = (
    "hold", "keep", "stay", "go", "move", "set", "ramp", "step", "jump", "swing", "oscillate", "wait", "pause",
    "follow", "repeat", "home", "stop", "to", "from", "between", "by", "and", "around", "at", "for", "in", "every",
    "within", "over", "slowly", "quickly", "gently", "up", "down", "raise", "lower", "then", "please", "the", "a",
    "it", "not", "don't", "if", "until", "zero", "one", "two", "three", "five", "ten", "minus", "half", "times",
    "periods", "again", "back", "forth", "with", "frequency", "amplitude",
)  # fmt: skip
LETTERS = "abcdefghijklmnopqrstuvwxyz ABCDEF0123456789.,;:!?'\"()[]{}<>=+-*/%$#@&|\\~^_`°±µé漢\n\t\0"
NUMBERS = ("0", "1", "-2", "3.5", "-0.1", "0.2", "1e9", "-1e300", "1e999", ".5", "12", "100", "-50", "0.001", "7")


def text(random: Random, vocabulary: Vocabulary) -> str:
    """Letters, words and quantities in any order, or a sentence that means something, with slips."""
    kind = random.random()
    if kind < 0.2:
        return "".join(random.choice(LETTERS) for _ in range(random.randint(0, 60)))
    if kind < 0.6:
        return " ".join(_word(random, vocabulary) for _ in range(random.randint(1, 14)))
    made = " then ".join(_sentence(random, vocabulary) for _ in range(random.randint(1, 3)))
    for _ in range(random.choice((0, 0, 1, 2, 4))):
        place = random.randint(0, max(0, len(made) - 1))
        made = (
            made[:place] + random.choice(("", random.choice(LETTERS), made[place : place + 1] * 2)) + made[place + 1 :]
        )
    return made


def _word(random: Random, vocabulary: Vocabulary) -> str:
    return random.choice(
        (random.choice(WORDS), random.choice(NUMBERS), _unit(random, vocabulary), random.choice(list(vocabulary.names)))
    )


def _unit(random: Random, vocabulary: Vocabulary) -> str:
    return random.choice((*vocabulary.units, "s", "Hz", "%", "deg/s", "min", "m/s", "rpm/s"))


def _value(random: Random, vocabulary: Vocabulary) -> str:
    output = vocabulary.outputs[random.choice(vocabulary.tracked)]
    level = random.uniform(1.3 * output.low, 1.3 * output.high)
    return f"{level:.3g} {output.unit}"


def _sentence(random: Random, vocabulary: Vocabulary) -> str:
    """One that means something, though maybe nothing that can be done."""
    value, other = _value(random, vocabulary), _value(random, vocabulary)
    seconds, hertz = 10.0 ** random.uniform(-3.0, 2.0), 10.0 ** random.uniform(-2.0, 2.0)
    return random.choice(
        (
            f"go to {value} {random.choice(('', 'slowly', 'quickly', f'in {seconds:.3g} s'))}",
            f"go by {value}",
            f"hold {value} for {seconds:.3g} s",
            f"ramp from {value} to {other} in {seconds:.3g} s",
            f"step to {value}",
            f"swing between {value} and {other} at {hertz:.3g} Hz for {seconds:.3g} s",
            f"step between {value} and {other} every {seconds:.3g} s",
            f"swing by {value} at {hertz:.3g} Hz",
            f"wait {seconds:.3g} s",
            "go home",
            f"follow {random.choice(list(vocabulary.rig.references) or ['moves'])}",
        )
    )


def planned(interpreter: Interpreter, said: str, start: Array) -> ReferencePlan | None:
    """The plan of a text from references ``start`` (outputs,); None where it is refused, or a stop. Raises whatever is
    no UserError of one line.
    """
    try:
        sentence = interpreter.read(said)
        return None if sentence.is_stop else interpreter.plan(sentence, start)
    except UserError as error:
        if "\n" in str(error):
            raise ValueError(f"{said!r}: a refusal of several lines") from error
        return None


def broken(plan: ReferencePlan, vocabulary: Vocabulary, ability: Ability) -> list[str]:
    """Limits that a plan does not keep."""
    found = [] if np.isfinite(plan.values).all() and np.isfinite(plan.times).all() else ["not a number"]
    found += [] if plan.duration <= LONGEST and len(plan.times) <= POINTS else ["too long"]
    found += [] if (np.diff(plan.times) > 0.0).all() else ["time runs backwards"]
    for k, output in enumerate(vocabulary.outputs):
        values = plan.values[:, k]
        if not output.tracked:
            found += [f"{output.name} moves"] if values.any() else []
            continue
        slack = 1e-6 * (output.high - output.low)
        if values.min() < output.low - slack or values.max() > output.high + slack:
            found.append(f"{output.name} beyond its set-points")
        speeds = np.abs(np.diff(values)) / np.diff(plan.times)
        if not plan.jumps and len(speeds) and speeds.max() > 1.001 * ability.speed[k] + slack:
            found.append(f"{output.name} too fast")
    return found
