"""Paraphrases: expressions of several words in the words that the grammar reads."""

from __future__ import annotations

import re

from hybrid_sysid_ros.extensions.commander.language.lexicon import Lexicon
from hybrid_sysid_ros.extensions.commander.language.stops import stop_in

JOINED = re.compile(r"\b(?:then|and|or|ent[aã]o|depois|e|ou)\b", re.IGNORECASE)
"""What joins two parts."""
TIMED = "wait|pause|hold|stay|in|within|for|after|every|over|of|half|just|about|takes?|then|and"
"""Words after which "a second" is a time, and no rate."""
AMOUNT = (
    r"(?:another\s+|an?\s+extra\s+)?((?:\d[\d.,]*|an?|half|one|two|three|four|five|six|seven|eight|nine|ten|\w+teen"
    r"|\w+ty)\s+(?:[\w./^²%-]+\s+){0,3}?)"
)
"""A number in digits or words, and what it counts."""
ABOUT = r"(?:roughly|approximately|approx|about|around|cerca\s+de|aproximadamente|un[sa]s|coisa\s+de)"
SECONDS = r"(?:s|secs?|seconds?|mins?|minutes?|segundos?|minutos?)\b"
PHRASES = (
    (re.compile(r"(?:^|(?<=[;:.,]))\s*\(\d\)\s*"), " "),
    (re.compile(r"[()\[\]]"), ", "),
    (re.compile(r"\br\.\s?p\.\s?m\b\.?", re.I), "rpm"),
    (re.compile(r"\b(?:rev|turn|revolution|rotation|round)s?\s+(?:a|per|each|every)\s+min(?:ute)?\b", re.I), "rpm"),
    (re.compile(r"\bhalf\s+a\s+dozen\b", re.I), "six"),
    (re.compile(r"\b(?:a\s+|one\s+)?dozen\b", re.I), "twelve"),
    (
        re.compile(r"\bonce\s+in\s+(?=(?:[\d.]+|an?|one|two|three|four|five|six|eight|ten|twenty|thirty)\b)", re.I),
        "every ",
    ),
    (
        re.compile(r"\b[x\u00d7]\s?(\d+)\b|\b(\d+)\s?[x\u00d7](?!\w)", re.I),
        lambda match: f"{match[1] or match[2]} times",
    ),
    (re.compile(r"\bt(á|ava)\b", re.I), r"est\1"),
    (re.compile(r",\s*like\s+(?=(?:\d|half|one|two|three|four|five|ten|twenty)\b)", re.I), ", "),
    (re.compile(rf"\b{ABOUT}\s+(?=(?:[\d.,]+|(?:[^\W\d_]+[\s-]){{1,2}}?)\s*{SECONDS})", re.I), ""),
    (
        re.compile(
            r"\b(?:paus|wait|hold|stay|rest|dwell|remain)(?:e|ing|s)?\s+(?:for\s+)?(?=[^,;]{1,24}\b(?:at|on|for)\s+(?:each|every)\b)",
            re.I,
        ),
        "",
    ),
    (re.compile(r"(?<=\d)½"), ".5"),
    (re.compile(r"½"), "0.5"),
    (re.compile(r"\.{3,}|\.{2}(?=\s|$)"), ", "),
    (
        re.compile(r"\b(?:(once)|twice)\s+(?:a|per|every)\s+sec(?:ond)?\b", re.I),
        lambda match: f" at {2 - bool(match[1])} Hz ",
    ),
    (re.compile(r"\b(?:per|a)\s+second\s+squared\b|\bpor\s+segundo\s+ao\s+quadrado\b", re.I), "/s^2 "),
    (re.compile(r"\b(?:per|por)\s+sec(?:ond)?s?\b|\bpor\s+segundo\b", re.I), "/s "),
    (re.compile(rf"\b(?!(?:{TIMED})\b)([^\W\d_]+|%)\s+a\s+sec(?:ond)?s?\b", re.I), r"\1/s "),
    (
        re.compile(
            r"\b((?:at|than|most|ramp\b[^,;]{0,30}\bby)\s+(?:[\w.,+-]+\s+){1,3}?[^\W\d_]+(?:/s)?)\s+(?:each|every)\s+second\b",
            re.I,
        ),
        r"\1/s ",
    ),
    (
        re.compile(
            r"^\s*(?:can(?!.*\?)|could|might)\s+(?:it|she|he|the)\s+(?!(?:[\w-]+\s+){1,2}(?:be(?!\s+\w+(?:ed|en)\b)|have|reach|hit|get|take|hold|stand)\b)",
            re.I,
        ),
        "the ",
    ),
    (re.compile(r"\b(each|every)\s+(?=(?:second|minute)\b(?!\s+(?:step|one|time|level|value)))", re.I), r"\1 1 "),
    (
        re.compile(
            r"\b(for|wait|pause|hold|stay)\s+((?:[\w.,]+\s+){1,3}?)(?:more|further)\s+(?=(?:s|secs?|seconds?|mins?|minutes?)\b)",
            re.I,
        ),
        r"\1 \2",
    ),
    (
        re.compile(
            r"\b(lower|higher|faster|slower)\s+than\s+(?:(?:where\s+)?it\s+is(?:\s+now)?|(?:right\s+)?now)\b", re.I
        ),
        r"\1",
    ),
    (
        re.compile(
            r"^([^,;]*\b(?:hold|keep|stay|maintain|remain|leave|mantenha|mant[eé]m|fique|segure)\b(?:(?!\b(?:then|and|swing)\b)[^,;])*?"
            r"|(?:(?!\b(?:then|and|e|wave|onda|sin\w*|se[nñ]o\w*|swing|chirp|sweep|triang\w*|square|rock\w*|wiggle|os[cz]il\w*"
            r"|balan\w*|repeat|repita|every|cada)\b)[^;])*?),?"
            r"\s+(?:(?:until|till)\s+(?:i\s+(?:say|tell|ask)\b[^,;]*|further\s+notice|told\s+otherwise)"
            r"|at[eé]\s+(?:eu\s+(?:pedir|mandar|dizer|falar)\b[^,;]*|(?:segunda|nova)\s+ordem))\W*$",
            re.I,
        ),
        r"\1",
    ),
    (re.compile(rf"\b(?:knock|shave|take|trim|cut|get|scrub|bring|lose|drop)\s+{AMOUNT}off\b", re.I), r"reduce by \1"),
    (
        re.compile(
            r"^(?!.*\b(?:then|and)\b)([^,;]+?),?\s+(?:but\s+)?(?:(?:wait|paus|hold|stay)(?:e|ing)?\s+"
            r"(?:first\s+(?:for\s+)?([^,;]+?)|(?:for\s+)?([^,;]+?)\s+first)|"
            r"(?:but\s+first\s+wait|first\s+waiting)\s+(?:for\s+)?([^,;]+?))\W*$",
            re.I,
        ),
        lambda match: match[0] if stop_in(match[0]) else f"wait {match[2] or match[3] or match[4]}, then {match[1]}",
    ),
    (re.compile(r"(?<=\d)\s+(?=(?:per|a|every)\s+(?:min(?:ute)?|sec(?:ond)?)\b)", re.I), " cycles "),
    (re.compile(r"\bper\s+min(?:ute)?s?\b|\bpor\s+minuto\b", re.I), "/min "),
    (re.compile(r"\bper\s+h(?:our)?\b|\bpor\s+hora\b", re.I), "/h "),
    (re.compile(r"(?<=\w)\s*/\s*(s|min|h|seg)\b", re.I), lambda match: "/" + match[1].lower().replace("seg", "s")),
    (re.compile(r"/s\s*/\s*s\b|/s2\b|/s²"), "/s^2"),
    (re.compile(r"\b(rad|deg|m|V)\s?\*?\s?s\^?(?:-1|⁻¹)"), r"\1/s"),
    (re.compile(r"\btake\s+(?=(?:[\w.,]+\s+){1,2}(?:s|secs?|seconds?|mins?|minutes?)\b)", re.I), "over "),
    (re.compile(r"\b(s|seconds|minutes?|mins?|hours?)'?\s+time\b", re.I), r"\1 from now"),
    (
        re.compile(r"\b(?:start|beginn|commenc)ing\s+(?=(?:[\w.,]+[\s-]+){1,3}?(?:from\s+now|hence|later)\b)", re.I),
        "",
    ),
    (re.compile(r"\b(?:after|following)\s+an?\s+([^,;]{1,20}?)[\s-]+(?:delay|pause|wait|break)\b", re.I), r"after \1"),
    (re.compile(r"(\d[\d.,]*\s*[^\W\d_]+/s(?:\^2)?)\s+(?:max|maximum)\b", re.I), r"at most \1"),
    (re.compile(r"\bde\s+(\S+)\s+em\s+\1\b", re.I), r"em degraus de \1"),
    (re.compile(r"\bmore\s+times\b|\btimes\s+more\b", re.I), "times"),
)
"""What is written in several words, dots of somebody who thinks, and units that touch their number."""
BAND = re.compile(r"(?<=\d)\s*-\s*(?=\d+(?:[.,]\d+)?\s*[km]?Hz\b)|(?<=\d)-(?=\d+(?:[.,]\d+)?\s*(?:[^\W\d_]|[%°,;]|$))")
PEAK_TO_PEAK = re.compile(r"(?<=\d)\s*([^\W\d_]{1,3})\s*(?:pp|p-p)\b")
"""As in "0.1-2 Hz", "50-150 rpm" and "3 Vpp": they stand for a word of the language."""
LEVELS = re.compile(
    r"^[^,;:\d]{0,30}?\b(?:steps?|stairs|stair\s?case|levels|escada|degraus|patamares|n[ií]veis)\b(?:\s+(?:of|de))?\s*:?\s*"
    r"(?=(?:[\w.-]+(?:\s+[^\W\d_/]+)?,\s*){2})",
    re.I,
)
"""Stairs of which each level is said, as in "staircase: 0, 4, 8 rad"."""
DICTATED = re.compile(r"\s+comma\b", re.I), re.compile(r"\s+(?:period|full stop)\W*$", re.I)
"""Marks in a dictated text, of which the last one is read as such beside others alone."""
LOOKALIKES = str.maketrans(
    {
        **{"\u2212": "-", "\u2013": "-", "\u2014": ",", "\u2019": "'", "\u00ba": "°", "\u03bc": "µ"},
        **{"\t": " ", "\u00bf": " ", "\u00a1": " ", "\u2026": ", "},
    }
)
"""Minus, dashes, apostrophe, ordinal, Greek mu and Spanish marks, as editors and phones write them."""


