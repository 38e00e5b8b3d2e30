"""Two sessions of one machine side by side: before and after its offsets were entered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.evaluating.solution import SessionSolution, end_warning, solve_sessions
from calib.errors import CalibrationError, RecordError
from protocols.record import Record, read_record
from protocols.session import fold


@dataclass(frozen=True, eq=False)
class Comparison:
    """The joint-offset solutions of two sessions, and what a reader must know to trust them."""

    before: SessionSolution
    after: SessionSolution
    remarks: tuple[str, ...]


def compare_files(before: Path, after: Path) -> Comparison:
    """Solve both sessions for the joint offsets and lay them side by side.

    Raises RecordError for files that cannot be used or are the same session, CalibrationError for
    sessions with nothing in common.
    """
    earlier, later = read_record(before), read_record(after)
    if earlier.digest == later.digest:
        raise RecordError(
            f"sessions {before} and {after}", "the same session", "two different ones"
        )
    one, two = earlier.opened.machine, later.opened.machine
    # entered offsets may differ, that is what is compared; the geometry may not
    if one.geometry() != two.geometry():
        raise CalibrationError(
            f"sessions {before} and {after}",
            f"machines of different geometry, {one.name} and {two.name}",
            "two sessions of one machine",
        )
    first, second = (
        solve_sessions([record.path.name], [fold(record.events)], subset="joint-offsets")
        for record in (earlier, later)
    )
    measured, again = _differences(first), _differences(second)
    if not measured & again:
        raise CalibrationError(
            f"sessions {before} and {after}",
            "no difference that both measured",
            "two sessions with the same postures",
            "Measure both with the same procedure.",
        )
    remarks = [end_warning(record) for record in (earlier, later) if record.end != "closed"]
    if not measured <= again:
        remarks.append(
            f"Only {len(measured & again)} of {len(measured)} differences are in both sessions; "
            "each r.m.s. is over its own session."
        )
    return Comparison(first, second, (*remarks, *_order_remarks(earlier, later)))


def _differences(solved: SessionSolution) -> set[str]:
    """Names of the tabulated differences that a session measured."""
    found = solved.solution.differences
    return {found.names[k] for k in found.published_rows}


def _order_remarks(earlier: Record, later: Record) -> list[str]:
    """Whether the later session is the one that verifies the earlier."""
    said = []
    verifies = later.opened.verifies
    if verifies is not None and verifies != earlier.path.name:
        said.append(f"{later.path.name} was measured to verify {verifies}.")
    imported = "imported" in (earlier.opened.origin, later.opened.origin)
    if not imported and later.opened.at < earlier.opened.at:
        said.append(f"{later.path.name} is older than {earlier.path.name}: is the order right?")
    return said


def partner_of(path: Path, verifies: str | None) -> Path | None:
    """The session that another one verifies, where its file is still beside it."""
    beside = path.with_name(Path(verifies).name) if verifies else None
    return beside if beside is not None and beside.is_file() else None
