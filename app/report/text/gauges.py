"""What the panel of an indicator says: its number, and a word for its state."""

from __future__ import annotations

from app.measuring.gauges import Live, Motion
from app.report.text.tables import signed
from calib.errors import sentence
from drivers.profile import Fault, IndicatorReading
from protocols.machine import Instrument

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


def panel_title(number: int, instrument: Instrument | None, axis: str) -> str:
    """Number and profile of an indicator, counted from 0, and along which axis it measures now."""
    along = f"along {axis.upper()}, mm" if axis else ""
    name = f"{number + 1} {instrument.profile}" if instrument else ""
    return f"{name} {along}".strip()


def port_words(port: str, live: Live) -> str:
    """Where it is, and whether its unit is a guess."""
    assumed = isinstance(live.outcome, IndicatorReading) and live.outcome.unit_assumed
    return ", ".join(filter(None, [port, "mm assumed" if assumed else ""]))


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
