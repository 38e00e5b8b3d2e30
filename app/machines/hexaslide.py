"""The Hexa Slide as commands ask it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from app.machines.hexaslide_sessions import SESSIONS
from app.machines.options import (
    Answer,
    Family,
    PostureSearch,
    ScreenAnswer,
    deliver,
    file,
    machine_file_of,
    may_replace,
    may_write,
    number,
    option,
    parts,
    say,
    tell_warnings,
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


def identifiability(
    _name: str,
    procedure: str | None,
    machine_file: Path | None,
    *,
    measured: MeasuredDistance = "",
    known: Known = None,
    postures: Annotated[int | None, option("Hexa Slide: random postures.", min=1, max=10_000)] = (
        None
    ),
    posture_file: Annotated[Path | None, file("Hexa Slide: postures of a .csv or .json file.")] = (
        None
    ),
    seed: Annotated[int, option("Seed of random postures.", min=0)] = 0,
    screen: Annotated[bool, option("Hexa Slide: show the postures on a screen.", "--screen")] = (
        False
    ),
) -> Answer[Any] | ScreenAnswer:
    """What the procedure sees, with what papers/001 says of it; on a screen where that is wished.

    Measured components alone are those of a posture. Raises UsageError without either.
    """
    from app.planning.hexaslide import Request, hexaslide_planning
    from app.report.schema.hexaslide import HexaSlideIdentifiabilityReport
    from app.report.streams import need_terminal
    from app.report.text.hexaslide import seen_text
    from calib.hexaslide.planning import look_at

    request = Request(
        procedure or "pose-forward",
        machine_file,
        measured=parts(measured),
        known=_parts_known(known),
        postures=postures,
        posture_file=posture_file,
        seed=seed,
    )
    if not (procedure or request.measured):
        raise UsageError(
            "--procedure", "none", "the name of a procedure", "For hexaslide --measured also does."
        )
    if screen:
        need_terminal("--screen", "the verb without it")
    planned = hexaslide_planning(request)
    if screen:
        return ScreenAnswer(partial(_screen, request))
    with working("Looking at the postures"):
        planning_view = look_at(planned)
    return Answer(
        planning_view,
        seen_text,
        lambda view: HexaSlideIdentifiabilityReport.of(view.seen, view),
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


def postures(
    _name: str,
    procedure: str,
    machine_file: Path | None,
    search: PostureSearch,
    *,
    measured: MeasuredDistance = "",
    known: Known = None,
    posture_file: Annotated[Path | None, file("Hexa Slide: .csv or .json file to start from.")] = (
        None
    ),
    as_is: Annotated[bool, option("Only judge the --posture-file, move nothing.", "--as-is")] = (
        False
    ),
    space: Annotated[
        Literal["box", "joints", "link"] | None,
        option(
            "Hexa Slide: where to search: box, joints (all that the rails allow), or link "
            "(what the constraint link allows); default link where the procedure has one.",
            show_default=False,
        ),
    ] = None,
    scaled: Annotated[bool, option("Hexa Slide: a criterion that no unit changes.", "--scaled")] = (
        False
    ),
    few: Annotated[
        bool, option("Hexa Slide: fewer postures than show all, as in papers/001.", "--few")
    ] = False,
) -> Answer[Any]:
    """Postures anywhere in the box, or between the ends of the rails."""
    from app.planning.hexaslide import Request, asked_postures, posture_table
    from app.report.schema.hexaslide import HexaSlidePosturesReport
    from app.report.text.hexaslide import postures_text
    from calib.design.criteria import Criterion
    from calib.hexaslide.search import Search
    from protocols.files import write_files

    request = Request(
        procedure,
        machine_file,
        measured=parts(measured),
        known=_parts_known(known),
        posture_file=posture_file,
        seed=search.seed,
    )
    criterion = Criterion(search.criterion)
    of_machine = Search(criterion, starts=search.starts, space=space, scaled=scaled, few=few)
    may = may_write(search.output, ".csv", force=search.force)
    with working("Looking for postures"):
        best = asked_postures(request, search.count, of_machine, as_is=as_is)
    if search.output:
        write_files(search.output, {"": posture_table(best.coordinates)}, replace=may)
        say(f"postures written to {search.output}")
    return Answer(best, postures_text, HexaSlidePosturesReport.of)


def simulate(
    output: Path,
    machine: str | None,
    seed: int,
    force: bool,
    *,
    procedure: Annotated[str | None, option("Hexa Slide: pose-inverse, position, …")] = None,
    postures: Annotated[int | None, option("Hexa Slide: how many, random.", min=1, max=10_000)] = (
        None
    ),
    noise: Annotated[
        float | None, number("Hexa Slide: standard deviation of a measured length, mm.", 0.0, 10.0)
    ] = None,
    angle_noise: Annotated[
        float | None,
        number("Hexa Slide: of a measured angle, mrad; default as --noise.", 0.0, 10.0),
    ] = None,
    errors: Annotated[
        float | None, number("Hexa Slide: of each hidden error, mm (default 1).", 0.0, 10.0)
    ] = None,
    measured: Annotated[str | None, option("Hexa Slide: such as x,y,z,theta or turn1,swing1.")] = (
        None
    ),
    machine_file: Annotated[Path | None, file("Hexa Slide: machine file (TOML).")] = None,
    posture_file: Annotated[Path | None, file("Hexa Slide: these postures (CSV, JSON).")] = None,
    truth: Annotated[Path | None, file("Hexa Slide: file for the true machine.")] = None,
) -> None:
    """Measured postures into a file."""
    from app.planning.hexaslide import Request, write_simulated
    from app.report.text.hexaslide_calibration import simulated_text
    from protocols.files import STANDARD_OUTPUT

    if procedure is None or (posture_file is None) == (postures is None):
        raise UsageError(
            "--procedure, --postures, --posture-file",
            "too few or too many",
            "with --machine hexaslide a procedure and either a number or a file of postures",
        )
    request = Request(
        procedure,
        machine_file_of(machine or NAMES[0], NAMES, machine_file),
        parts(measured),
        postures=postures,
        posture_file=posture_file,
        seed=seed,
    )
    printed = output == STANDARD_OUTPUT
    target = None if printed else output
    measured_postures = write_simulated(
        request,
        target,
        truth,
        noise_mm=noise,
        angle_noise_mrad=angle_noise,
        errors_mm=errors,
        replace=may_replace(force, target, truth),
    )
    if printed:
        typer.echo(measured_postures.text(), nl=False)
    else:
        say(f"{simulated_text(measured_postures)}, written to {output}")
    if truth is not None:
        say(f"the true machine written to {truth}")


def solve(
    files: Sequence[Path],
    *,
    model: Annotated[
        Path | None, file("Fit the sizes of this model's effects together with the parameters.")
    ] = None,
    truth: Annotated[Path | None, file("Hexa Slide: the true machine that simulate wrote.")] = None,
    held_out: Annotated[
        float | None,
        number("Hexa Slide: share of postures kept out as a check (default 0.2).", 0.0, 0.9),
    ] = None,
    corrected: Annotated[
        Path | None, file("Hexa Slide: folder for the calibrated machine and its kinematics.")
    ] = None,
    posture_file: Annotated[
        Path | None, file("Hexa Slide: desired postures; --corrected writes their commands.")
    ] = None,
    force: Annotated[bool, option("Hexa Slide: replace files of --corrected.", "--force")] = False,
) -> Answer[Any]:
    """Identify from one file of measured postures."""
    from app.evaluating.hexaslide_calibration import SHARE, calibrate_file
    from app.report.schema.hexaslide import HexaSlideCalibrationReport
    from app.report.text.hexaslide_calibration import calibration_text

    if len(files) != 1:
        raise UsageError(FAMILY.measured, f"{len(files)} files", "one file")
    if posture_file is not None and corrected is None:
        raise UsageError("--posture-file", "no --corrected", "both, or none")
    share = SHARE if held_out is None else held_out
    with working("Solving"):
        result = calibrate_file(files[0], truth, share, model)
    tell_warnings(result.warnings)
    if corrected is not None:
        from app.exports.hexaslide import calibrated_files, kinematics_words

        deliver(corrected, calibrated_files(result, posture_file), force=force)
        say(f"glidecal: {kinematics_words(result.entered)}")
    return Answer(result, calibration_text, HexaSlideCalibrationReport.of)


FAMILY = Family(
    name="hexaslide",
    names=NAMES,
    schema="glidecal.hexaslide/2",
    measured="measured postures of a hexaslide",
    criterion="condition",
    posture_file="Hexa Slide: postures (.csv)",
    reads=reads,
    identifiability=identifiability,
    postures=postures,
    simulate=simulate,
    solve=solve,
    look=LOOK,
    sessions=SESSIONS,
)
