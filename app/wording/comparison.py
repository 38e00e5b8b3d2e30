"""Before and after in words."""

from __future__ import annotations

from app.comparing import Comparison
from app.wording.result import comparison_text
from app.wording.tables import wrapped


def comparison_report(comparison: Comparison) -> str:
    """Which sessions, what a reader must know, then the differences of both."""
    before, after = comparison.before, comparison.after
    heading = f"before: {before.names[0]}\nafter:  {after.names[0]}"
    remarks = [wrapped(f"Remark: {remark}") for remark in comparison.remarks]
    return "\n\n".join([heading, *remarks, comparison_text(before.solution, after.solution)])


COMPARISON_HELP = """\
Each difference between two postures, before and after the joint offsets
were entered in the controller. "Expected" is what the fit of the first
session left over: offsets cannot remove more than that.

G  the plot in the place of the text, and back
Y  copies the text"""
