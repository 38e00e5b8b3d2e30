"""The Hexa Slide: from files and options to planning, from postures to files."""

from __future__ import annotations

from pathlib import Path

from app.planning.request import Request
from calib.design.criteria import Criterion
from calib.errors import CalibrationError, RecordError, UsageError
from calib.hexaslide.geometry import COORDINATES, HexaSlide
from calib.hexaslide.procedures import Kind, Procedure
from calib.hexaslide.search import BoxedPostures, boxed_postures, postures_as_given
from calib.hexaslide.seen import HexaSlidePlanning
from calib.observations import FloatArray
from protocols.files import write_files
from protocols.hexaslide_machine import HexaSlideMachine, load_hexaslide
from protocols.hexaslide_postures import load_postures

MOST_MOVED = 1000
"""More postures would take hours."""

AS_IS = "With --as-is postures are judged wherever they are."


def hexaslide_planning(request: Request) -> HexaSlidePlanning:
    """From names and paths. Raises UsageError, RecordError, ImpossibleRequest for a procedure."""
    file = request.posture_file
    if file is not None and request.postures is not None:
        raise UsageError("--posture-file and --postures", "both", "one of them")
    own = load_hexaslide(request.machine_file)
    return HexaSlidePlanning(
        procedure_on(own, request.procedure, request.measured, request.known),
        own.whole(),
        request.seed,
        request.postures,
        None if file is None else load_postures(file),
        "" if file is None else f"{file}",
    )


def procedure_on(
    own: HexaSlideMachine,
    name: str,
    measured: tuple[str, ...] = (),
    known: tuple[str, ...] | None = None,
) -> Procedure:
    """Raises UsageError for a machine without link, ImpossibleRequest for a name or component."""
    procedure = Procedure.of(name, measured, known)
    if procedure.kind is Kind.CONSTRAINT_LINK and own.constraint_link is None:
        raise UsageError("machine file", "no [constraint_link]", "one for constraint-link")
    return procedure


def asked_postures(
    request: Request,
    count: int | None,
    criterion: Criterion | None = None,
    *,
    starts: int,
    as_is: bool = False,
    output: Path | None = None,
) -> BoxedPostures:
    """The best postures, from those of the file if there is one, or those ``as_is``.

    ``criterion`` None is the condition number, as in papers/001. Raises UsageError, RecordError,
    CalibrationError for postures that do not determine enough.
    """
    _check_output(output)
    criterion = criterion or Criterion.CONDITION
    if criterion is Criterion.TOOL_VARIANCE:
        raise UsageError("--criterion", criterion.value, "the other five for the hexaslide")
    planned, given = hexaslide_planning(request), None
    if planned.given is not None:
        fixed = len(planned.given)
        if count not in (None, fixed):
            raise UsageError("--count", f"{count}", f"{fixed} as in the posture file, or none")
        if as_is:
            return postures_as_given(planned, criterion)
        given = inside_box(planned.given, planned.machine, AS_IS)
        count = fixed
    elif as_is:
        raise UsageError("--as-is", "no --posture-file", "one to judge")
    if count is None:
        raise UsageError("--count", "none", "how many postures to find, or a --posture-file")
    if count > MOST_MOVED:
        raise UsageError("--count", f"{count}", f"{MOST_MOVED} postures at most")
    return boxed_postures(planned, count, criterion, seed=request.seed, starts=starts, given=given)


def inside_box(given: FloatArray, machine: HexaSlide, advice: str = "") -> FloatArray:
    """The postures of a file, on the bounds where only rounding is outside. Raises RecordError."""
    try:
        return machine.box.inside(given)
    except CalibrationError as problem:
        raise RecordError(
            f"posture file, {problem.thing}", problem.found, problem.allowed, advice
        ) from problem


def _check_output(output: Path | None) -> None:
    if output is not None and output.suffix != ".csv":
        raise UsageError("--output", f"{output}", "a path that ends with .csv for the hexaslide")


def write_postures(found: BoxedPostures, path: Path) -> Path:
    """A table that ``--posture-file`` reads, units in its header line. Raises RecordError."""
    _check_output(path)
    rows = [[f"{value:.12g}" for value in row.values()] for row in found.postures]
    write_files(path, {"": "".join(f"{','.join(row)}\n" for row in [COORDINATES, *rows])})
    return path
