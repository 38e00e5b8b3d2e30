"""An indicator's outcome and the doctor's findings in words."""

from __future__ import annotations

from collections.abc import Iterable

from app.wording.tables import wrapped
from drivers.doctor import Finding
from drivers.outcome import Fault, Outcome


def outcome_text(outcome: Outcome) -> str:
    """One line for one outcome."""
    if isinstance(outcome, Fault):
        return f"{outcome.kind}: {outcome.words}"
    decimals = len(f"{outcome.resolution_mm:.7f}".rstrip("0").partition(".")[2])
    assumed = " (unit assumed)" if outcome.unit_assumed else ""
    warning = f"  {outcome.warning}" if outcome.warning else ""
    return f"{outcome.value_mm:+.{decimals}f} mm{assumed}  {outcome.text!r}{warning}"


def findings_text(findings: Iterable[Finding]) -> str:
    """Every finding on a line of its own, the next step below what is wrong."""
    lines = []
    for finding in findings:
        lines.append(wrapped(f"{'ok   ' if finding.well else 'FAULT'}  {finding.what}"))
        if not finding.well and finding.next_step:
            lines.append(wrapped(f"       → {finding.next_step}"))
    return "\n".join(lines)
