"""Corrections: what somebody says who takes a value back and says another one."""

from __future__ import annotations

import re

from hybrid_sysid_ros.extensions.commander.language.conditions import ConditionReader


class CorrectionReader(ConditionReader):
    """Reads corrections, of which the later value is left."""

    def corrected(self) -> bool:
        """Whether somebody corrects a value here, as in "45, no, make that 30", which then has the later number, or the
        later unit.
        """
        count = self.longest(self.lexicon.parts["correction"])
        last = max((k for k, symbol in enumerate(self.found) if symbol.kind == "Q"), default=-1)
        behind = "".join(symbol.kind for symbol in self.found[last + 1 :])
        if not count or last < 0 or not re.fullmatch("[TKOUdMJ+]*[,;]?", behind):
            return False
        marked = self.tokens[self.at + count : self.at + count + 1]
        skip = count + bool(marked and marked[0].text == ",")
        if count == 1 and skip == 1 and (self.word(),) in self.lexicon.parts["negation"]:
            return False  # "go to 2 m no 3 m"
        start, (value, unit), before = self.at, self.found[last].value, self.found[last]
        self.at += skip
        self.at += self.longest(self.lexicon.parts["again"])
        self.at += 0 if self._number_follows(0) else self.longest(self.lexicon.parts["to"])
        later = self.unit_here()
        quantity = None if later is not None or self.at >= len(self.tokens) else self.quantity()
        if later is not None:
            self.found[last] = before._replace(value=(value, later))
        elif (
            quantity is not None
            and quantity.kind == "Q"
            and (quantity.value[1] is None or unit is None or quantity.value[1].alike(unit))
        ):
            self.found[last] = quantity._replace(value=(quantity.value[0], quantity.value[1] or unit))
        else:
            self.at = start
            return False
        del self.found[last + 1 + len(behind.rstrip(",;")) :]
        return True
