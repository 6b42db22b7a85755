"""Parts: a sentence's symbols, cut where another clause begins."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, PERCENT, TIME
from hybrid_sysid_ros.support.errors import UserError

ORDERS = ("then", "while", "before", "after")
"""Words with which a part begins that say when it comes."""
MANNER = re.compile("(?:ramped|stepped|held)")
"""Verbs that say how what stands before them is gone to."""
SWUNG = frozenset({"swing", "square", "toggle", "triangle", "chirp"})
"""Verbs whose count is that of their periods."""


def sentence_parts(found: Sequence[Symbol]) -> list[list[Symbol]]:
    """Symbols between marks, "then", with which a part may begin, and an "and" or a comma before a verb."""
    found = [
        symbol for k, symbol in enumerate(found)
        if symbol.kind != "," or not {each.kind for each in (*found[k - 1 : k], *found[k + 1 : k + 2])} & {"j", ";"}
    ]  # fmt: skip
    made: list[list[Symbol]] = [[]]
    listed = re.search("Qe(?!Q)|eR", "".join(symbol.kind for symbol in found)) is not None
    for k, symbol in enumerate(found):
        following = found[k + 1].kind if k + 1 < len(found) else ""
        before, swung = "".join(each.kind for each in made[-1]), bool(SWUNG & {each.value for each in made[-1]})
        if symbol.kind == "," and re.fullmatch("[KOJ]+", before) and following in ("V", "y"):
            continue  # a name before a verb
        acts = following in tuple("VyUw") or (following == "J" and found[k + 1].text.endswith("ing"))
        named = {each.value for each in made[-1] if each.kind in "KO"}
        named_again = following in ("K", "O") and found[k + 1].value in named and not swung
        ahead = "".join(each.kind for each in found[k + 1 :])
        turns = re.search("U.*Q", before) and re.match("UO?[TY]?Q", ahead) and not swung
        if symbol.kind == "," and turns:  # "up 1 m, down 2 m"
            made.append([])
            continue
        if symbol.kind == "," and named_again and re.search("Q.*[Rr]Q", before):
            made.append([])  # "link at 1 m for 5 s, link at 2 m for 5 s"
            continue
        if symbol.value == "before" and not acts:
            raise UserError(
                f"{symbol.text!r}: nothing watches for that: say what comes first, and the other behind 'then'"
            )
        if symbol.kind == "D" and acts:  # "after climbing 100 m"
            symbol = Symbol(";", "after", symbol.text)
        if symbol.kind == "!":
            raise UserError(f"{symbol.text!r}: {symbol.value}")
        if symbol.text == "?" and before and not re.search("[VUwyMZz]", "".join(each.kind for each in found[:k])):
            raise UserError("is that a question, or a command? say it with a verb, as in 'go to' or 'hold'")
        if (
            symbol.kind == ","
            and before in ("Q", "Qo")
            and _is_count(made[-1][0])
            and is_level(found[k + 1] if following else None)
        ):
            made[-1:] = [made[-1][:1], []]  # "20 times (0 rpm, 2 s; 100 rpm, 2 s)"
            continue
        if symbol.text == ":" and re.fullmatch("V?J?[QS]", before) and _is_count(made[-1][-1]):
            made[-1] = made[-1][-1:]  # "three times: ...", "repeat 3 times: ..."
            made.append([])
            continue
        if symbol.text == ":" and [each.value for each in made[-1]] == ["repeat"]:
            raise UserError(
                "repeat what follows, or what was carried out before? say 'repeat' alone, or the parts twice"
            )
        counts = following == "Q" and _is_count(found[k + 1]) and all(each.kind == ";" for each in found[k + 2 : k + 3])
        if symbol.kind in ",j" and counts and "eQ" not in before and not SWUNG & {each.value for each in made[-1]}:
            made.append([])
            continue
        ended = _is_wait(made[-1]) and following in tuple("UQTKO")
        ended = ended or (following == "V" and is_level(next(iter(made[-1]), None)))  # "60 rpm, wait 5 s, 50 rpm"
        if symbol.kind == "," and re.search("M[bm]?$", before) and re.match(r"oQ|Q(?!o?[KO]?[U+M])", ahead):
            said = " ".join(each.text for each in (made[-1][-1], found[k + 1]))
            raise UserError(f"{said!r}: to that value, or by it? say 'to' or 'by' before it")
        dwelt = not swung and [_is_time(each) for each in made[-1][-2:]] == [False, True] and is_level(made[-1][-2])
        if symbol.kind == "," and (ended or (dwelt and following in tuple("QTUKOVyu"))):  # "10 rpm, 5 s, 20 rpm, 5 s"
            made.append([])
        elif len(made) == 2 and not made[0] and _leads(made[1]) and symbol.kind in "VyU" and "Q" in before:
            made.append([symbol])  # "after climbing 100 m accelerate by 10 m/s"
        elif _waits(made[-1], symbol, found[k + 1 : k + 3]):
            made.append([symbol])
        elif symbol.kind == ";" or (
            symbol.kind in "j," and _begins(before, following, found[k + 1 :], listed, swung=swung)
        ):
            made.append([symbol] if symbol.value in ORDERS else [])
        elif symbol.kind == "D" and "Q" in before and re.match("QH?,?[VyuU]", ahead):
            made.append([symbol])  # "raise it by 1 m, after 5 s go home": the delay is of what follows
        elif before == "Z" and made[-1][0].value[0] == "until" and symbol.kind not in ",j":
            made.append([symbol])  # what goes before lasts until then, and this comes behind it
        elif symbol.kind != "," or _parts_noun(made[-1], found[k + 1 :]):
            made[-1].append(symbol)
    return _in_order([part for part in made if part])


def _in_order(parts: list[list[Symbol]]) -> list[list[Symbol]]:
    """Parts as they come one after the other, "then" and "while" before those that begin with it. Raises UserError for
    what comes before or after nothing.
    """
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


def _leads(part: Sequence[Symbol]) -> bool:
    """Whether a part begins with "before", "after" or "while"."""
    return bool(part) and part[0].kind == ";" and part[0].value in ORDERS[1:]


def _parts_noun(before: Sequence[Symbol], rest: Sequence[Symbol]) -> bool:
    """Whether a comma says to which of two values a swing's noun belongs: "20 s, period 4 s", "4 s period, 20 s"."""
    left, right = "".join(each.kind for each in before[-2:]), "".join(each.kind for each in rest[:2])
    if re.search("Q[akfq]$", left):
        return right[:1] == "Q"
    return left[-1:] == "Q" and right[:1] in tuple("akfq")


