"""Reading: the ways to cut a sentence into parts, the likeliest first, until one leaves no word and no slot open."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from heapq import heappop, heappush

from hybrid_sysid_ros.extensions.commander.language.clauses import IncompleteError
from hybrid_sysid_ros.extensions.commander.language.commands import Sentence
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.support.errors import UserError

MOST_READINGS, MOST_CHANGES = 40, 3
"""Readings of a sentence that are tried, and cuts in one of them."""
CUT = {",": 1.0, "j": 1.2, "D": 2.0, "Z": 2.0, "z": 2.0}
"""What it costs to cut at a comma or an "and", or before a delay or a condition."""


def read_by(found: Sequence[Symbol], sentence: Callable[[Sequence[Symbol]], Sentence]) -> Sentence:
    """What the likeliest complete reading of symbols says; sentence: what symbols say as they are parted. A reading
    that is complete and doubtful is asked about, and one that leaves something open gives way to the next. Raises
    UserError for symbols of which none is complete, or of which two that are as likely differ.
    """
    refusal: UserError | None = None
    best: tuple[float, Sentence] | None = None
    for cost, symbols in _readings(found):
        if best is not None and cost > best[0]:
            break
        try:
            made = sentence(symbols)
        except UserError as error:
            if refusal is None and not isinstance(error, IncompleteError):
                raise
            refusal = refusal or error
            continue
        if not cost:
            return made
        if best is not None and best[1] != made and refusal is not None:
            raise refusal  # two readings that are as likely differ
        best = best or (cost, made)
    if best is None:
        assert refusal is not None
        raise refusal
    return best[1]


def _readings(found: Sequence[Symbol]) -> Iterator[tuple[float, Sequence[Symbol]]]:
    """Symbols as they are, and with more cuts, by what these cost."""
    changes = [(CUT[symbol.kind], k) for k, symbol in enumerate(found) if k and symbol.kind in CUT]
    changes = [(cost, k) for cost, k in changes if found[k - 1].kind not in ",j;" or found[k].kind in ",j"]
    queue: list[tuple[float, tuple[int, ...]]] = [(0.0, ())]
    for _ in range(MOST_READINGS):
        if not queue:
            return
        cost, chosen = heappop(queue)
        yield cost, _cut(found, chosen)
        if len(chosen) < MOST_CHANGES:
            for more, k in changes:
                if not chosen or k > chosen[-1]:
                    heappush(queue, (cost + more, (*chosen, k)))


def _cut(found: Sequence[Symbol], chosen: tuple[int, ...]) -> list[Symbol]:
    """Symbols with a mark that ends a part in place of a comma or an "and", or before another symbol."""
    made: list[Symbol] = []
    for k, symbol in enumerate(found):
        if k in chosen:
            made.append(Symbol(";", "", ""))
        if k not in chosen or symbol.kind not in ",j":
            made.append(symbol)
    return made
