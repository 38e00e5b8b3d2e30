"""The Hexa Slide: from files and options to what is seen, postures, and simulated measurements."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from app.version import program
from calib.arrays import FloatArray
from calib.design.criteria import Criterion
from calib.errors import CalibrationError, RecordError, UsageError, check_number
from calib.hexaslide.geometry import COORDINATES, HexaSlide, in_degrees
from calib.hexaslide.planning import HexaSlidePlanning, HexaSlideSeen, conditions_at
from calib.hexaslide.procedures import Procedure, ProcedureKind
from calib.hexaslide.search import BestPostures, Search, judged_postures, searches
from calib.hexaslide.simulation import simulate
from protocols.data_table import csv_text
from protocols.files import write_files
from protocols.hexaslide import (
    LARGEST_VALUE,
    SCHEMA,
    TRUTH_SCHEMA,
    FileUnits,
    HexaSlideMachine,
    HexaSlideMeasurements,
    HexaSlideTruth,
    MeasuredPosture,
    MeasuringNoise,
    load_hexaslide,
    load_postures,
    machine_like,
    unit_question,
)

EXAMPLE, EXAMPLE_NAME = "hexaslide-h60.toml", "hexaslide"
"""File of the machine without a file, and what it is called on the command line."""

MOST_MOVED = 1000
"""More postures would take hours."""

ROOM = 3.0
"""Standard deviations of a slider between a posture and the end of its travel."""

AS_IS = "With --as-is postures are judged wherever they are."


@dataclass(frozen=True)
class Request:
    """What is asked of a procedure; ``postures`` are so many random ones, None: enough."""

    procedure: str
    machine_file: Path | None = None
    measured: tuple[str, ...] = ()
    known: tuple[str, ...] | None = None
    postures: int | None = None
    posture_file: Path | None = None
    seed: int = 0


def hexaslide_planning(request: Request) -> HexaSlidePlanning:
    """The planning from names and paths. Raises UsageError, RecordError, ImpossibleRequest."""
    file = request.posture_file
    if file is not None and request.postures is not None:
        raise UsageError("--posture-file and --postures", "both", "one of them")
    machine_file = load_hexaslide(request.machine_file)
    return HexaSlidePlanning(
        procedure_on(machine_file, request.procedure, request.measured, request.known),
        machine_file.whole(),
        request.seed,
        request.postures,
        None if file is None else load_postures(file),
        "" if file is None else f"{file}",
        machine_file.name if request.machine_file else EXAMPLE_NAME,
        ROOM * machine_file.tolerances.slider_mm / 1000.0,
    )


def procedure_on(
    machine_file: HexaSlideMachine,
    name: str,
    measured: tuple[str, ...] = (),
    known: tuple[str, ...] | None = None,
) -> Procedure:
    """Raises UsageError for a machine without link, ImpossibleRequest for a name or component."""
    procedure = Procedure.of(name, measured, known).on(machine_file.whole())
    if procedure.kind is ProcedureKind.CONSTRAINT_LINK and machine_file.constraint_link is None:
        raise UsageError("machine file", "no [constraint_link]", "one for constraint-link")
    return procedure


def asked_postures(
    request: Request, count: int | None, search: Search | None = None, *, as_is: bool = False
) -> BestPostures:
    """The best postures, from those of the file if there is one, or those ``as_is``; where a person
    stops the search, the best of the starts that are done.

    Papers/001 minimises the condition number. Raises UsageError, RecordError, CalibrationError for
    postures that do not determine enough, KeyboardInterrupt before the first start is done.
    """
    search = replace(search or Search(), seed=request.seed)
    if search.criterion is Criterion.TOOL_VARIANCE:
        raise UsageError("--criterion", search.criterion.value, "the other five for the hexaslide")
    planned = hexaslide_planning(request)
    if planned.given is not None:
        fixed = len(planned.given)
        if count not in (None, fixed):
            raise UsageError("--count", f"{count}", f"{fixed} as in the posture file, or none")
        search, count = replace(search, source=planned.source), fixed
        if as_is:
            return judged_postures(planned.procedure, planned.machine, planned.given, search)
        search = replace(search, given=inside_box(planned.given, planned.machine, AS_IS))
    elif as_is:
        raise UsageError("--as-is", "no --posture-file", "one to judge")
    if count is None:
        raise UsageError("--count", "none", "how many postures to find, or a --posture-file")
    if count > MOST_MOVED:
        raise UsageError("--count", f"{count}", f"{MOST_MOVED} postures at most")
    return _searched(planned, count, search)


class _Stopped(Exception):
    """Nobody waits for the search any more."""


def better_and_better(
    view: HexaSlideSeen, count: int, stopped: Callable[[], bool]
) -> Iterator[tuple[BestPostures, dict[str, float]]]:
    """The best so many postures after each start of a search, with their condition numbers.

    It ends where it is ``stopped``. Raises CalibrationError for so few postures.
    """

    def watch() -> None:
        if stopped():
            raise _Stopped

    search = Search(seed=view.planned.seed)
    with suppress(_Stopped):
        for best in searches(view.procedure, view.planned.with_room, count, search, watch):
            yield best, conditions_at(view, best.coordinates)


def measuring(request: Request, components: str) -> Request:
    """The request with other measured components, as a person types them."""
    measured = tuple(part.strip() for part in components.split(","))
    linked = request.procedure == ProcedureKind.CONSTRAINT_LINK
    kind = ProcedureKind.CONSTRAINT_LINK if linked else ProcedureKind.POSE_FORWARD
    return replace(request, procedure=kind, measured=measured)


def _searched(planning: HexaSlidePlanning, count: int, search: Search) -> BestPostures:
    best: BestPostures | None = None
    to_its_ends = search.given is not None or search.space == "joints"
    machine = planning.machine if to_its_ends else planning.with_room
    try:
        for postures_found in searches(planning.procedure, machine, count, search):
            best = postures_found
    except KeyboardInterrupt:
        if best is None:
            raise
    assert best is not None, "one start at least"
    return best


def inside_box(postures: FloatArray, machine: HexaSlide, advice: str = "") -> FloatArray:
    """The postures of a file, on the bounds where only rounding is outside. Raises RecordError."""
    try:
        return machine.inside(postures)
    except CalibrationError as problem:
        next_step = unit_question(postures, machine.box) or advice
        raise RecordError(
            f"posture file, {problem.thing}", problem.found, problem.allowed, next_step
        ) from problem


def posture_table(postures: FloatArray) -> str:
    """A table of postures ``(p, 6)`` that ``--posture-file`` reads, units in its header line."""
    return table(COORDINATES, [list(row.values()) for row in in_degrees(postures)])


def table(names: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    """Names, then numbers."""
    return csv_text([names, *([f"{value:.12g}" for value in row] for row in rows)])


def write_simulated(
    request: Request,
    output: Path | None,
    truth: Path | None,
    *,
    noise_mm: float | None = None,
    angle_noise_mrad: float | None = None,
    errors_mm: float | None = None,
    replace: bool = False,
) -> HexaSlideMeasurements:
    """Measurements on a machine that differs from its file, and that machine, into files.

    Without ``output`` the measurements are only returned.
    ``errors_mm`` is the size of each error, 1 mm where it is None, ``noise_mm`` 0.01 mm; as many
    mrad as that is the noise of angles. Raises UsageError for a procedure, noise or target, and for
    a machine whose sliders stand beyond all measure, RecordError for the machine file,
    CalibrationError for postures or machines that cannot be, and as `write_files`.
    """
    if truth is not None and output is not None and truth.resolve() == output.resolve():
        raise UsageError("--truth and --output", f"{output} twice", "two files")
    machine_file = load_hexaslide(request.machine_file)
    procedure = procedure_on(machine_file, request.procedure, request.measured)
    length_mm = 0.01 if noise_mm is None else noise_mm
    angle_mrad = length_mm if angle_noise_mrad is None else angle_noise_mrad
    if (angle_mrad == 0.0) != (length_mm == 0.0):
        raise UsageError(
            "--noise and --angle-noise", f"{length_mm:g} and {angle_mrad:g}", "both 0, or neither"
        )
    nominal, file = machine_file.whole(), request.posture_file
    readings, true = simulate(
        procedure,
        nominal,
        (request.postures or 0) if file is None else inside_box(load_postures(file), nominal),
        request.seed,
        errors_m=(1.0 if errors_mm is None else errors_mm) / 1000.0,
        length_noise_m=length_mm / 1000.0,
        angle_noise_rad=angle_mrad / 1000.0,
    )
    rows = [*zip(readings.sliders.tolist(), readings.measured.tolist(), strict=True)]
    furthest = max((value for parts in rows for part in parts for value in part), key=abs)
    check_number(
        "slider or reading of a posture", furthest, -LARGEST_VALUE, LARGEST_VALUE, "m or rad"
    )
    measured = HexaSlideMeasurements(
        schema=SCHEMA,
        program=program(),
        origin="simulated",
        seed=request.seed,
        procedure=procedure.kind,
        measured=procedure.measured,
        units=FileUnits(),
        noise=MeasuringNoise(length_mm=length_mm, angle_mrad=angle_mrad),
        machine_file=request.machine_file.name if request.machine_file else EXAMPLE,
        machine=machine_file,
        postures=tuple(MeasuredPosture(sliders=tuple(s), values=tuple(v)) for s, v in rows),
    )
    if output is not None:
        write_files(output, {"": measured.text()}, replace=replace)
    if truth is not None:
        hidden = HexaSlideTruth(
            schema=TRUTH_SCHEMA,
            measurements_sha256=measured.digest(),
            machine=machine_like(machine_file, f"{machine_file.name}, as it truly is", true),
        )
        write_files(truth, {"": hidden.text()}, replace=replace)
    return measured
