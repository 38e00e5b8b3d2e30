"""An indicator in words: its panel, its outcome, the findings of the doctor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from app.measuring.gauges import Live, Motion
from app.report.text.tables import hanging, signed
from calib.errors import sentence
from drivers.doctor import PortFinding
from drivers.profile import Fault, IndicatorReading, Outcome, Profile
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


INDENT = " " * 9  # to the words behind the arrow


def outcome_text(outcome: Outcome) -> str:
    """One line for one outcome."""
    if isinstance(outcome, Fault):
        return f"{outcome.kind}: {outcome.words}"
    decimals = len(f"{outcome.resolution_mm:.7f}".rstrip("0").partition(".")[2])
    assumed = " (unit assumed)" if outcome.unit_assumed else ""
    warning = f"  {outcome.warning}" if outcome.warning else ""
    return f"{outcome.value_mm:+.{decimals}f} mm{assumed}  {outcome.text!r}{warning}"


def findings_text(findings: Iterable[PortFinding]) -> str:
    """Every finding on a line of its own, the next step below what is wrong."""
    lines = []
    for finding in findings:
        lines.append(
            hanging(f"{'ok   ' if finding.well else 'FAULT'}  {finding.description}", INDENT)
        )
        if not finding.well and finding.next_step:
            lines.append(hanging(f"       → {finding.next_step}", INDENT))
    return "\n".join(lines)


def trial_text(number: int, count: int, group: Sequence[Profile]) -> str:
    """Which profiles are being tried, as the doctor goes on."""
    how = "listening" if group[0].request is None else "asking"
    return f"{number:>2} of {count}  {how} as {', '.join(profile.name for profile in group)}"
