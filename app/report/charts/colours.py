"""Colours of words and points that everybody can read: contrast as WCAG 2.1 states it."""

from __future__ import annotations

from collections.abc import Sequence

Rgb = tuple[int, int, int]
"""Red, green and blue, 0 … 255 each."""

LEGIBLE = 4.5
"""Least contrast of a signal word with its ground (WCAG 2.1, 1.4.3)."""


def contrast(first: Rgb, second: Rgb) -> float:
    """Contrast of two colours, 1 to 21."""
    darker, lighter = sorted((_luminance(first), _luminance(second)))
    return (lighter + 0.05) / (darker + 0.05)


def _luminance(colour: Rgb) -> float:
    shares = (part / 255.0 for part in colour)
    linear = (v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in shares)
    return sum(map(float.__mul__, (0.2126, 0.7152, 0.0722), linear))


def legible_on(grounds: Sequence[Rgb], colour: Rgb, text: Rgb) -> Rgb:
    """The colour, as much nearer to that of text as it takes on each of the grounds."""
    for tenths in range(10):
        share = tenths / 10.0
        red, green, blue = (int(a + (b - a) * share) for a, b in zip(colour, text, strict=True))
        nearer = red, green, blue
        if min(contrast(nearer, ground) for ground in grounds) >= LEGIBLE:
            return nearer
    return text