def _begins(before: str, following: str, rest: Sequence[Symbol], listed: bool, *, swung: bool) -> bool:
    """Whether an "and" or a comma begins another clause, by the letters before, the next one, and what comes then;
    listed: that values last so long each; swung: that these letters are of a swing.
    """
    if swung and "Q" not in before and following == "V" and rest[0].value == "swing":
        return False  # "wiggle the heading: sine, 15 degrees"
    if re.search("U.*Q|Q.*U|^V[KO]$", before) and re.match("[KO]+o?U", "".join(symbol.kind for symbol in rest)):
        return True  # "height up 100 m, speed down 10 m/s"
    letters = "".join(symbol.kind for symbol in rest)
    if re.search("[VU].*Q", before) and re.match("IQ[Vy]", letters):  # "go to 1 m, in 3 s go to 2 m"
        return True
    turns = following == "T" and rest[0].value == "back_to"
    if "TQ" in before and (
        turns or [symbol.kind for symbol in rest[:2]] == ["U", "T"]
    ):  # "and back to 0", "and down to 0"
        return True
    if re.fullmatch("V?Z|V?z[KO]?T?Q", before) and following in tuple("VyUuTQKO"):  # "... still and go"
        return True
    led = [symbol.kind for symbol in rest[2:3]] not in ([], [";"])
    if led and "Q" in before and [symbol.kind for symbol in rest[:2]] == ["Q", "E"]:  # "and 5 s later to 0"
        return True
    if not swung and re.search("Q.*[Ud]|[Ud].*Q", before) and re.match("Q[UdM+]", letters):
        return True  # "100 m higher and 10 m/s faster"
    if following == "V" and rest[0].value == "repeat" and "Q" in before:  # "go to 1 m, then 0, repeat 3 times"
        return True
    if following == "u" and "Q" in before:  # "hold 3 s, home"
        return True
    if re.search("d.*Q|Q.*d", before) and following == "d" and "Q" in letters:  # "forward 1 m/s, backward 1 m/s"
        return True
    if following == "+" and "Q" in before and [symbol.kind for symbol in rest[1:2]] == ["Q"]:  # "and another 200"
        return True
    if following == "t" and len(rest) > 1 and rest[1].kind in "Vy":  # "and at the same time slow down"
        return True
    if following == "V" and rest[0].value in SWUNG and re.search("[Bp]", before) and "V" not in before:
        return False  # "between 3 and 5 m, sine, 20 s period"
    if following in ("V", "y") and MANNER.fullmatch(next(each.text for each in rest if each.kind == "V")):
        return False  # "2 m, ramped over 5 s"
    if following in ("V", "y") and re.search("Qe$", before):  # "1, 2 and 3 m, 5 s each, and return"
        return True
    if following in ("V", "y", ";"):
        return any(letter in "VUOKTMu" for letter in before)
    if re.search("B(?:[KO]o?)?Q$", before):
        return False  # "between 4 and 6 rad/s, 5 s each"
    if (
        not swung and re.search("Q$" if listed else "Q.*[Rr]Q$", before) and following in ("Q", "T", "W")
    ):  # "1 m for 5 s, 2 m for 5 s"
        return is_level(next((symbol for symbol in rest if symbol.kind == "Q"), None))
    return following in ("Z", "z", "D") and any(symbol.kind in "VUw" or _is_value(symbol) for symbol in rest[1:])


