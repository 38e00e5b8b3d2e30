"""The Hexa Slide's side of ``glidecal simulate`` and ``glidecal solve``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import typer
from typer.models import OptionInfo

from app.commands.options import finite, say

DEFAULT_NOISE_MM = 0.01
DEFAULT_ERRORS_MM = 1.0
DEFAULT_SHARE = 0.2


def optional_figure(help_text: str) -> OptionInfo:
    """An option for a small number; None where it is not given."""
    option: OptionInfo = typer.Option(help=help_text, min=0.0, max=10.0, callback=finite)
    return option


@dataclass(frozen=True)
class Own:
    """Options of ``simulate`` that belong to a Hexa Slide; None: not given."""

    procedure: str | None
    postures: int | None
    noise: float | None
    angle_noise: float | None
    errors: float | None
    measured: str | None
    machine_file: Path | None
    posture_file: Path | None
    truth: Path | None


def refuse_own(own: Own) -> None:
    """Raises UsageError for such options with another machine."""
    from protocols.errors import UsageError

    given = [field.name for field in fields(own) if getattr(own, field.name) is not None]
    if given:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise UsageError(names, "another machine", "--machine hexaslide with these")


def simulate_hexaslide(own: Own, output: Path, seed: int, *, foreign: bool) -> None:
    """Measured postures into a file. Raises UsageError for options of other machines."""
    from protocols.errors import UsageError

    if foreign:
        raise UsageError(
            "--protocol, --model, --scatter, --resolution, --effect and --size",
            "the machine hexaslide",
            "other machines with these; here --procedure, --postures, --noise",
        )
    postures = own.posture_file or own.postures
    if own.procedure is None or postures is None or (own.posture_file and own.postures):
        raise UsageError(
            "--procedure, --postures, --posture-file",
            "too few or too many",
            "with --machine hexaslide a procedure and either a number or a file of postures",
        )
    from app.planning.hexaslide_calibration import Asked, write_simulated
    from app.report.text.hexaslide_calibration import simulated_text

    asked = Asked(
        procedure=own.procedure,
        postures=postures,
        noise_mm=DEFAULT_NOISE_MM if own.noise is None else own.noise,
        angle_noise_mrad=own.angle_noise,
        errors_mm=DEFAULT_ERRORS_MM if own.errors is None else own.errors,
        seed=seed,
        measured=tuple(part.strip() for part in own.measured.split(",")) if own.measured else (),
        machine_file=own.machine_file,
    )
    say(f"{simulated_text(write_simulated(asked, output, own.truth))}, written to {output}")
    if own.truth is not None:
        say(f"the true machine written to {own.truth}")


def is_hexaslide(paths: list[Path], machine: str | None) -> bool:
    """Whether the files are measured postures. Raises UsageError for a machine not known."""
    from protocols.errors import UsageError
    from protocols.machine_files import machine_names

    names = (*machine_names(), "hexaslide")
    if machine not in (None, *names):
        allowed = f"{', '.join(names)}, or none: by the file"
        raise UsageError("--machine", repr(machine), allowed)
    if machine is not None:
        return machine == "hexaslide"
    from protocols.hexaslide_measurements import is_measurements

    return any(is_measurements(path) for path in paths)


def refuse_checks(truth: Path | None, held_out: float | None) -> None:
    """Raises UsageError for the checks of a Hexa Slide with sessions."""
    from protocols.errors import UsageError

    if truth is not None or held_out is not None:
        raise UsageError(
            "--truth and --held-out",
            "sessions",
            "measured postures of a hexaslide",
        )


def solve_hexaslide(
    paths: list[Path], truth: Path | None, held_out: float | None, *, foreign: bool, as_json: bool
) -> None:
    """Identify from one file and print. Raises UsageError for what belongs to sessions."""
    from protocols.errors import UsageError

    if foreign:
        raise UsageError(
            "--subset, --method, --weights, --tolerance, --map and --monte-carlo",
            "measured postures of a hexaslide",
            "sessions with these",
        )
    if len(paths) != 1:
        raise UsageError("measured postures of a hexaslide", f"{len(paths)} files", "one file")
    from app.planning.hexaslide_calibration import calibrate_file
    from app.report.schema.document import to_json
    from app.report.schema.hexaslide import CalibrationReport
    from app.report.text.hexaslide_calibration import calibration_text

    solved = calibrate_file(paths[0], truth, DEFAULT_SHARE if held_out is None else held_out)
    typer.echo(
        to_json(CalibrationReport.of(solved=solved)) if as_json else calibration_text(solved)
    )
