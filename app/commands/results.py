"""From sessions to results: solve, compare, verify, diagnose, model, export and report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from app.machines.options import (
    Answer,
    AsJson,
    Force,
    Method,
    Output,
    Sessions,
    SubsetName,
    argument,
    extra,
    file,
    machine_option,
    may_replace,
    number,
    say,
    working,
)
from app.machines.registry import NAMES, family_of_files, options_of, with_options_of_machines
from calib.errors import UsageError
from protocols.machine_files import machine_names

if TYPE_CHECKING:
    from app.evaluating.diagnosis import SessionDiagnosis

FormatName = Literal[
    "json",
    "csv",
    "model",
    "linuxcnc",
    "linuxcnc-kins",
    "lineardeltakins",
    "klipper",
    "reprapfirmware",
]


@with_options_of_machines
def solve(
    context: typer.Context,
    sessions: Sessions,
    machine: Annotated[
        str | None, typer.Option(help=f"{', '.join(NAMES)}; default: by the file.")
    ] = None,
    as_json: AsJson = False,
    **own: Any,  # noqa: ANN401 (what the machines add)
) -> None:
    """Parameters with uncertainties from sessions. Also differences and residuals."""
    family = family_of_files(machine, sessions)
    given = options_of(context, family, family.measured, own, lambda other: other.measured)
    typer.echo(family.solve(sessions, given, say).shown(as_json=as_json))


def compare(
    before: Annotated[Path, argument("Session before.")],
    after: Annotated[Path, argument("Session after.")],
    as_json: AsJson = False,
) -> None:
    """The differences before and after a calibration. After: with the offsets entered."""
    from app.evaluating.comparison import compare_files
    from app.report.schema.solution import ComparisonReport
    from app.report.text.result import comparison_report

    found = compare_files(before, after)
    answer = Answer(lambda: comparison_report(found), lambda: ComparisonReport.of(found=found))
    typer.echo(answer.shown(as_json=as_json))


def verify(
    before: Annotated[Path, argument("Session before.")],
    after: Annotated[Path, argument("Session with the offsets entered.")],
    tolerance: Annotated[
        float | None,
        number("What the tool may be off, mm r.m.s.; default: the machine file's."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Were the offsets entered, is the tool in tolerance?"""
    from app.evaluating.comparison import verify_files
    from app.report.schema.solution import VerificationReport
    from app.report.text.result import verification_text

    found = verify_files(before, after, tolerance)
    answer = Answer(lambda: verification_text(found), lambda: VerificationReport.of(found=found))
    typer.echo(answer.shown(as_json=as_json))


def export(
    source: Annotated[Path, typer.Argument(help="Session or model file.", show_default=False)],
    output: Output,
    format_name: Annotated[
        FormatName,
        typer.Option("--format", metavar="NAME", help=f"{', '.join(get_args(FormatName))}."),
    ],
    subset: Annotated[
        SubsetName | None,
        typer.Option(
            help="Parameters to identify from a session; default joint-offsets; of a plate "
            "with-tolerances."
        ),
    ] = None,
    method: Method = "exact",
    model: Annotated[
        Path | None, file("Of a session: fit the sizes of this model's effects, too.")
    ] = None,
    home_offset: Annotated[
        str | None,
        typer.Option(help="Present HOME_OFFSET of the joints of x,y,z in mm: '1.5,0,-2'."),
    ] = None,
    endstops: Annotated[
        str | None,
        typer.Option(
            help="Present position_endstop of towers x,y,z in mm (Klipper); H + M666 "
            "(RepRapFirmware)."
        ),
    ] = None,
    ini: Annotated[
        Path | None, typer.Option(help="LinuxCNC INI file: what the joints hold now.")
    ] = None,
    ambiguous: Annotated[
        bool, typer.Option("--ambiguous", help="Export effects that stayed ambiguous, too.")
    ] = False,
    force: Force = False,
) -> None:
    """Offsets for the controller, as files. For linuxcnc a folder of includes and tables."""
    from app.exports import FORMATS
    from app.exports.linuxcnc_ini import read_controller
    from app.report.offsets import offsets_from_file
    from app.report.text.caveats import UNKNOWN_HOME_OFFSET
    from calib.tripod.controller import Controller
    from protocols.files import targets_of, write_files

    if sum(one is not None for one in (home_offset, endstops, ini)) > 1:
        raise UsageError("--home-offset, --endstops and --ini", "more than one", "one of them")
    if ini and format_name in ("klipper", "reprapfirmware"):
        raise UsageError("--ini", f"--format {format_name}", "a LinuxCNC format, or --endstops")
    offsets = offsets_from_file(source, subset, method, model)
    machine = offsets.machine
    home = _triple("--home-offset", home_offset)
    if home is None:
        home = machine.tripped_at_mm(_triple("--endstops", endstops))
    if home is not None:
        offsets = replace(offsets, controller=Controller.homed_at(home, machine.joints))
    if ini:
        offsets = replace(offsets, controller=read_controller(ini))
    if ambiguous:
        offsets = replace(offsets, ambiguous=())
    for text in offsets.cautions:
        say(f"glidecal: {text}")
    if format_name.startswith("linuxcnc") and offsets.controller is None:
        say(f"glidecal: WARNING: {UNKNOWN_HOME_OFFSET}")
    written = FORMATS[format_name](offsets)
    may = may_replace(force, *targets_of(output, written))
    for path in write_files(output, written, replace=may):
        say(f"written: {path}")