def _is_count(symbol: Symbol) -> bool:
    """Whether a quantity says how many times."""
    if symbol.kind == "S":
        return bool(symbol.value > 1.0)
    return symbol.kind == "Q" and symbol.value[1] is not None and symbol.value[1].base == COUNT


def _is_time(symbol: Symbol) -> bool:
    """Whether a quantity is a time."""
    return symbol.kind == "Q" and symbol.value[1] is not None and symbol.value[1].base == TIME


def _is_wait(part: Sequence[Symbol]) -> bool:
    """Whether a part says to wait, and how long."""
    said, given = ([symbol for symbol in part if symbol.kind == kind] for kind in "VQ")
    if [symbol.value for symbol in said] == ["hold"]:  # "stay 10 s, down to 0"
        return len(given) == 1 and _is_time(given[0])
    return [symbol.value for symbol in said] == ["wait"] and bool(given)


def is_level(symbol: Symbol | None) -> bool:
    """Whether a quantity is neither a time nor a frequency, a count or a share."""
    unit = symbol.value[1] if symbol and symbol.kind == "Q" else None
    return unit is not None and unit.base not in (TIME, FREQUENCY, COUNT, PERCENT)


def _is_value(symbol: Symbol) -> bool:
    """Whether a quantity may be one of an output: it has such a unit, or none."""
    return is_level(symbol) or (symbol.kind == "Q" and symbol.value[1] is None)


def _waits(part: Sequence[Symbol], verb: Symbol, rest: Sequence[Symbol]) -> bool:
    """Whether a verb needs no mark before it, which a transcript has none of: "go to 2 m wait 3 s go to 0"."""
    before = [symbol.value for symbol in part if symbol.kind == "V"]
    if verb.kind not in "Vyu" or not before or not any(symbol.kind == "Q" for symbol in part):
        return False
    if part[-1].kind == "Q" and not SWUNG & set(before) and "step" not in before:
        following = "".join(symbol.kind for symbol in rest)
        if verb.value == "home" or (verb.kind in "Vy" and re.match("V?T", following)):  # "go to 2 m go to 0 go home"
            return True
    if verb.value == "hold" and rest and (rest[0].kind in "RH" or _is_time(rest[0])):
        return True
    held = before[-1] == "hold" and _is_time(part[-1]) and part[-2].value == "hold"
    return verb.value == "wait" or before[-1] == "wait" or held
