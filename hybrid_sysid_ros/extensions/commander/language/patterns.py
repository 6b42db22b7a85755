"""Patterns: what symbols in a row come to; the first that fits is taken."""

from __future__ import annotations

import re
from collections.abc import Sequence

_LETTERS: Sequence[tuple[str, str]] = (  # of lexicon.ROLES and NOUNS; Q: a quantity, O: an output by name
    ("to_name", "[TW]?K?GK?"),
    ("condition", "Z|z[KO]?T?Q"),
    ("between", "B(?:[KO]o?)?Q[jT]Q"),
    ("range", "[Fo](?:[KO]o?)?QU?TQ"),
    ("span", "QU?TQ"),
    ("plus_minus", "[WYo]?pQ"),
    ("here", "[WA]?H|AN[KO]"),
    ("around", "A(?:[KO]o?)?Q"),
    ("share", "[TWY]?(?:Q|SN?)o?[NXx](?:o?[KO])?"),
    ("full_speed", "W?(?:xo?[KO]|[KO]x)"),
    ("as_fast", "Sg"),
    ("limit", "Tx(?:o?[KO])?|T[KO]x"),
    ("share", "[TWYI]?S(?:o?[KO](?:oO)?)?(?:o?J)?"),
    ("amplitude", "[jWo]?[ak]o?(?:oO)?J?[TYW]?Q|[WYo]?Qo?[ak]"),
    ("frequency", "[jWIo]?fo?J?[TYW]?Q|W?Qof"),
    ("period", "[jWo]?qo?J?[TYW]?Q|W?Q[oe]q|W?Qq(?!o?[TYW]?Q)"),
    ("noun", "[afq](?:o[JO])?"),
    ("rate", "W[KO]o?Q(?!o?[akfq])"),
    ("no_faster", "tQ"),
    ("each", "R?QW?e(?![QR])|eRQ"),
    ("at", "WQ(?:o[KO])?"),
    ("later", "I?QE"),
    ("to", "T(?:KoO|KO|OK|K|O)o?Q"),
    ("to", "TQ(?:o?[KO])?"),
    ("often", "QeQ"),
    ("by", "YA?Q(?:o?[KO])?"),
    ("for", "RA?Q"),
    ("in", "IA?Q"),
    ("in_or_to", "iQ"),
    ("for_or_by", "rQ"),
    ("within", "LQ"),
    ("after", "DQ"),
    ("every", "eQ"),
    ("from", "F(?:[KO]o?)?Q"),
    ("target", "[Wo]?N?(?:KoO|KO|OK|K|O)(?:o?J)?"),
    ("plain", "o?Q(?:o?[KO])?"),
    ("comparative", "b?m?M"),
    ("bit", "b"),
    ("direction", "U(?:o?J)?"),
    ("sense", "d"),
    ("home_place", "[TWo]?u(?:o?[JKO])?"),
    ("verb", "o?V(?:o?J)*"),
    ("pace", "[Cc]"),
    ("all", "l"),
    ("object", "J"),
    ("wish", "w"),
    ("displacing", "y"),
    ("and", "(?!^)j(?!$)"),
)
PATTERNS = tuple((slot, re.compile(letters)) for slot, letters in _LETTERS)
"""Slots of a clause, each with the letters that fill it."""
