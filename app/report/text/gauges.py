"""What the panel of an indicator says: its number, and a word for its state."""

from __future__ import annotations

from app.measuring.gauges import Live, Motion
from app.report.text.tables import signed
from calib.errors import sentence
from drivers.profile import Fault, IndicatorReading

MARKS = {
    Motion.STABLE: "= STABLE",
    Motion.MOVING: "~ MOVING",
    Motion.WAITING: "… WAITING",
    Motion.STALE: "! STALE",
    Motion.FAULT: "! FAULT",
}
NO_NUMBER = "------"
OLD_S = 1.0
"""A value is shown with its age from here on."""


def shown_number(live: Live) -> str:
    """The value with as many digits as its resolution has."""
    if not isinstance(live.outcome, IndicatorReading):
        return NO_NUMBER
    resolution = f"{live.outcome.resolution_mm:.6f}".rstrip("0")
    return signed(live.outcome.value_mm, max(0, len(resolution) - 2))


def state_words(live: Live) -> str:
    """A mark and a word, then the fault, or the age of an old value."""
    state = MARKS[live.motion]
    if isinstance(live.outcome, Fault):
        return f"{state}  {sentence(live.outcome.words)}"
    return f"{state}  {live.age_s:.0f} s old" if live.age_s >= OLD_S else state