def report(
    sessions: Sessions,
    output: Output,
    model: Annotated[Path | None, file("Model with effects; their sizes are fitted, too.")] = None,
    after: Annotated[Path | None, file("Session with the offsets entered.")] = None,
    tolerance: Annotated[
        float | None,
        number("What the tool may be off, mm r.m.s.; default: the machine file's."),
    ] = None,
    force: Force = False,
) -> None:
    """The calibration report to sign, as .html or .pdf."""
    may = may_replace(force, output)
    with extra("report"):
        from app.report.pages.report import write_report

    with working("Writing the report"):
        path = write_report(sessions, output, model, after, tolerance_mm=tolerance, replace=may)
    say(f"written: {path}")


def _triple(option: str, text: str | None) -> tuple[float, float, float] | None:
    from app.exports.linuxcnc_ini import LARGEST_MM
    from protocols.table import NUMBER

    if text is None:
        return None
    parts = text.split(",")
    if len(parts) == 3 and all(NUMBER.fullmatch(part.strip()) for part in parts):
        x, y, z = (float(part) for part in parts)
        if max(abs(x), abs(y), abs(z)) <= LARGEST_MM:
            return x, y, z
    raise UsageError(option, repr(text), "three numbers in mm: '1.5,0,-2'")


def diagnose(
    sessions: Annotated[list[Path] | None, argument("Session files.")] = None,
    model: Annotated[Path | None, file("Model with effects that are known already.")] = None,
    adopt: Annotated[Path | None, file("Write the model with what was named added.")] = None,
    candidate: Annotated[
        str | None,
        typer.Option(
            help="Adopt this candidate, ID or ID:WHERE, instead; empirical: the unnamed effect."
        ),
    ] = None,
    correct: Annotated[
        Path | None, file("Write the session once more with mistakes that were named corrected.")
    ] = None,
    held_out: Annotated[list[Path] | None, file("Session for the gap alone; repeat.")] = None,
    next_procedure: Annotated[
        Path | None, file("Write the next measurement as a procedure.", "--next")
    ] = None,
    aliases: Annotated[
        bool, typer.Option("--aliases", help="What --procedure cannot tell apart; no data needed.")
    ] = False,
    procedure: Annotated[
        str | None, typer.Option(help="Procedure for --aliases.", show_default="the machine's")
    ] = None,
    machine: Annotated[
        str | None,
        machine_option(f"Machine for --aliases: {', '.join(machine_names())}, or a file (TOML)."),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """What is missing in the model, and where it shows. The gap before and after."""
    from app.evaluating import diagnosis as evaluated
    from app.evaluating.diagnosis import diagnose_files

    if aliases:
        _show_aliases(procedure, machine, as_json=as_json)
        return
    if not sessions:
        raise UsageError("diagnose", "no session", "at least one, or --aliases --procedure NAME")
    if correct:  # before long work
        from protocols.journal import check_new

        check_new(correct)
    may = may_replace(force, adopt if adopt != model else None, next_procedure)
    with working("Diagnosing"):
        found = diagnose_files(sessions, model=model, held_out=held_out or [])
    for warning in found.warnings:
        say(f"glidecal: {warning}")
    if next_procedure:
        evaluated.write_procedure(found, next_procedure, replace=may)
        say(f"next measurement: glidecal run --protocol {next_procedure}")
    if adopt:
        evaluated.adopt(found, sessions, adopt, known=model, candidate=candidate, replace=may)
        say(f"model written: {adopt}")
        if evaluated.left_behind(found, candidate):
            say("there is an unnamed effect too: --candidate empirical")
    if correct:
        evaluated.correct(found, sessions[0], correct)
        say(f"corrected session written: {correct}")
    _show(found, further=bool(next_procedure), as_json=as_json)


def _show(found: SessionDiagnosis, *, further: bool, as_json: bool) -> None:
    """The diagnosis; with it the bound at the tool after ``further`` set-ups."""
    from app.report.schema.diagnosis import DiagnosisReport
    from app.report.text.diagnosis import diagnosis_text
    from app.report.text.planning import further_text

    reach = found.reach() if further else None

    def text() -> str:
        return "\n\n".join([diagnosis_text(found), *([further_text(reach)] if reach else [])])

    answer = Answer(text, lambda: DiagnosisReport.of(found=found, reach=reach))
    typer.echo(answer.shown(as_json=as_json))


def _show_aliases(name: str | None, machine: str | None, *, as_json: bool) -> None:
    from app.evaluating.own_effects import known_effects
    from app.planning.tripod import alias_map
    from app.report.schema.diagnosis import AliasReport
    from app.report.schema.document import to_json
    from app.report.text.planning import alias_text

    with working("Comparing effects"):
        found = alias_map(name, known_effects(), machine)
    typer.echo(to_json(AliasReport.of(found=found)) if as_json else alias_text(found))


def model(
    path: Annotated[Path, argument("Model file.")],
    remove: Annotated[str | None, typer.Option(help="Take an effect out: ID or ID:WHERE.")] = None,
    why: Annotated[str, typer.Option(help="The reason, for the history.")] = "",
    as_json: AsJson = False,
) -> None:
    """Parameters, effects and history of a model. Effects can be removed again."""
    from app.evaluating.diagnosis import remove as take_out
    from app.report.text.model import model_text
    from protocols.model_file import read_model_file

    if remove and not why:
        raise UsageError("--remove", "no reason", "--why with the reason, for the history")
    found = take_out(path, remove, why) if remove else read_model_file(path)
    if remove:
        say(f"{remove} removed from {path}")
    typer.echo(found.text().rstrip("\n") if as_json else model_text(found))
