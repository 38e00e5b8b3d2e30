"""The Hexa Slide as commands ask it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from app.machines.hexaslide_sessions import SESSIONS, ImportOptions, RunOptions, tell_warnings
from app.machines.options import (
    Answer,
    Family,
    PostureSearch,
    Question,
    Say,
    ScreenAnswer,
    Simulation,
    deliver,
    file,
    machine_file_of,
    may_replace,
    may_write,
    number,
    option,
    parts,
    working,
)
from app.screens import Look
from calib.errors import UsageError
from protocols.machine_files import beginning_of

if TYPE_CHECKING:  # heavy: imported where used
    from app.evaluating.posture_history import PostureEntry
    from app.planning.hexaslide import Request
    from app.screens.hexaslide import HexaSlideScreen
    from app.screens.hexaslide_result import HexaSlideResultScreen

NAMES = ("hexaslide",)
MeasuredDistance = Annotated[
    str, option("Hexa Slide: measured components, such as x,y,z,theta,swing1.")
]
Known = Annotated[
    str | None,
    option("Constraint link: known parts of c,d,length, or none.", show_default="length"),
]


def _parts_known(typed: str | None) -> tuple[str, ...] | None:
    return None if typed is None else parts(typed.replace("none", ""))


@dataclass(frozen=True)
class IdentifiabilityOptions:
    """Options of ``identifiability``."""

    measured: MeasuredDistance = ""
    known: Known = None
    postures: Annotated[int | None, option("Hexa Slide: random postures.", min=1, max=10_000)] = (
        None
    )
    posture_file: Annotated[Path | None, file("Hexa Slide: postures of a .csv or .json file.")] = (
        None
    )
    seed: Annotated[int, option("Seed of random postures.", min=0)] = 0
    screen: Annotated[bool, option("Hexa Slide: show the postures on a screen.", "--screen")] = (
        False
    )


def identifiability(question: Question, options: IdentifiabilityOptions) -> Answer | ScreenAnswer:
    """What the procedure sees, with what papers/001 says of it; on a screen where that is wished.

    Measured components alone are those of a posture. Raises UsageError without either.
    """
    from app.planning.hexaslide import Request, hexaslide_planning
    from app.report.schema.hexaslide import HexaSlideIdentifiabilityReport
    from app.report.streams import need_terminal
    from app.report.text.hexaslide import seen_text
    from calib.hexaslide.planning import look_at

    request = Request(
        question.procedure or "pose-forward",
        question.machine_file,
        measured=parts(options.measured),
        known=_parts_known(options.known),
        postures=options.postures,
        posture_file=options.posture_file,
        seed=options.seed,
    )
    if not (question.procedure or request.measured):
        raise UsageError(
            "--procedure", "none", "the name of a procedure", "For hexaslide --measured also does."
        )
    if options.screen:
        need_terminal("--screen", "the verb without it")
    planned = hexaslide_planning(request)
    if options.screen:
        return ScreenAnswer(lambda: _screen(request))
    with working("Looking at the postures"):
        planning_view = look_at(planned)
    return Answer(
        lambda: seen_text(planning_view),
        lambda: HexaSlideIdentifiabilityReport.of(planning_view.seen, planning_view),
    )


def _screen(request: Request | None = None) -> HexaSlideScreen:
    from app.screens.hexaslide import HexaSlideScreen

    return HexaSlideScreen(request)


MARKS = (b"glidecal.hexaslide-measurements", b"glidecal.hexaslide-session")
"""One stands near the beginning of every file of measured postures, whole or cut."""


def reads(path: Path) -> bool:
    """Whether the file begins as measured postures; False where it cannot be read."""
    beginning = beginning_of(path)
    return any(mark in beginning for mark in MARKS)


def _past(path: Path, effects: bool) -> PostureEntry:
    from app.evaluating.hexaslide import posture_entry

    return posture_entry(path, effects)


PAGES = {"replay": "readings", "diagnose": "diagnosis"}
"""What a choice at home opens of a session, where it is not the result."""


def _opened(path: Path, page: str) -> HexaSlideResultScreen:
    from app.screens.hexaslide_result import HexaSlideResultScreen

    return HexaSlideResultScreen(path, PAGES.get(page, ""))


LOOK = Look(
    name="hexaslide",
    choice="Hexa Slide: what a procedure can identify, the best postures",
    words="""\
