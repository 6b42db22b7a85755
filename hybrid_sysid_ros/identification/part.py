"""Parts of records."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Part:
    """The part of each record that is used, as fractions of its duration."""

    start: float = 0.0
    stop: float = 1.0

    @classmethod
    def parse(cls, text: str) -> Part:
        """From "0:0.5". Raises UserError for anything else."""
        try:
            start, stop = (float(value) for value in text.split(":"))
        except ValueError:
            raise UserError(f"part {text!r}: write START:STOP as fractions, such as 0:0.5") from None
        if not 0.0 <= start < stop <= 1.0:
            raise UserError(f"part {text!r}: needs 0 <= START < STOP <= 1")
        return cls(start=start, stop=stop)
