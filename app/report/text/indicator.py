"""An indicator's outcome and the doctor's findings in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from app.report.text.tables import hanging
from drivers.doctor import PortFinding
from drivers.profile import Fault, Outcome, Profile

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
