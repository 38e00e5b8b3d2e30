"""Sessions of postures of a Hexa Slide as commands ask for them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.exit_codes import Exit
from app.machines.options import (
    Answer,
    DiagnosisRequest,
    ImportRequest,
    RunRequest,
    Say,
    SessionVerbs,
    file,
    may_replace,
    number,
    working,
)
from app.machines.options import say as tell
from calib.errors import IndicatorError, RecordError, UsageError
from calib.printable import counted

if TYPE_CHECKING:  # heavy: imported where used
    from app.measuring.hexaslide import PostureTaking
    from app.report.certificate import CertificateHead
    from app.report.pages.report import ReportSource
    from drivers.line import IndicatorLine
    from protocols.files import Contents
    from protocols.hexaslide_session import PosturesOpened

NAME = "hexaslide"
HELP = "Hexa Slide: postures (.csv) instead of those of the procedure."
OF_PROCEDURE = "default: that of the procedure."
WAYS = "again, skip REASON, pause"
ANSWERS = (
    "again (it is not used; its posture is read once more), keep (it is used), pause (the "
    "session can be continued)"
)


@dataclass(frozen=True)
class ImportOptions:
    """Options of ``import``."""

    posture_file: Annotated[Path | None, file(HELP)] = None
    noise_mm: Annotated[
        float | None,
        number(f"Hexa Slide: standard deviation of a measured length, mm; {OF_PROCEDURE}", 0, 100),
    ] = None
    noise_deg: Annotated[
        float | None,
        number(f"Hexa Slide: standard deviation of a measured angle, °; {OF_PROCEDURE}", 0, 100),
    ] = None


@dataclass(frozen=True)
class RunOptions:
    """Options of ``run``."""

    posture_file: Annotated[Path | None, file(HELP)] = None
    behind: Annotated[
        Path | None, file("Hexa Slide, --simulated: the machine of this earlier simulated session.")
    ] = None


def _opened(
    machine: str | None,
    protocol: str | None,
    posture_file: Path | None,
    **stated: Any,  # noqa: ANN401 (of other fields)
) -> PosturesOpened:
    """The first line of the record, with what else is ``stated``."""
    from app.planning.hexaslide import EXAMPLE
    from app.version import program
    from protocols.hexaslide import load_hexaslide
    from protocols.hexaslide_session import PosturesOpened, load_posture_procedure, procedure_names

    if protocol is None:
        listed = ", ".join(procedure_names())
        raise UsageError("--protocol", "none", f"{listed}, or a procedure file (TOML)")
    machine_file = None if machine in (None, NAME) else Path(str(machine))
    return PosturesOpened(
        program=program(),
        machine=load_hexaslide(machine_file),
        machine_file=machine_file.name if machine_file else EXAMPLE,
        procedure=load_posture_procedure(protocol, posture_file),
        **stated,
    )


def imported(importing: ImportRequest, options: ImportOptions, say: Say) -> None:
    """A session of a table, or the table to be filled in."""
    from app.measuring.hexaslide import commanded, import_postures
    from protocols.files import write_files
    from protocols.hexaslide_table import empty_table

    output = importing.source if importing.template else importing.output
    if output is None:
        raise UsageError("--output", "none", "-o SESSION, or --template to write an empty table")
    opened = _opened(
        importing.machine,
        importing.protocol,
        options.posture_file,
        origin="imported",
        remarks=tuple(filter(None, [" ".join(importing.remarks)])),
        measured_on=importing.measured_on,
    )
    procedure = opened.procedure
    noise = {"noise_mm": options.noise_mm, "noise_deg": options.noise_deg}
    if importing.template:
        if any(value is not None for value in noise.values()):
            raise UsageError("--noise-mm, --noise-deg", "--template", "with a table to be read")
        may = may_replace(importing.force, output)
        write_files(output, {"": empty_table(commanded(opened))}, replace=may)
        say(f"{procedure.name} to be filled in, units in the second row: {output}")
        return
    if options.posture_file is not None:
        raise UsageError("--posture-file", "no --template", "with --template, or with run")
    opened = opened.model_copy(update={"procedure": procedure.with_noise(**noise)})
    session, odd = import_postures(importing.source, output, opened)
    for text in odd:
        say(f"glidecal: {text}")
    say(f"{counted(len(session.readings), 'posture')} written to {output}")


def run(running: RunRequest, options: RunOptions, say: Say) -> None:
    """Posture after posture: simulated, or typed in a terminal."""
    from app.measuring.hexaslide import PostureTaking, commanded, measure_simulated
    from app.report.streams import need_terminal
    from app.report.text.hexaslide_session import plan_text

    if running.resume is not None:
        if options != RunOptions():
            raise UsageError("--posture-file, --behind", "beside --continue", "--continue alone")
        taking = PostureTaking.resume(running.resume)
    else:
        opened = _begun(running, options)
        if running.dry_run:
            typer.echo(plan_text(commanded(opened)))
            return
        if opened.seed is None:
            need_terminal("run", "--simulated, or glidecal import of a table")
        name = Path(running.protocol).stem if running.protocol else NAME
        path = running.output or Path(f"{date.today():%Y-%m-%d}-{name}.jsonl")
        taking = PostureTaking.begin(path, opened)
    try:
        seed = taking.session.opened.seed
        if seed is not None:
            measure_simulated(taking, seed, say)
        else:
            need_terminal("run", "glidecal import of a table")
            _typed(taking, say)
    except (KeyboardInterrupt, typer.Abort):
        say(f"Paused. Go on with: glidecal run --continue {taking.path}")
        raise typer.Exit(Exit.INTERRUPTED) from None
    finally:
        taking.close()
    say(f"{counted(len(taking.session.readings), 'posture')} in {taking.path}")


def _begun(running: RunRequest, options: RunOptions) -> PosturesOpened:
    from app.measuring.hexaslide import INDICATED
    from protocols.hexaslide_session import read_postures, simulated_truth

    opened = _opened(
        running.machine,
        running.protocol,
        options.posture_file,
        origin="simulated" if running.simulated else "measured",
        operator=running.operator,
        temperature_c=running.temperature_c,
        remarks=tuple(filter(None, [running.note])),
        seed=running.seed if running.simulated else None,
        indicator="".join(running.indicators),
    )
    procedure = opened.procedure
    if len(running.indicators) > 1:
        raise UsageError("--indicator", f"{len(running.indicators)}", "one, in the link")
    if running.indicators:
        if running.simulated or procedure.whole().measured != INDICATED:
            given_words = "--simulated" if running.simulated else f"procedure {procedure.name}"
            raise UsageError("--indicator", given_words, "a procedure that measures length alone")
        _profile(running.indicators[0])
    if options.behind is None:
        return opened
    if not running.simulated:
        raise UsageError("--behind", "no --simulated", "with --simulated alone")
    truth = simulated_truth(read_postures(options.behind)[0])
    return opened.model_copy(update={"truth": truth})


def _profile(text: str) -> IndicatorLine:
    """The line of ``PROFILE:PORT``, not open yet. Raises UsageError."""
    from drivers.line import IndicatorLine
    from drivers.profiles import profile_named

    profile, mark, port = text.partition(":")
    if not (mark and port):
        raise UsageError("--indicator", repr(text), "PROFILE:PORT")
    return IndicatorLine(profile_named(profile), port)


def _typed(taking: PostureTaking, say: Say) -> None:
    """Ask for one posture after the other until all are measured or left out."""
    indicator = taking.session.opened.indicator
    if not indicator:
        _ask_all(taking, None, say)
        return
    line = _profile(indicator)
    line.start()
    with closing(line):
        _ask_all(taking, line, say)


def _ask_all(taking: PostureTaking, line: IndicatorLine | None, say: Say) -> None:
    from app.report.text.hexaslide_session import doubt_text, prompt_text, task_text
    from app.report.text.tables import wrapped

    while True:
        if taking.doubt is not None:
            say(doubt_text(taking.doubt))
            if not _answer(taking, typed := _prompt("again or keep")):
                value = repr(typed) if typed else "an empty line"
                say(wrapped(f"{UsageError('answer', value, ANSWERS)}"))
            continue
        number = taking.session.next_posture
        if number is None:
            break
        say(task_text(taking.commands, number, is_first=not taking.session.readings))
        typed = _prompt(prompt_text(taking.commands, indicated=line is not None))
        try:
            if not _answer(taking, typed):
                value, text = (typed, "") if typed or line is None else _indicated(line)
                say(f"reading {taking.take(value, text).reading}: {value}")
        except (UsageError, IndicatorError) as problem:
            say(wrapped(f"{problem} Or: {WAYS}."))
    taking.finish()


def _answer(taking: PostureTaking, typed: str) -> bool:
    """Whether a word was typed, which is then done. Raises Abort for a pause."""
    word, _, remainder = typed.partition(" ")
    if word == "pause":
        raise typer.Abort
    if word == "keep" and taking.doubt is not None:
        taking.keep()
    elif word == "again" and taking.session.readings:
        taking.take_again()
    elif word == "skip" and taking.doubt is None:
        taking.skip(remainder.strip() or "left out by the operator")
    else:
        return False
    return True


def _prompt(text: str) -> str:
    answer: str = typer.prompt(text, default="", show_default=False, prompt_suffix=" > ", err=True)
    return answer.strip()


def _indicated(line: IndicatorLine) -> tuple[str, str]:
    """A fresh value of the indicator in mm, and its text. Raises IndicatorError for a fault."""
    from drivers.profile import Fault

    outcome = line.ask().result()
    if isinstance(outcome, Fault):
        raise IndicatorError(f"indicator on {line.port}", f"{outcome.kind}: {outcome.words}")
    return f"{outcome.value_mm:.10g}", outcome.text


def tell_warnings(warnings: Sequence[str]) -> None:
    """Say what session files warn of: that they were cut, or are not closed."""
    for warning in warnings:
        tell(f"glidecal: {warning}")


def validated(path: Path) -> str:
    """Raises RecordError for a record that is not whole, or not closed."""
    from protocols.hexaslide_session import read_postures

    session, record = read_postures(path)
    if record.unfinished:
        text = record.unfinished.removeprefix(f"{path.name}: ")
        next_step = f"glidecal run --continue {path} goes on with it"
        raise RecordError(f"session {path}", reason=text, next_step=next_step)
    return (
        f"{path}: unbroken and closed, {len(record.events)} lines, "
        f"{counted(len(session.all_readings), 'reading')}, {len(session.superseded)} superseded"
    )


def replayed(path: Path, say: Say) -> Answer:
    """Every reading of a session."""
    from app.report.schema.hexaslide_replay import HexaSlideReplayReport
    from app.report.text.hexaslide_session import replay_text
    from protocols.hexaslide_session import read_postures

    session, record = read_postures(path)
    if record.unfinished:
        say(f"glidecal: {record.unfinished}")
    return Answer(lambda: replay_text(session), lambda: HexaSlideReplayReport.of(session, record))


def exported(path: Path, format_name: str) -> tuple[Contents, tuple[str, ...]]:
    """The calibrated machine: its file, for LinuxCNC, for ROS 2, or the result as JSON."""
    from app.evaluating.hexaslide_calibration import calibrate_file
    from app.exports.hexaslide import calibrated_files, kinematics_words, ros2_parameters
    from app.report.schema.document import to_json
    from app.report.schema.hexaslide import HexaSlideCalibrationReport
    from app.report.text.hexaslide_calibration import caveats

    formats = ("model", "linuxcnc-kins", "ros2", "json")
    if format_name not in formats:
        raise UsageError("--format", f"{format_name} of a {NAME}", ", ".join(formats))
    with working("Solving"):
        result = calibrate_file(path, None, 0.0)
    tell_warnings(result.warnings)
    report = HexaSlideCalibrationReport.of(result)
    files, cautions = calibrated_files(result, None), tuple(caveats(report))
    if format_name == "model":
        return {"": files["machine.toml"]}, cautions
    if format_name == "ros2":
        return {"": ros2_parameters(result)}, cautions
    if format_name == "json":
        return {"": to_json(report) + "\n"}, cautions
    return files, (*cautions, kinematics_words(result.entered))


def verified(
    earlier_path: Path, later_path: Path, tolerance_mm: float | None
) -> tuple[Answer, str]:
    """Whether the platform is in tolerance with the calibrated machine, and that in a word."""
    from app.evaluating.hexaslide_calibration import verify_sessions
    from app.exit_codes import NOT_JUDGED
    from app.report.schema.hexaslide import HexaSlideVerificationReport
    from app.report.text.hexaslide_calibration import verification_text

    with working("Solving"):
        verification = verify_sessions(earlier_path, later_path, tolerance_mm)
    tell_warnings(verification.warnings)
    answer = Answer(
        lambda: verification_text(verification),
        lambda: HexaSlideVerificationReport.of(verification),
    )
    return answer, verification.decision or NOT_JUDGED


def diagnosed(path: Path, request: DiagnosisRequest, say: Say) -> Answer:
    """What is missing in the model of the machine, and the model with it."""
    from app.evaluating.hexaslide_adoption import adopted, diagnose_postures, write_model
    from app.report.schema.hexaslide_diagnosis import HexaSlideDiagnosisReport
    from app.report.text.hexaslide_diagnosis import diagnosis_text

    with working("Diagnosing"):
        diagnosis = diagnose_postures(path, request.model)
        adoption = adopted(diagnosis, request.candidate) if request.adopt else None
    tell_warnings(diagnosis.warnings)
    if adoption is not None and request.adopt is not None:
        write_model(adoption, request.adopt, replace=request.replace)
        say(f"model written: {request.adopt}")
    return Answer(
        lambda: diagnosis_text(diagnosis, adoption),
        lambda: HexaSlideDiagnosisReport.of(diagnosis, adoption),
    )


def modelled(path: Path, effect: str, why: str) -> tuple[str, str]:
    """A model as it stands, or without an effect: in words, and the file."""
    from app.evaluating.hexaslide_adoption import remove
    from app.report.text.hexaslide_diagnosis import model_text
    from protocols.hexaslide_model import read_hexaslide_model

    model = remove(path, effect, why) if effect else read_hexaslide_model(path)
    return model_text(model), model.text().rstrip("\n")


def compared(earlier_path: Path, later_path: Path) -> Answer:
    """Whether the machine is the same in both sessions."""
    from app.evaluating.hexaslide_comparison import compare_postures
    from app.report.schema.hexaslide_diagnosis import HexaSlideComparisonReport
    from app.report.text.hexaslide_comparison import comparison_text

    with working("Solving"):
        comparison = compare_postures(earlier_path, later_path)
    tell_warnings(comparison.warnings)
    return Answer(
        lambda: comparison_text(comparison), lambda: HexaSlideComparisonReport.of(comparison)
    )


def reported(
    path: Path, later_path: Path | None, tolerance_mm: float | None, head: CertificateHead | None
) -> ReportSource:
    """The report to sign."""
    from app.report.pages.hexaslide import source_of_postures

    return source_of_postures(path, later_path, tolerance_mm, head)


SESSIONS = SessionVerbs(
    *(run, imported, validated, replayed, exported, verified, diagnosed),
    *(compared, reported, modelled),
)
