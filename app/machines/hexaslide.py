"""The Hexa Slide as commands ask it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from app.machines.family import Answer, Family, Say, Search, Simulation, Solving
from app.planning.request import Request

NOISE_MM, ERRORS_MM = 0.01, 1.0
"""What is simulated where nothing is asked for."""

SHARE = 0.2
"""Of the postures, kept out as a check."""

POSTURE_OPTIONS = frozenset({"measured", "known", "posture_file"})


def identifiability(_name: str, request: Request) -> Answer:
    """What the procedure sees, with what papers/001 says of it."""
    from app.planning.hexaslide import hexaslide_planning
    from app.report.schema.hexaslide import HexaSlideIdentifiabilityReport
    from app.report.text.hexaslide import seen_text
    from calib.hexaslide.seen import look_at

    found = look_at(hexaslide_planning(_with_procedure(request)))
    return Answer(
        lambda: seen_text(found),
        lambda: HexaSlideIdentifiabilityReport.of(seen=found.seen, found=found),
    )


def look(request: Request) -> int:
    """The same on a screen."""
    from app.screens.start import open_hexaslide

    return open_hexaslide(_with_procedure(request))


def _with_procedure(request: Request) -> Request:
    """Measured components alone are those of a posture. Raises UsageError without either."""
    if request.procedure:
        return request
    if not request.measured:
        from calib.errors import UsageError

        raise UsageError(
            "--procedure", "none", "the name of a procedure", "For hexaslide --measured also does."
        )
    return replace(request, procedure="pose-forward")


def postures(_name: str, request: Request, search: Search, say: Say) -> Answer:
    """Postures anywhere in the box."""
    from app.planning.hexaslide import asked_postures, write_postures
    from app.report.schema.hexaslide import HexaSlidePosturesReport
    from app.report.text.hexaslide import postures_text

    found = asked_postures(
        request,
        search.count,
        search.criterion,
        starts=search.starts,
        as_is=search.as_is,
        output=search.output,
    )
    if search.output:
        say(f"postures written to {write_postures(found, search.output)}")
    return Answer(lambda: postures_text(found), lambda: HexaSlidePosturesReport.of(best=found))


def simulate(asked: Simulation, say: Say) -> None:
    """Measured postures into a file."""
    from app.planning.hexaslide import Asked, write_simulated
    from app.report.text.hexaslide_calibration import simulated_text
    from calib.errors import UsageError

    postures = asked.posture_file or asked.postures
    if asked.procedure is None or postures is None or (asked.posture_file and asked.postures):
        raise UsageError(
            "--procedure, --postures, --posture-file",
            "too few or too many",
            "with --machine hexaslide a procedure and either a number or a file of postures",
        )
    wanted = Asked(
        procedure=asked.procedure,
        postures=postures,
        noise_mm=NOISE_MM if asked.noise_mm is None else asked.noise_mm,
        angle_noise_mrad=asked.angle_noise_mrad,
        errors_mm=ERRORS_MM if asked.errors_mm is None else asked.errors_mm,
        seed=asked.seed,
        measured=asked.measured,
        machine_file=asked.machine_file,
    )
    measured = write_simulated(wanted, asked.output, asked.truth)
    say(f"{simulated_text(measured)}, written to {asked.output}")
    if asked.truth is not None:
        say(f"the true machine written to {asked.truth}")


def solve(asked: Solving, _say: Say) -> Answer:
    """Identify from one file of measured postures."""
    from app.planning.hexaslide import calibrate_file
    from app.report.schema.hexaslide import CalibrationReport
    from app.report.text.hexaslide_calibration import calibration_text
    from calib.errors import UsageError

    if len(asked.files) != 1:
        raise UsageError(FAMILY.measured, f"{len(asked.files)} files", "one file")
    share = SHARE if asked.held_out is None else asked.held_out
    solved = calibrate_file(asked.files[0], asked.truth, share)
    return Answer(lambda: calibration_text(solved), lambda: CalibrationReport.of(solved=solved))


MARK = b"glidecal.hexaslide-measurements"
"""Stands near the beginning of every file of measured postures, whole or cut."""

BEGINNING_BYTES = 400


def reads(path: Path) -> bool:
    """Whether the file begins as measured postures; False where it cannot be read."""
    from protocols.files import open_to_read

    try:
        with open_to_read(path) as file:
            return MARK in file.read(BEGINNING_BYTES)
    except OSError:
        return False


FAMILY = Family(
    name="hexaslide",
    names=("hexaslide",),
    measured="measured postures of a hexaslide",
    own={
        "identifiability": POSTURE_OPTIONS | {"postures", "screen"},
        "postures": POSTURE_OPTIONS | {"as_is"},
        "simulate": frozenset(
            {
                *("procedure", "postures", "posture_file", "measured", "machine_file"),
                *("noise", "angle_noise", "errors", "truth"),
            }
        ),
        "solve": frozenset({"truth", "held_out"}),
    },
    reads=reads,
    identifiability=identifiability,
    postures=postures,
    simulate=simulate,
    solve=solve,
    look=look,
)