Hexa Slide     another machine: what can be identified, drawn, and where
               to measure; no readings are needed""",
    screen=_screen,
    reads=reads,
    past=_past,
    opened=_opened,
)


@dataclass(frozen=True)
class PostureOptions:
    """Options of ``postures``."""

    measured: MeasuredDistance = ""
    known: Known = None
    posture_file: Annotated[Path | None, file("Hexa Slide: .csv or .json file to start from.")] = (
        None
    )
    as_is: Annotated[bool, option("Only judge the --posture-file, move nothing.", "--as-is")] = (
        False
    )
    space: Annotated[
        Literal["box", "joints", "link"] | None,
        option(
            "Hexa Slide: where to search: box, joints (all that the rails allow), or link "
            "(what the constraint link allows); default link where the procedure has one.",
            show_default=False,
        ),
    ] = None
    scaled: Annotated[bool, option("Hexa Slide: a criterion that no unit changes.", "--scaled")] = (
        False
    )
    few: Annotated[
        bool, option("Hexa Slide: fewer postures than show all, as in papers/001.", "--few")
    ] = False


def postures(
    question: Question, search: PostureSearch, options: PostureOptions, say: Say
) -> Answer:
    """Postures anywhere in the box, or between the ends of the rails."""
    from app.planning.hexaslide import Request, asked_postures, posture_table
    from app.report.schema.hexaslide import HexaSlidePosturesReport
    from app.report.text.hexaslide import postures_text
    from calib.hexaslide.search import Search
    from protocols.files import write_files

    request = Request(
        question.procedure,
        question.machine_file,
        measured=parts(options.measured),
        known=_parts_known(options.known),
        posture_file=options.posture_file,
        seed=search.seed,
    )
    request_search = Search(
        search.criterion,
        starts=search.starts,
        space=options.space,
        scaled=options.scaled,
        few=options.few,
    )
    may = may_write(search.output, ".csv", force=search.force)
    with working("Looking for postures"):
        best = asked_postures(request, search.count, request_search, as_is=options.as_is)
    if search.output:
        write_files(search.output, {"": posture_table(best.coordinates)}, replace=may)
        say(f"postures written to {search.output}")
    return Answer(lambda: postures_text(best), lambda: HexaSlidePosturesReport.of(best))


@dataclass(frozen=True)
class SimulateOptions:
    """Options of ``simulate``."""

    procedure: Annotated[str | None, option("Hexa Slide: pose-inverse, position, …")] = None
    postures: Annotated[int | None, option("Hexa Slide: how many, random.", min=1, max=10_000)] = (
        None
    )
    noise: Annotated[
        float | None, number("Hexa Slide: standard deviation of a measured length, mm.", 0.0, 10.0)
    ] = None
    angle_noise: Annotated[
        float | None,
        number("Hexa Slide: of a measured angle, mrad; default as --noise.", 0.0, 10.0),
    ] = None
    errors: Annotated[
        float | None, number("Hexa Slide: of each hidden error, mm (default 1).", 0.0, 10.0)
    ] = None
    measured: Annotated[str | None, option("Hexa Slide: such as x,y,z,theta or turn1,swing1.")] = (
        None
    )
    machine_file: Annotated[Path | None, file("Hexa Slide: machine file (TOML).")] = None
    posture_file: Annotated[Path | None, file("Hexa Slide: these postures (CSV, JSON).")] = None
    truth: Annotated[Path | None, file("Hexa Slide: file for the true machine.")] = None


def simulate(simulation: Simulation, options: SimulateOptions, say: Say) -> None:
    """Measured postures into a file."""
    from app.planning.hexaslide import Request, write_simulated
    from app.report.text.hexaslide_calibration import simulated_text
    from protocols.files import STANDARD_OUTPUT

    if options.procedure is None or (options.posture_file is None) == (options.postures is None):
        raise UsageError(
            "--procedure, --postures, --posture-file",
            "too few or too many",
            "with --machine hexaslide a procedure and either a number or a file of postures",
        )
    request = Request(
        options.procedure,
        machine_file_of(simulation.machine or NAMES[0], NAMES, options.machine_file),
        parts(options.measured),
        postures=options.postures,
        posture_file=options.posture_file,
        seed=simulation.seed,
    )
    printed = simulation.output == STANDARD_OUTPUT
    output = None if printed else simulation.output
    may = may_replace(simulation.force, output, options.truth)
    measured = write_simulated(
        request,
        output,
        options.truth,
        noise_mm=options.noise,
        angle_noise_mrad=options.angle_noise,
        errors_mm=options.errors,
        replace=may,
    )
    if printed:
        typer.echo(measured.text(), nl=False)
    else:
        say(f"{simulated_text(measured)}, written to {simulation.output}")
    if options.truth is not None:
        say(f"the true machine written to {options.truth}")


@dataclass(frozen=True)
class SolveOptions:
    """Options of ``solve``."""

    model: Annotated[
        Path | None, file("Fit the sizes of this model's effects together with the parameters.")
    ] = None
    truth: Annotated[Path | None, file("Hexa Slide: the true machine that simulate wrote.")] = None
    held_out: Annotated[
        float | None,
        number("Hexa Slide: share of postures kept out as a check (default 0.2).", 0.0, 0.9),
    ] = None
    corrected: Annotated[
        Path | None, file("Hexa Slide: folder for the calibrated machine and its kinematics.")
    ] = None
    posture_file: Annotated[
        Path | None, file("Hexa Slide: desired postures; --corrected writes their commands.")
    ] = None
    force: Annotated[bool, option("Hexa Slide: replace files of --corrected.", "--force")] = False


def solve(files: Sequence[Path], options: SolveOptions, say: Say) -> Answer:
    """Identify from one file of measured postures."""
    from app.evaluating.hexaslide_calibration import SHARE, calibrate_file
    from app.report.schema.hexaslide import HexaSlideCalibrationReport
    from app.report.text.hexaslide_calibration import calibration_text

    if len(files) != 1:
        raise UsageError(FAMILY.measured, f"{len(files)} files", "one file")
    if options.posture_file is not None and options.corrected is None:
        raise UsageError("--posture-file", "no --corrected", "both, or none")
    share = SHARE if options.held_out is None else options.held_out
    with working("Solving"):
        result = calibrate_file(files[0], options.truth, share, options.model)
    tell_warnings(result.warnings)
    if options.corrected is not None:
        from app.exports.hexaslide import calibrated_files, kinematics_words

        deliver(
            options.corrected, calibrated_files(result, options.posture_file), force=options.force
        )
        say(f"glidecal: {kinematics_words(result.entered)}")
    return Answer(lambda: calibration_text(result), lambda: HexaSlideCalibrationReport.of(result))


FAMILY = Family(
    name="hexaslide",
    names=NAMES,
    schema="glidecal.hexaslide/2",
    measured="measured postures of a hexaslide",
    criterion="condition",
    posture_file="Hexa Slide: postures (.csv)",
    options={
        "identifiability": IdentifiabilityOptions,
        "postures": PostureOptions,
        "simulate": SimulateOptions,
        "solve": SolveOptions,
        "run": RunOptions,
        "import": ImportOptions,
    },
    reads=reads,
    identifiability=identifiability,
    postures=postures,
    simulate=simulate,
    solve=solve,
    look=LOOK,
    sessions=SESSIONS,
)
