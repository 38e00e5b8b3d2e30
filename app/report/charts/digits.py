"""Numbers in digits that are legible from three metres."""

from __future__ import annotations

from functools import lru_cache

GLYPHS = {
    **{"0": "75557", "1": "26227", "2": "71747", "3": "71717", "4": "55711", "5": "74717"},
    **{"6": "74757", "7": "71111", "8": "75757", "9": "75717"},
    **{"+": "02720", "-": "00700", ".": "00001"},
}
"""Large digits, an octal figure for the three squares of each row."""


def large_digits(number: str) -> tuple[str, ...]:
    """The five rows of a number, two cells for each square."""
    return tuple(" ".join(row) for row in zip(*map(_large_digit, number), strict=True))


@lru_cache(maxsize=64)
def _large_digit(digit: str) -> tuple[str, ...]:
    squares = (0,) if digit == "." else (2, 1, 0)
    rows = ([int(row) >> k & 1 for k in squares] for row in GLYPHS[digit])
    return tuple("".join("██" if filled else "  " for filled in row) for row in rows)
