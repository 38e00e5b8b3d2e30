"""Strip charts: the readings of the last seconds, in braille."""

from __future__ import annotations

import math
from itertools import count

from app.measuring.gauges import SLOTS, Trace
from app.report.text.tables import signed

BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
LEFT, RIGHT = (
    tuple(sum(bit for k, bit in enumerate(four) if dots >> k & 1) for dots in range(16))
    for four in BITS
)
"""Of a braille character: its bits for any four dots of one column, topmost first."""

BLANK = 0x2800  # of Unicode: braille without dots; a bit of the last byte for each of its dots
BANDS = 3.0
"""The scale is at least so many times as high as the band of rest."""

LEAST_MM = 0.02
"""The least height of a chart: a last digit that flickers must not look like a step."""

SCALE_COLUMNS, LEAST_COLUMNS = 13, 30
"""Room for the scale beside a chart, and from how many columns on there is any."""

EVERY = 4
"""The edges of the band have one dot in so many."""


def strip_rows(trace: Trace, columns: int, rows: int) -> tuple[str, ...]:
    """The strip chart in a place of so many cells, with its scale at the right where that fits."""
    if columns < LEAST_COLUMNS or not trace.moments:
        return chart_rows(trace, columns, rows)
    chart = chart_rows(trace, columns - SCALE_COLUMNS, rows)
    pairs = zip(chart, scale_rows(trace, rows), strict=True)
    return tuple(f"{row}{label:>{SCALE_COLUMNS}}" for row, label in pairs)


def scale_rows(trace: Trace, rows: int) -> tuple[str, ...]:
    """Words beside each row: the height and the width of the chart, the values at its edges.

    Of the rest limit, too, where there is room.
    """
    lower, upper = _scale(trace)
    size = _length_words(upper - lower)
    if trace.span_s:
        size += f", {trace.span_s:g} s"
    if rows < 3:
        return (size, *[""] * (rows - 1))[:rows]
    decimals = 3 if upper - lower < 1.0 else 2 if upper - lower < 10.0 else 1
    labels = [""] * rows
    labels[0], labels[-1] = signed(upper, decimals), signed(lower, decimals)
    labels[1] = size
    rest_mm = trace.band_mm[1] - trace.band_mm[0]
    if rows > 3 and rest_mm > 0.0:
        labels[2] = f"rest {_length_words(rest_mm)}"
    return tuple(labels)


def _length_words(length_mm: float) -> str:
    """``20 µm`` or ``2 mm``."""
    return f"{1e3 * length_mm:.3g} µm" if length_mm < 0.9995 else f"{length_mm:.4g} mm"


def chart_rows(trace: Trace, columns: int, rows: int) -> tuple[str, ...]:
    """The chart alone, the present at its right end.

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
    previous = trace.moments[0]
    for moment in trace.moments:
        ago, low, high_mm = moment
        if previous[0] == ago + 1:
            low, high_mm = min(low, previous[2]), max(high_mm, previous[1])
        previous = moment
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
    """Lower and upper end in mm: a round height, which keeps still while the readings do.

    At rest the band is in the middle; else the readings are.
    """
    low_mm, high_mm = trace.band_mm
    ends = (low_mm, high_mm) if high_mm > low_mm else trace.moments[-1][1:]
    lower = min(ends[0], *(low for _, low, _ in trace.moments))
    upper = max(ends[1], *(top for _, _, top in trace.moments))
    least = max(LEAST_MM, BANDS * (high_mm - low_mm))
    heights = (digit * 10.0**power for power in count(-2) for digit in (1.0, 2.0, 5.0))
    centre = sum(ends) / 2.0
    for height in heights:
        if height < least - 1e-9:
            continue
        middle = height / 5.0 * round(centre / (height / 5.0))
        if middle - height / 2.0 <= lower and upper <= middle + height / 2.0:
            return middle - height / 2.0, middle + height / 2.0
        centre = (lower + upper) / 2.0
    raise AssertionError("every height is tried")