DASH = re.compile(r"([^\W\d_]+) +-+ +(?=[^\W\d_])")
"""Between two parts of a sentence; before digits it would be a sign."""


def _apart(match: re.Match[str], lexicon: Lexicon) -> str:
    """A comma for a dash, but not behind a word that a number could follow: "go to - two metres"."""
    kinds = {kind for kind, _ in lexicon.meanings.get((match[1].lower(),), ())}
    return match[0] if kinds - {"J", "K", "O", "C"} else f"{match[1]}, "


def written_out(text: str, lexicon: Lexicon) -> str:
    """A text without its openings and marks of thinking, and its paraphrases written out."""
    comma, end = DICTATED
    text = comma.sub(",", end.sub("", text)) if comma.search(text) else text
    said = lexicon.opening.sub("", text)
    said = text if not said.strip() else said
    if (single := lexicon.closing.match(said)) and not re.search(
        r"\b(?:then|and|or|ent[aã]o|depois|e|ou)\b", said, re.I
    ):
        said = single[1]
    said = DASH.sub(lambda match: _apart(match, lexicon), said)
    said = BAND.sub(f" {lexicon.table['to'][0]} ", said.translate(LOOKALIKES))
    said = LEVELS.sub(f"{lexicon.table['step_through'][0]} ", said)
    said = PEAK_TO_PEAK.sub(rf" \1 {lexicon.table['peak_to_peak'][0]} ", said)
    for phrase, other in PHRASES:
        said = phrase.sub(other, said)
    return said
