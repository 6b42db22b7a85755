"""Completeness: whether a part of a sentence leaves no word and no slot open by itself."""

from __future__ import annotations

from collections.abc import Sequence

from hybrid_sysid_ros.extensions.commander.language.clauses import Clause, IncompleteError
from hybrid_sysid_ros.extensions.commander.language.files import Files
from hybrid_sysid_ros.extensions.commander.language.joining import stands_alone
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.matcher import GO, clause_of
from hybrid_sysid_ros.extensions.commander.language.meanings import Meaning
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import TIME
from hybrid_sysid_ros.support.errors import UserError


def is_complete(part: Sequence[Symbol], vocabulary: Vocabulary, files: Files) -> bool:
    """Whether all symbols of a part have a place in it, and it has all it needs; what is doubtful, has."""
    try:
        said = [symbol for symbol in part if symbol.kind != ";"]
        if not said:
            return True
        clause = clause_of(said, vocabulary)
        return not clause.empty and _asks_for_something(clause, vocabulary, files)
    except IncompleteError:
        return False
    except UserError:
        return True


def _asks_for_something(clause: Clause, vocabulary: Vocabulary, files: Files) -> bool:
    verbs = {symbol.value for symbol in clause.verbs}
    if clause.condition is not None or clause.delay is not None:
        clause.condition = clause.delay = None
        return (stands_alone(clause) and verbs <= {"wait"}) or _asks_for_something(clause, vocabulary, files)
    if clause.each is not None and stands_alone(clause) and verbs <= {"hold", "wait"}:
        return True
    lasts = [item.base for item in clause.quantities] == [TIME]
    if "halt" in verbs or clause == Clause(paces=clause.paces) or (lasts and verbs & {"hold", "follow", "repeat"}):
        return True
    if not verbs and any(item.role in ("", "at", "to", "by") for item in clause.quantities):
        clause.verbs.append(GO)
    Meaning(clause, vocabulary, files, behind=not verbs & {"repeat"}).command()
    return True
