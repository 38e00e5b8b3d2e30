"""Strip charts: the readings of the last seconds, in braille."""

from __future__ import annotations

import math

from app.measuring.gauges import SLOTS, Trace

BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
LEFT, RIGHT = (
    tuple(sum(bit for k, bit in enumerate(four) if dots >> k & 1) for dots in range(16))
    for four in BITS
)
"""Of a braille character: its bits for any four dots of one column, topmost first."""

BLANK = 0x2800  # of Unicode: braille without dots; a bit of the last byte for each of its dots
BANDS = 3.0
"""The scale is at least so many times as high as the band of rest."""

LEAST_MM = 1e-6
EVERY = 4
"""The edges of the band have one dot in so many."""


def strip_rows(trace: Trace, columns: int, rows: int) -> tuple[str, ...]:
    """The strip chart in a place of so many cells, the present at its right end.

    Each moment reaches from its least to its largest reading and to the moment before. Dotted
    lines are the edges of the band in which readings count as at rest.
    """
    wide, high = 2 * columns, 4 * rows
    if not trace.moments or not wide or not high:
        return ("",) * rows
    lower, upper = _scale(trace)
    per_mm = high / (upper - lower)

    def down(value_mm: float) -> int:
        return min(max(math.floor((upper - value_mm) * per_mm), 0), high - 1)

    dots = [0] * wide  # a bit for each dot of a column, topmost first
    before = trace.moments[0]
    for moment in trace.moments:
        ago, low, high_mm = moment
        if before[0] == ago + 1:
            low, high_mm = min(low, before[2]), max(high_mm, before[1])
        before = moment
        line = (2 << down(low)) - (1 << down(high_mm))  # every dot from the highest to the lowest
        first = (SLOTS - 1 - ago) * wide // SLOTS
        for x in range(first, max(first + 1, (SLOTS - ago) * wide // SLOTS)):
            dots[x] |= line
    if trace.band_mm[0] < trace.band_mm[1]:
        edges = (1 << down(trace.band_mm[0])) | (1 << down(trace.band_mm[1]))
        for x in range(0, wide, EVERY):
            dots[x] |= edges
    pairs = list(zip(dots[::2], dots[1::2], strict=True))
    return tuple(
        "".join(chr(BLANK + LEFT[(a >> y) & 15] + RIGHT[(b >> y) & 15]) for a, b in pairs)
        for y in range(0, high, 4)
    )


def _scale(trace: Trace) -> tuple[float, float]:
    """Lower and upper end in mm; they keep still while the readings stay near the band."""
    low_mm, high_mm = trace.band_mm
    band_mm = max(high_mm - low_mm, LEAST_MM)
    lower = min(low_mm if band_mm > LEAST_MM else math.inf, *(low for _, low, _ in trace.moments))
    upper = max(high_mm if band_mm > LEAST_MM else -math.inf, *(top for _, _, top in trace.moments))
    middle = band_mm * round((low_mm + high_mm) / 2.0 / band_mm)
    half = BANDS * band_mm / 2.0
    if middle - half <= lower and upper <= middle + half:
        return middle - half, middle + half
    return lower, upper if upper > lower else lower + LEAST_MM
