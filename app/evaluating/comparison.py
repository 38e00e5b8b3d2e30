"""Two sessions of one machine side by side: before and after its offsets were entered."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Literal

from app.evaluating.loading import refuse_twice
from app.evaluating.solution import SessionSolution, decided_in, solve_sessions
from app.evaluating.tolerance import check_tolerance
from calib.errors import CalibrationError
from calib.identify.accuracy import Decision
from calib.identify.solution import Solution
from calib.quantity import INTERNAL, Quantity
from calib.tripod.geometry import PARAMETER_NAMES
from protocols.machine import Machine
from protocols.observations import changed_between
from protocols.record import Record, read_record


@dataclass(frozen=True)
class BothValues:
    """A difference before and after the offsets were entered, mm; null: not measured."""

    before: Annotated[
        float, Quantity("before", "mm", "signed", 3, "the difference in the first session")
    ]
    after: Annotated[
        float | None,
        Quantity(
            "after", "mm", "signed", 3, "the difference in the second session", "not measured"
        ),
    ]


def both_values(earlier: Solution, later: Solution) -> dict[str, BothValues]:
    """The differences of the papers, by name."""
    differences = later.tabulated
    return {
        name: BothValues(difference.value, differences[name].value if name in differences else None)
        for name, difference in earlier.tabulated.items()
    }


@dataclass(frozen=True, eq=False)
class Comparison:
    """The solutions of two sessions, and what a reader must know of them."""

    before: SessionSolution
    after: SessionSolution
    remarks: tuple[str, ...]
    changed: bool = False

    @property
    def differences(self) -> dict[str, BothValues]:
        """Differences of the two sessions, by name."""
        return both_values(self.before.solution, self.after.solution)

    @property
    def expected_mm(self) -> float | None:
        """R.m.s. that the first session promises; None across a mechanical change."""
        return None if self.changed else self.before.solution.rms_after_mm


MOVED = (
    "Between these sessions the machine was mechanically changed. Earlier joint offsets and "
    "effects are not valid after it, and nothing is predicted across it."
)


SAME_PRINTER_MM = 25.0
"""Two printers differ by more. A guessed radius was up to 16 mm off (docs/benchmarks.md)."""

IN_FIRMWARE = (
    "Between these sessions the firmware got other lengths, radius, angles or travels: each "
    "session refers to the values of that time."
)


def compare_files(
    earlier_path: Path, later_path: Path, *, result: SessionSolution | None = None
) -> Comparison:
    """Solve both sessions and lay them side by side; ``result`` is the first solved with others.

    Raises RecordError for files that cannot be used or are the same session, CalibrationError for
    sessions with nothing in common.
    """
    earlier, later = read_record(earlier_path), read_record(later_path)
    refuse_twice([(earlier_path, earlier.session), (later_path, later.session)])
    machine, later_machine = earlier.opened.machine, later.opened.machine
    numbers = [machine.serial_number, later_machine.serial_number]
    if all(numbers) and numbers[0] != numbers[1]:
        raise CalibrationError(
            f"sessions {earlier_path} and {later_path}",
            f"serial numbers of two machines, {numbers[0]} and {numbers[1]}",
            "two sessions of one machine",
        )
    # entered offsets may differ, that is what is compared; the geometry may where firmware holds it
    if machine.geometry() != later_machine.geometry() and not _one_printer(machine, later_machine):
        raise CalibrationError(
            f"sessions {earlier_path} and {later_path}",
            f"machines of different geometry, {machine.name} and {later_machine.name}",
            "two sessions of one machine",
        )
    sessions = earlier.session, later.session
    first, second = result or solve_sessions(sessions[:1]), solve_sessions(sessions[1:])
    measured, again = (result.solution.tabulated.keys() for result in (first, second))
    if not measured & again:
        raise CalibrationError(
            f"sessions {earlier_path} and {later_path}",
            "no difference that both measured",
            "two sessions with the same postures",
            "Measure both with the same procedure.",
        )
    changed = sessions[0].adjusted != sessions[1].adjusted
    remarks = [MOVED] if changed else []
    remarks += [IN_FIRMWARE] if _firmware_values(machine) != _firmware_values(later_machine) else []
    remarks += [record.unfinished for record in (earlier, later) if record.unfinished]
    if measured != again:
        remarks.append(
            f"Only {len(measured & again)} of {len(measured | again)} differences are in both "
            "sessions; "
            "each r.m.s. is over its own session."
        )
    return Comparison(first, second, (*remarks, *_order_remarks(earlier, later)), changed)


def _one_printer(machine: Machine, later_machine: Machine) -> bool:
    """Whether firmware may hold both geometries of one printer, whatever its files are called."""
    if machine.position_endstop_mm is None or later_machine.position_endstop_mm is None:
        return False
    first, second = machine.geometry(), later_machine.geometry()
    parts = (first.lengths - second.lengths, first.anchors - second.anchors)
    return max(float(abs(part).max()) for part in parts) < SAME_PRINTER_MM


def _firmware_values(machine: Machine) -> tuple[object, ...]:
    """What firmware holds of a machine beside its switches, which limit the travel."""
    geometry = machine.geometry()
    names = {part.name for part in fields(geometry)} - {"travel_min_mm", "travel_max_mm"}
    values = tuple(getattr(geometry, name) for name in sorted(names))
    return *values, machine.rotation_distance_mm, machine.steps_per_mm


def _order_remarks(earlier: Record, later: Record) -> list[str]:
    """Whether the later session is the one that verifies the earlier."""
    remarks = []
    verifies = later.opened.verifies
    if verifies is not None and verifies != earlier.path.name:
        remarks.append(f"{later.path.name} was measured to verify {verifies}.")
    first, second = earlier.opened, later.opened
    if first.is_dated and second.is_dated and second.measured_at < first.measured_at:
        remarks.append(f"{later.path.name} is older than {earlier.path.name}: is the order right?")
    return remarks


def partner_of(path: Path, verifies: str | None) -> Path | None:
    """The session that another one verifies, where its file is still beside it."""
    partner = path.with_name(Path(verifies).name) if verifies else None
    return partner if partner is not None and partner.is_file() else None


def reported_pair(path: Path) -> tuple[Path, Path | None]:
    """What the report of a session is about: of one that verifies another beside it, both.

    It is of one alone where the machine was mechanically changed between them. Raises RecordError
    for a file that cannot be used.
    """
    session = read_record(path).session
    earlier_path = partner_of(path, session.opened.verifies)
    if earlier_path is None or read_record(earlier_path).session.adjusted != session.adjusted:
        return path, None
    return earlier_path, path


Entered = Literal["as expected", "not shown", "not entered", "wrong sign", "something else"]

LESS_COMMON = "Joint offsets are compared less what all three share: a plate does not show that."


@dataclass(frozen=True)
class RemainingOffset:
    """A joint offset before, and what is left of it, mm; 0 within ``expanded_mm`` is expected.

    ``standard_mm`` is the standard uncertainty.
    """

    name: Annotated[str, Quantity("joint offset", words="the joint")]
    before_mm: Annotated[
        float, Quantity("before", "mm", "measured", 4, "offset that the first session found")
    ]
    found_mm: Annotated[
        float, Quantity("remaining", "mm", "measured", 4, "offset that the second session found")
    ]
    expanded_mm: Annotated[
        float,
        Quantity(
            "± U of both",
            "mm",
            "uncertainty",
            4,
            "expanded (95 %); 1.7 times as much passes for expected",
        ),
    ]
    entered: Annotated[Entered, Quantity("", words="what became of the value at the controller")]
    standard_mm: float = field(metadata=INTERNAL)


SURE = 1.7
"""Of U (95 %): of three sound offsets one is beyond U in 14 of 100 verifications, beyond this in 3
of 1,000. Only then it is asked what was changed mechanically."""


def entered_word(before_mm: float, found_mm: float, expanded_mm: float) -> Entered:
    """What must have happened to the value at the controller.

    Within U of both 0 and the old error, the readings do not show whether it was entered.
    """
    guesses: tuple[tuple[float, Entered], ...] = (
        (0.0, "as expected"),
        (before_mm, "not entered"),
        (2.0 * before_mm, "wrong sign"),
    )
    near = [word for value, word in guesses if abs(found_mm - value) <= expanded_mm]
    if "as expected" in near and "not entered" in near:
        return "not shown"
    if near:
        return near[0]
    off_mm, word = min((abs(found_mm - value), word) for value, word in guesses)
    return word if off_mm <= SURE * expanded_mm else "something else"


@dataclass(frozen=True, eq=False)
class Verification:
    """Two sessions, the second with the offsets of the first entered.

    ``decision`` is None where no tolerance is known.
    """

    compared: Comparison
    offsets: tuple[RemainingOffset, ...]
    tolerance_mm: float | None
    decision: Decision | None


def verify_files(
    earlier_path: Path,
    later_path: Path,
    tolerance_mm: float | None = None,
    *,
    result: SessionSolution | None = None,
) -> Verification:
    """Judge the second session by the first, or by what it is ``result`` to with others.

    The tolerance is the given one, else that of the later machine file, else of the earlier.

    Raises as `compare_files`, and UsageError for a tolerance that is no positive length.
    """
    check_tolerance(tolerance_mm)
    compared = compare_files(earlier_path, later_path, result=result)
    if compared.changed:
        raise changed_between(f"sessions {earlier_path} and {later_path}", "solve")
    earlier, later = compared.before, compared.after
    common = later.sessions[0].opened.machine.set_at_zero or False
    if common:
        compared = replace(compared, remarks=(*compared.remarks, LESS_COMMON))
    tolerances_mm = (
        result.sessions[-1].opened.machine.tool_tolerance_mm for result in (later, earlier)
    )
    tolerance = tolerance_mm or next(filter(None, tolerances_mm), None)
    decision = None
    if tolerance:
        decision = decided_in(later.corrections.off_now, later.frame, tolerance)
    offsets = _remaining(earlier, later, common=common)
    compared = replace(compared, remarks=(*compared.remarks, *_record_remarks(compared, offsets)))
    return Verification(compared, offsets, tolerance, decision)


def _record_remarks(compared: Comparison, offsets: Sequence[RemainingOffset]) -> Iterator[str]:
    """Whether the later record names what was entered: a history and later sessions take it so."""
    earlier, later = (
        result.sessions[0].opened.machine for result in (compared.before, compared.after)
    )
    if later.position_endstop_mm:
        return
    pairs = zip(earlier.entered_offsets_mm, later.entered_offsets_mm, offsets, strict=True)
    forgotten = [
        offset.name
        for was_mm, named_mm, offset in pairs
        if offset.entered == "as expected"
        and abs(named_mm - was_mm - offset.before_mm) > offset.expanded_mm
    ]
    if forgotten:
        yield (
            f"The readings show that {', '.join(forgotten)} of {compared.before.names[0]} was "
            f"entered, but not entered_offsets_mm of {compared.after.names[0]}: glidecal history "
            "takes it for a change of the machine. Mend the machine file."
        )


def _remaining(
    earlier: SessionSolution, later: SessionSolution, *, common: bool
) -> tuple[RemainingOffset, ...]:
    """Joint offsets of both corrections; ``common`` is taken off where a plate does not show it."""
    entered, remaining = (_offsets(result, common=common) for result in (earlier, later))
    offsets = []
    for name, (was, half, u), (now, half_now, u_now) in zip(
        PARAMETER_NAMES[:3], entered, remaining, strict=True
    ):
        expanded_mm, standard_mm = math.hypot(half, half_now), math.hypot(u, u_now)
        word = entered_word(was, now, expanded_mm)
        offsets.append(RemainingOffset(name, was, now, expanded_mm, word, standard_mm))
    return tuple(offsets)


def _offsets(result: SessionSolution, *, common: bool) -> list[tuple[float, float, float]]:
    """Offsets that are entered, their 95 % half widths and standard uncertainties, mm."""
    standard_mm, half_widths_mm = result.corrections.uncertainties_mm(less_common=common)
    values_mm = result.joint_offsets_mm
    shared_mm = sum(values_mm) / len(values_mm) if common else 0.0
    return [
        (value - shared_mm, half, u)
        for value, half, u in zip(
            values_mm, half_widths_mm.tolist(), standard_mm.tolist(), strict=True
        )
    ]
