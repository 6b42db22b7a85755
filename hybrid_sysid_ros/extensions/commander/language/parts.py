"""Parts: a sentence's symbols, cut where another clause begins."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, PERCENT, TIME
from hybrid_sysid_ros.support.errors import UserError


def sentence_parts(found: Sequence[Symbol]) -> list[list[Symbol]]:
    """Symbols between marks, "then", with which a part may begin, and an "and" or a comma before a verb."""
    made: list[list[Symbol]] = [[]]
    listed = re.search("Qe(?!Q)|eR", "".join(symbol.kind for symbol in found)) is not None
    for k, symbol in enumerate(found):
        following = found[k + 1].kind if k + 1 < len(found) else ""
        before = "".join(each.kind for each in made[-1])
        if symbol.kind == "!":
            raise UserError(f"{symbol.text!r}: {symbol.value}")
        if symbol.text == "?" and before and not re.search("[VUwyMZz]", before):
            raise UserError("is that a question, or a command? say it with a verb, as in 'go to' or 'hold'")
        if symbol.text == ":" and [each.value for each in made[-1]] == ["repeat"]:
            raise UserError(
                "repeat what follows, or what was carried out before? say 'repeat' alone, or the parts twice"
            )
        ended = _is_wait(made[-1]) and following in tuple("UQTKO")
        ended = ended or (following == "V" and is_level(next(iter(made[-1]), None)))  # "60 rpm, wait 5 s, 50 rpm"
        if symbol.kind == "," and ended:
            made.append([])
        elif _waits(made[-1], symbol, following):
            made.append([symbol])
        elif symbol.kind == ";" or (symbol.kind in "j," and _begins(before, following, found[k + 1 :], listed)):
            made.append([symbol] if symbol.value in ("then", "while") else [])
        elif symbol.kind != ",":
            made[-1].append(symbol)
    return [part for part in made if part]


def _begins(before: str, following: str, rest: Sequence[Symbol], listed: bool) -> bool:
    """Whether an "and" or a comma begins another clause, by the letters before, the next one, and what comes then;
    listed: that values last so long each.
    """
    if re.search("U.*Q|Q.*U", before) and re.match("[KO]+o?U", "".join(symbol.kind for symbol in rest)):
        return True  # "height up 100 m, speed down 10 m/s"
    turns = following == "T" and rest[0].value == "back_to"
    if "TQ" in before and (
        turns or [symbol.kind for symbol in rest[:2]] == ["U", "T"]
    ):  # "and back to 0", "and down to 0"
        return True
    if following == "u" and "Q" in before:  # "hold 3 s, home"
        return True
    if following in ("V", "y", ";"):
        return any(letter in "VUOKTMu" for letter in before)
    if re.search("Q$" if listed else "Q.*RQ$", before) and following in ("Q", "T"):  # "1 m for 5 s, 2 m for 5 s"
        return is_level(next((symbol for symbol in rest if symbol.kind == "Q"), None))
    return following in ("Z", "z", "D") and any(symbol.kind in "VU" for symbol in rest)


def _is_wait(part: Sequence[Symbol]) -> bool:
    """Whether a part says to wait, and how long."""
    said = [symbol.value for symbol in part if symbol.kind == "V"]
    return said == ["wait"] and any(symbol.kind == "Q" for symbol in part)


def is_level(symbol: Symbol | None) -> bool:
    """Whether a quantity is neither a time nor a frequency, a count or a share."""
    unit = symbol.value[1] if symbol and symbol.kind == "Q" else None
    return unit is not None and unit.base not in (TIME, FREQUENCY, COUNT, PERCENT)


def _waits(part: Sequence[Symbol], verb: Symbol, following: str) -> bool:
    """Whether a verb needs no mark before it, which a transcript has none of: "go to 2 m wait 3 s go to 0"."""
    before = [symbol.value for symbol in part if symbol.kind == "V"]
    if verb.kind not in "Vy" or not before or not any(symbol.kind == "Q" for symbol in part):
        return False
    return verb.value == "wait" or before[-1] == "wait" or (verb.value == "hold" and following in ("R", "H"))
