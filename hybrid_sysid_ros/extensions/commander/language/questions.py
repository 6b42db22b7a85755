"""Questions: texts that ask where the rig is, and the answer. They move nothing."""

from __future__ import annotations

import re
from functools import cache

from hybrid_sysid_ros.extensions.commander.language.command_interface import RigState
from hybrid_sysid_ros.extensions.commander.language.lexicon import LANGUAGES, Lexicon, lexicon
from hybrid_sysid_ros.extensions.commander.language.stops import folded, stop_in
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.set_points import set_point_ranges

ENDS = re.compile(r"[.,;:!?\n]|\b(?:then|and|ent[aã]o|e)\b", re.IGNORECASE)
"""Of parts of a text, each of which may ask or order something."""
SET = re.compile(r"\bset\s+(?:to|at)\W*$", re.IGNORECASE)
"""What a question may end with, which orders nothing there: "what are the inputs set to?"."""
ORDERS = frozenset("VUMu;")
"""Kinds of symbols by which a part that begins with no question orders something."""


def is_question(text: str) -> bool:
    """Whether a text asks something, in one of the languages, and orders nothing: a value or a verb beside a question
    could be meant as a command, and a stop is one.
    """
    if stop_in(text):
        return False
    bare = "?" in text  # "position?"
    parts = [words for part in ENDS.split(SET.sub("", text)) if (words := re.findall(r"[^\W_]+", folded(part)))]
    return any(_asks(parts, lexicon(language), bare=bare) for language in LANGUAGES)


def _asks(parts: list[list[str]], language: Lexicon, *, bare: bool) -> bool:
    numbers = {*language.table["numbers"], *language.table["signs"]} - {"um", "uma", "one"}
    if any(word in numbers or word[0].isdigit() for words in parts for word in words):
        return False
    asked = [_begins(words, language) for words in parts]
    rest = [word for words, asks in zip(parts, asked, strict=True) if not asks for word in words]
    if bare and parts and any(language.longest(language.parts["asks_within"], parts[0][k:]) for k in (0, 1, 2)):
        return True  # "between which values may it go?"
    return bool(asked) and (bare or asked[0]) and not _orders().intersection(rest)


def _begins(words: list[str], language: Lexicon) -> bool:
    """Whether a part begins with a question, politeness apart."""
    while words:
        asks = language.longest(language.parts["ask"], words)
        count = max(language.courtesy(words), language.longest(language.parts["articles"], words))
        if asks:
            return asks >= count and (words[0] != "keep" or asks == len(words))
        if not count:
            return False
        words = words[count:]
    return False


@cache
def _orders() -> frozenset[str]:
    """Words that order something in one of the languages."""
    found = (item for language in LANGUAGES for item in lexicon(language).meanings.items())
    single = ((words[0], said) for words, said in found if len(words) == 1 and not words[0].endswith("ing"))
    return frozenset(word for word, said in single if ORDERS & {kind for kind, _ in said})


def answered(state: RigState, rig: Rig) -> str:
    """Where a rig is, what is asked of it, and what may be."""
    ranges = {f"{item.name} [{item.unit}]": item for item in set_point_ranges(rig)}
    parts = []
    for name, value in state.outputs.items():
        shown = ranges[name]
        rest = rig.system.operating_point.get(shown.name, 0.0) / shown.scale
        said = f"{shown.name} {value:.4g} {shown.unit}" + (f" ({value + rest:.6g} {shown.unit} in all)" if rest else "")
        if name in state.references and shown.moves:
            said += f" of {state.references[name]:.4g} {shown.unit} asked, from {shown.low:.4g} to {shown.high:.4g}"
        parts.append(said)
    for (name, value), actuator in zip(state.inputs.items(), rig.actuators, strict=True):
        parts.append(f"{name.split(' [')[0]} {value:.4g}, from {actuator.low:.4g} to {actuator.high:.4g}")
    return "; ".join([*parts, *filter(None, [state.standstill]), "nothing moves by a question"])
