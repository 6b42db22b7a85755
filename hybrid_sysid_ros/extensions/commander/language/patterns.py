"""Patterns: what symbols in a row come to; the first that fits is taken."""

from __future__ import annotations

import re
from collections.abc import Sequence

_LETTERS: Sequence[
    tuple[str, str]
] = (  # of lexicon.ROLES and NOUNS; Q: any quantity, 1: a time, 2: a frequency, 9: none of these; O: an output by name
    ("to_name", "[TW]?K?GK?"),
    ("from_here", "F(?:H|J?N[KO]?)"),
    ("former", "[TWo]?(?:J?[KO]P|P[KO]?)"),
    ("condition", "Z|z[KO]?T?Q"),
    ("between", "B(?:[KO]o?)?Q[jT]Q"),
    ("range", "[Fo](?:[KO]o?)?QU?TQ"),
    ("span", "QU?TQ"),
    ("plus_minus", "[WYo]?pQ"),
    ("here", "[WA]?H|AN[KO]"),
    ("around", "W?A(?:[KO]o?)?Q"),
    ("share", "[TWY]?(?:Q|SN?)o?(?:[NXx](?:o?[KO])?|[KO]o?[NXx])"),
    ("full_speed", "W?(?:xo?[KO]|[KO]x)"),
    ("as_fast", "Sg|Qg"),
    ("limit", "Tx(?:o?[KO])?|T[KO]x"),
    ("share", "[TWYI]?S(?:o?[KO](?:oO)?)?(?:o?J)?"),
    ("amplitude", "[jWo]?[ak]o?(?:oO)?J?[TYW]?9|[WYo]?9o?[ak]"),
    ("frequency", "[jWIo]?fo?J?[TYW]?[29]|W?2o?f"),
    ("period", "[jWo]?qo?J?[TYW]?[19]|W?Q[oe]q|W?Qq(?!o?[TYW]?[19])"),
    ("noun", "o?[afq](?:o[JO])?"),
    ("rate", "W[KO]o?Q(?!o?[akfq]|T)"),
    ("no_faster", "<Q"),
    ("increment", r"sQ|[IWo]?\^"),
    ("count_of_steps", "[IWoi]?#(?:oQW?e?)?"),
    ("together", "t"),
    ("each", "[RWo]?QW?e(?:(?=[Wo]?Qe)|(?!Q|R))|eRQe?"),
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
    ("after", "DQH?"),
    ("every", "eQ"),
    ("from", "F(?:[KO]o?)?Q"),
    ("target", "[WoTI]?J?N?(?:KoO|KO|OK|K|O)N?(?:o?J)?"),
    ("target", "R(?:KoO|KO|OK|K|O)$"),
    ("whole_range", "I?x?X(?:o[KO])?"),
    ("plain", "o?Q(?:o?[KO])?"),
    ("comparative", "b?m?Mb?"),
    ("bit", "b"),
    ("direction", "T?U(?:o?J)?"),
    ("more", r"\+(?:o?J)?"),
    ("sense", "d"),
    ("home_place", "[TWo]?u(?:o?[JKO])?"),
    ("verb", "[oW]?V(?:o?J)*"),
    ("pace", "[Cc]J?"),
    ("all", "l"),
    ("object", "[WToI]?J+"),
    ("wish", "wJ?"),
    ("displacing", "y"),
    ("and", "(?!^)j(?!$)|,"),
)
PATTERNS = tuple((slot, re.compile(letters.replace("Q", "[129Q]"))) for slot, letters in _LETTERS)
"""Slots of a clause, each with the letters that fill it."""
