"""An indicator's outcome and the doctor's findings in words."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import fill

from app.report.text.tables import WIDTH
from drivers.doctor import Finding
from drivers.profile import Fault, Outcome


def outcome_text(outcome: Outcome) -> str:
    """One line for one outcome."""
    if isinstance(outcome, Fault):
        return f"{outcome.kind}: {outcome.words}"
    decimals = len(f"{outcome.resolution_mm:.7f}".rstrip("0").partition(".")[2])
    assumed = " (unit assumed)" if outcome.unit_assumed else ""
    warning = f"  {outcome.warning}" if outcome.warning else ""
    return f"{outcome.value_mm:+.{decimals}f} mm{assumed}  {outcome.text!r}{warning}"


def _hanging(text: str) -> str:
    """Broken at the width of a plain terminal, later lines set in."""
    return fill(text, WIDTH, subsequent_indent=" " * 9, break_long_words=False)


def findings_text(findings: Iterable[Finding]) -> str:
    """Every finding on a line of its own, the next step below what is wrong."""
    lines = []
    for finding in findings:
        lines.append(_hanging(f"{'ok   ' if finding.well else 'FAULT'}  {finding.what}"))
        if not finding.well and finding.next_step:
            lines.append(_hanging(f"       → {finding.next_step}"))
    return "\n".join(lines)
