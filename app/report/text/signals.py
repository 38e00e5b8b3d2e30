"""Words at the beginning of a line that stand out; a colour never stands for a word."""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import StrEnum


class Signal(StrEnum):
    """What a word is a signal of, by the colour of a theme."""

    NEXT = "primary"
    GOOD = "success"
    CAUTION = "warning"
    FAULT = "error"


SIGNALS = {
    "Next:": Signal.NEXT,
    **dict.fromkeys(("AGREES.", "EXPLAINED.", "PASS", "Taken"), Signal.GOOD),
    **dict.fromkeys(("✓ The plate is done.", *(f"✓ Leg {a} is done." for a in "XYZ")), Signal.GOOD),
    **dict.fromkeys(("WARNING:", "AMBIGUOUS.", "PARTLY-EXPLAINED."), Signal.CAUTION),
    **dict.fromkeys(("CANNOT-TELL.", "LEFT OUT:", "WEAK:", "SUSPECT:"), Signal.CAUTION),
    **dict.fromkeys(("LOST:", "UNDECIDED", "WAIT:"), Signal.CAUTION),
    **dict.fromkeys(("UNEXPLAINED.", "FAIL", "Not taken:", "FAULT:"), Signal.FAULT),
}
BEGINNING = re.compile(rf"^({'|'.join(map(re.escape, SIGNALS))})", re.MULTILINE)


def signals_in(text: str) -> Iterator[tuple[Signal, int, int]]:
    """What each signal word is, and from where to where it reaches."""
    for word in BEGINNING.finditer(text):
        yield (SIGNALS[word[0]], *word.span())
