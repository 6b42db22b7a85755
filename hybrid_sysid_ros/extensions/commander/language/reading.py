"""Reading: the ways to cut a sentence into parts, the likeliest first, until one leaves no word and no slot open."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from heapq import heappop, heappush
from itertools import pairwise

from hybrid_sysid_ros.extensions.commander.language.clauses import IncompleteError
from hybrid_sysid_ros.extensions.commander.language.commands import Sentence
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.parts import Boundary, boundaries
from hybrid_sysid_ros.support.errors import UserError

MOST_READINGS = 20
"""Of a sentence that are tried."""
OPEN = 10.0
"""What it costs that a part leaves something open."""


def read_by(
    found: Sequence[Symbol],
    complete: Callable[[Sequence[Symbol]], bool],
    sentence: Callable[[Sequence[Sequence[Symbol]]], Sentence],
) -> Sentence:
    """What the likeliest reading of symbols says; complete: whether a part leaves nothing open by itself; sentence:
    what parts say together. A reading that is complete and doubtful is asked about, and one that leaves something open
    gives way to the next. Raises UserError for symbols of which none is complete, or of which two that are as likely
    differ.
    """
    refusal: UserError | None = None
    best: tuple[float, Sentence, Sequence[Sequence[Symbol]]] | None = None
    for cost, parts in _readings(found, complete):
        if (refusal is not None and cost >= OPEN) or (best is not None and cost > best[0]):
            break
        try:
            made = sentence(parts)
        except UserError as error:
            if refusal is None and not isinstance(error, IncompleteError):
                raise
            refusal = refusal or error
            continue
        if best is not None and best[1] != made:
            raise UserError(f"{_said(best[2])}, or {_said(parts)}? join the parts by 'then'")
        best = best or (cost, made, parts)
    if best is None:
        assert refusal is not None
        raise refusal
    return best[1]


def _said(parts: Sequence[Sequence[Symbol]]) -> str:
    return " then ".join(repr(" ".join(symbol.text for symbol in part if symbol.text)) for part in parts)


def _readings(
    found: Sequence[Symbol], complete: Callable[[Sequence[Symbol]], bool]
) -> Iterator[tuple[float, Sequence[Sequence[Symbol]]]]:
    """The cheapest ways through the boundaries (A*, whose estimate is the exact rest)."""
    places = [Boundary(0, 0, 0.0, 0.0), *boundaries(found), Boundary(len(found), len(found), 0.0, 0.0)]
    costs: dict[tuple[int, int], float] = {}
    rest = [0.0] * len(places)
    for first in range(len(places) - 2, -1, -1):
        kept = 0.0
        for last in range(first + 1, len(places)):
            part = found[places[first].begin : places[last].end]
            costs[first, last] = kept + places[last].cut + OPEN * (bool(part) and not complete(part))
            kept += places[last].keep
            if kept == float("inf"):
                break
        rest[first] = min(
            costs[first, last] + rest[last] for last in range(first + 1, len(places)) if (first, last) in costs
        )
    queue: list[tuple[float, tuple[int, ...]]] = [(rest[0], (0,))]
    for _ in range(MOST_READINGS):
        while queue and queue[0][1][-1] < len(places) - 1:
            cost, way = heappop(queue)
            for last in range(way[-1] + 1, len(places)):
                if (way[-1], last) in costs:
                    more = cost - rest[way[-1]] + costs[way[-1], last] + rest[last]
                    heappush(queue, (more, (*way, last)))
        if not queue:
            return
        cost, way = heappop(queue)
        yield cost, [found[places[a].begin : places[b].end] for a, b in pairwise(way)]
