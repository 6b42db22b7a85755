"""Conditions: what a text says of when, such as "once it is still" or "if the height drops below 3 m"."""

from __future__ import annotations

from hybrid_sysid_ros.extensions.commander.language.lexicon import Lexicon, Symbol
from hybrid_sysid_ros.extensions.commander.language.quantities import QuantityReader, Token
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import TIME
from hybrid_sysid_ros.support.errors import UserError


class ConditionReader(QuantityReader):
    """Reads conditions, which become symbols."""

    def __init__(self, tokens: list[Token], lexicon: Lexicon, vocabulary: Vocabulary) -> None:
        super().__init__(tokens, lexicon, vocabulary)

    def condition(self) -> bool:
        """A condition such as "once it is still", "when it reaches 3 m" or "if the height drops below 3 m"."""
        parts = self.lexicon.parts
        begin = self.longest(parts["once"])
        others = max(self.longest(self.lexicon.meanings), self.lexicon.courtesy(self.words[self.at :]))
        if not begin or others > begin:  # "once more", "when you are ready"
            return False
        if self.up_to(begin):
            return True
        if self.words[self.at + begin - 1] == "for" and (self._number_follows(begin) or self.word() == "for"):
            return False  # "wait for 5 s"
        words = tuple(self.words[self.at : self.at + begin])
        start, when = " ".join(words), next((kind for kind in ("until", "if") if words in parts[kind]), "once")
        count, named, event = self._subject(begin)
        settled = 0 if when == "if" else self.longest(parts["settled"], skip=count)
        (at_once, side), (later, other) = self._relation(begin), self._relation(count, event=event)
        event = event or (later > 0 and self.longest(parts["becomes"], skip=count) > 0)  # "it gets above 3 m"
        if not named and later and self._compares_speeds(count, later):
            named = [Symbol("K", "speed", "")]
        equals = self.longest(parts["equals"], skip=count - 1) == 1  # "when it is 2 m"
        equals = equals and not (at_once or later) and self._number_follows(count)
        lasting = self.words[count + settled + self.at :][:1] == ["for"]
        if lasting and self.lexicon.courtesy(words[:1]):  # "let it settle for 5 s"
            return False
        if settled and count + settled >= max(begin + at_once, count + later):
            self.at += count + settled
            self.found.append(Symbol("Z", (when, 0.0), f"{start} it is still"))
            return True
        if at_once or later or equals:
            self.at += begin + at_once if at_once else count + later
            side = side if at_once else other
            if when == "until" and not side and self.moves() and not (named and self.has_level()):
                self.found += [Symbol("T", "to", start), *named[:1]]  # "climb at 2 m/s until the height is 200 m"
                return True
            when = "once" if when == "if" and (event or not side) else when
            self.found += [Symbol("z", (when, side), start), *([] if at_once else named[:1])]
            return True
        if words in self.lexicon.meanings or (when != "if" and self.lexicon.courtesy(words[:1])):
            return False
        raise UserError(f"{start!r} what? say for example 'once it is still', 'when it reaches 1' or 'in 5 s'")

    def _compares_speeds(self, skip: int, count: int) -> bool:
        """Whether so many words say faster or slower, where one output is a speed."""
        words = self.words[self.at + skip :][:count]
        compared = any(self.lexicon.meanings.get((word,), ((" ", 0),))[0][0] == "M" for word in words)
        return compared and len(self.vocabulary.of_kind("speed")) == 1

    def up_to(self, begin: int) -> bool:
        """Whether a value follows "until": where what moves goes to, or what a wait or a hold is for."""
        words = tuple(self.words[self.at : self.at + begin])
        if words[-1] not in ("until", "till"):
            return False
        begin += self.longest(self.lexicon.parts["it_is"], skip=begin)  # "until it is 180 rpm"
        if not self._number_follows(begin):
            return False
        start, self.at = self.at, self.at + begin
        lasting = self.quantity()
        self.at = start
        if lasting is not None and lasting.kind == "Q" and lasting.value[1] and lasting.value[1].base == TIME:
            self.found.append(Symbol("R", "for", words[0]))  # "until 40 seconds are up"
            self.at += begin
            return True
        self.found.append(Symbol("T", "to", words[0]) if self.moves() else Symbol("z", ("until", 0.0), " ".join(words)))
        self.at += begin
        return True

    def moves(self) -> bool:
        """Whether the part that ends here leads somewhere."""
        last = max((k for k, symbol in enumerate(self.found) if symbol.kind == ";"), default=-1)
        part = self.found[last + 1 :]
        verbs = {symbol.value for symbol in part if symbol.kind == "V"}
        leads = bool(verbs) or any(symbol.kind in "UF" for symbol in part)
        return leads and not verbs & {"hold", "wait", "swing", "square", "triangle", "toggle", "repeat", "follow"}

    def has_level(self) -> bool:
        """Whether the part that ends here says a value, but for how fast."""
        last = max((k for k, symbol in enumerate(self.found) if symbol.kind == ";"), default=-1)
        part = self.found[last + 1 :]
        return any(symbol.kind == "Q" and (not k or part[k - 1].kind != "W") for k, symbol in enumerate(part))

    def _subject(self, count: int) -> tuple[int, list[Symbol], bool]:
        """How many words there are with those that say of what a condition is, which output, and whether it becomes so,
        as in "the height drops".
        """
        parts, named, event = self.lexicon.parts, list[Symbol](), False
        for _ in range(3):
            count += max(self.longest(parts[kind], skip=count) for kind in ("it_is", "articles", "object"))
            more, nouns = self._noun(count, watched=True)
            count, named = count + more, named + nouns
            more = self.longest(parts["becomes"], skip=count)
            if more and self._relation(count)[0] <= more:  # "passar de" a value is all one
                count, event = count + more, True
        return count, named, event

    def _relation(self, skip: int, *, event: bool = False) -> tuple[int, float]:
        """How many words lead to the value that is waited for, and on which side of it the output has to be."""
        parts = self.lexicon.parts
        lead = parts["reaches"] | parts["to"] if event else parts["reaches"]
        return max(
            (self.longest(lead, skip=skip), 0.0), (self.longest(parts["above"], skip=skip), 1.0),
            (self.longest(parts["below"], skip=skip), -1.0), key=lambda found: found[0],
        )  # fmt: skip

    def _noun(self, skip: int, *, watched: bool = False) -> tuple[int, list[Symbol]]:
        """How many of the words behind the next ones name an output, or the rig, and which output; watched: or one that
        is not steered, which a condition may be of.
        """
        words = self.words[self.at + skip :]
        if watched and (seen := self.vocabulary.watched_here(words, self.lexicon)):
            return seen
        own, count = self.vocabulary.longest(words, self.lexicon), self.longest(self.lexicon.meanings, skip=skip)
        if own is not None and own[1].kind in "OJ":
            return own[0], [own[1]] if own[1].kind == "O" else []
        meanings = self.lexicon.meanings[tuple(words[:count])] if count else ()
        named = [Symbol(kind, value, " ".join(words[:count])) for kind, value in meanings if kind == "K"]
        return count if named else 0, named
