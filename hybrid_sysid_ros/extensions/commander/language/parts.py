"""Parts: the marks and the verbs at which a sentence may be cut, and the order in which its parts come."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, PERCENT, TIME
from hybrid_sysid_ros.support.errors import UserError

ORDERS = ("then", "while", "before", "after")
"""Words with which a part begins that say when it comes."""
SWUNG = frozenset({"swing", "square", "toggle", "triangle", "chirp"})
"""Verbs whose count is that of their periods."""


class Boundary(NamedTuple):
    """A place between two symbols at which a part may end."""

    end: int
    """Of the part before."""
    begin: int
    """Of the part behind, past the mark."""
    cut: float
    """What it costs to cut here."""
    keep: float
    """What it costs not to."""


def boundaries(found: Sequence[Symbol]) -> list[Boundary]:
    """Those of a sentence, in their order: a mark or a "then" always parts; a comma or an "and" does before a verb, and
    elsewhere if need be; a verb, a delay or a condition without a mark, as in a transcript, only if need be.
    """
    made: list[Boundary] = []
    letters = "".join(symbol.kind for symbol in found)
    for k, symbol in enumerate(found):
        before = letters[k - 1] if k else ","
        if symbol.kind == ";":
            made.append(Boundary(k, k if symbol.value in ORDERS else k + 1, 0.0, float("inf")))
        elif symbol.kind in ",j":
            begins = acts(found[k + 1 : k + 2]) or re.match("[DZz+]|[IiL]Q[Vyu]", letters[k + 1 :])
            held = 1.5 * bool(re.search("[Rr]Q$", letters[:k]))
            made.append(Boundary(k, k + 1, 0.0, 2.0) if begins else Boundary(k, k + 1, 1.0, held))
        elif (symbol.kind in "DZz" and before not in ",j;") or before == "Z":
            made.append(Boundary(k, k, 1.5, 2.0 * bool(re.match("(?:DQ|z[KO]?T?Q)[VyuOKUTdQ]", letters[k:]))))
        elif before not in ",j;y" and (symbol.value == "wait" or (before in "QHe" and symbol.kind in "Vyu")):
            turns = letters[k : k + 2] == "VS"  # "25 rpm the other way"
            if (
                symbol.value not in ("repeat", "halt")
                and not turns
                and not re.search("(?:D|z[KO]?T?|[,j;][IiL])Q$", letters[:k])
            ):
                made.append(Boundary(k, k, 1.5, 2.0))
    return made


def acts(ahead: Sequence[Symbol]) -> bool:
    """Whether the first of some symbols says to do something."""
    return any(each.kind in "VyUuw" or (each.kind == "J" and each.text.endswith("ing")) for each in ahead[:1])


def marked(found: Sequence[Symbol]) -> list[Symbol]:
    """Symbols without marks that say nothing beside another one; what is to be counted or done first is marked so.
    Raises UserError for words that no command has.
    """
    kinds = [symbol.kind for symbol in found]
    given = [
        symbol for k, symbol in enumerate(found)
        if symbol.kind != "," or not {*kinds[max(0, k - 1) : k], *kinds[k + 1 : k + 2]} & {"j", ";"}
    ]  # fmt: skip
    made: list[Symbol] = []
    for k, symbol in enumerate(given):
        following = given[k + 1 : k + 2]
        begin = max((j + 1 for j, each in enumerate(made) if each.kind == ";"), default=0)
        part = made[begin:]
        before, ahead = ("".join(each.kind for each in symbols) for symbols in (part, given[k + 1 :]))
        if symbol.kind == "!":
            raise UserError(f"{symbol.text!r}: {symbol.value}")
        if symbol.value == "before" and not acts(following):
            raise UserError(
                f"{symbol.text!r}: nothing watches for that: say what comes first, and the other behind 'then'"
            )
        if symbol.text == "?" and before and not re.search("[VUwyMZz]", "".join(each.kind for each in made)):
            raise UserError("is that a question, or a command? say it with a verb, as in 'go to' or 'hold'")
        if symbol.text == ":" and [each.value for each in part] == ["repeat"]:
            raise UserError(
                "repeat what follows, or what was carried out before? say 'repeat' alone, or the parts twice"
            )
        heads = symbol.text == ":" or (symbol.kind == "," and is_level(next(iter(following), None)))
        if symbol.kind == "," and re.search("M[bm]?$", before) and re.match("oQ|Q(?!o?[KO]?[U+M])", ahead):
            said = f"{part[-1].text} {given[k + 1].text}"
            raise UserError(f"{said!r}: to that value, or by it? say 'to' or 'by' before it")
        if heads and re.fullmatch("V?J?[QS]o?", before) and (counts := [each for each in part if is_count(each)]):
            made[begin:] = [*counts, Symbol(";", ":", ":")]  # "three times: ...", "repeat 3 times: ..."
        elif symbol.kind == "V" and before.endswith("Q") and re.match("U(?:$|[,;j])", ahead):
            continue  # "2 m lower"
        elif symbol.kind == "D" and acts(following):
            made.append(Symbol(";", "after", symbol.text))  # "after climbing 100 m"
        else:
            made.append(symbol)
    return made


def in_order(parts: Sequence[list[Symbol]]) -> list[list[Symbol]]:
    """Parts as they come one after the other, "then" and "while" before those that begin with it. Raises UserError for
    what comes before or after nothing.
    """
    parts = [part for part in parts if part]
    if parts and parts[0][0].value in ("before", "while") and parts[0][0].kind == ";":  # "before going home, wait 5 s"
        if len(parts) < 2:
            raise UserError(f"{parts[0][0].text!r} what? say the parts one after the other, joined by 'then'")
        mark, first = parts[0][0], parts[0][1:]
        parts[:2] = [parts[1], [mark, *first]] if mark.value == "before" else [first, [mark, *parts[1]]]
    late = [k for k, part in enumerate(parts) if part[0].kind == ";" and part[0].value == "after"]
    for k in late:
        if k > 1 or len(late) > 1:
            raise UserError("which part comes first? say them one after the other, joined by 'then'")
        parts[k] = parts[k][1:]
        parts[: k + 1] = [parts[k], *parts[:k]]  # "go home after climbing 100 m"
    return [
        [Symbol(";", "then", part[0].text), *part[1:]] if part[0].kind == ";" and part[0].value == "before" else part
        for part in parts if [symbol.kind for symbol in part] != [";"]
    ]  # fmt: skip


def is_count(symbol: Symbol) -> bool:
    """Whether a quantity says how many times."""
    if symbol.kind == "S":
        return bool(symbol.value > 1.0)
    return symbol.kind == "Q" and symbol.value[1] is not None and symbol.value[1].base == COUNT


def is_level(symbol: Symbol | None) -> bool:
    """Whether a quantity is neither a time nor a frequency, a count or a share."""
    unit = symbol.value[1] if symbol and symbol.kind == "Q" else None
    return unit is not None and unit.base not in (TIME, FREQUENCY, COUNT, PERCENT)
