"""Sessions of postures of a Hexa Slide as commands ask for them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.exit_codes import Exit
from app.machines.options import (
    Answer,
    SessionVerbs,
    file,
    may_replace,
    number,
    say,
    tell_warnings,
    working,
)
from calib.errors import IndicatorError, RecordError, UsageError
from calib.printable import counted

if TYPE_CHECKING:  # heavy: imported where used
    from app.measuring.hexaslide import PostureTaking
    from app.report.certificate import CertificateHead
    from app.report.pages.report import ReportSource
    from drivers.line import IndicatorLine
    from protocols.files import Contents
    from protocols.hexaslide_session import PostureSession, PosturesOpened
    from protocols.record import Record

NAME = "hexaslide"
Postures = Annotated[
    Path | None, file("Hexa Slide: postures (.csv) instead of those of the procedure.")
]
OF_PROCEDURE = "default: that of the procedure."
WAYS = "again, skip REASON, pause"
ANSWERS = (
    "again (it is not used; its posture is read once more), keep (it is used), pause (the "
    "session can be continued)"
)


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


def imported(
    source: Path,
    output: Path | None,
    machine: str | None,
    protocol: str | None,
    template: bool,
    remarks: Sequence[str],
    measured_on: date | None,
    force: bool,
    *,
    posture_file: Postures = None,
    noise_mm: Annotated[
        float | None,
        number(f"Hexa Slide: standard deviation of a measured length, mm; {OF_PROCEDURE}", 0, 100),
    ] = None,
    noise_deg: Annotated[
        float | None,
        number(f"Hexa Slide: standard deviation of a measured angle, °; {OF_PROCEDURE}", 0, 100),
    ] = None,
) -> None:
    """A session of a table, or with ``template`` the table to be filled in."""
    from app.measuring.hexaslide import commanded, import_postures
    from protocols.files import write_files
    from protocols.hexaslide_table import empty_table

    path = source if template else output
    if path is None:
        raise UsageError("--output", "none", "-o SESSION, or --template to write an empty table")
    opened = _opened(
        machine,
        protocol,
        posture_file,
        origin="imported",
        remarks=tuple(filter(None, [" ".join(remarks)])),
        measured_on=measured_on,
    )
    if template:
        if noise_mm is not None or noise_deg is not None:
            raise UsageError("--noise-mm, --noise-deg", "--template", "with a table to be read")
        may = may_replace(force, path)
        write_files(path, {"": empty_table(commanded(opened))}, replace=may)
        say(f"{opened.procedure.name} to be filled in, units in the second row: {path}")
        return
    if posture_file is not None:
        raise UsageError("--posture-file", "no --template", "with --template, or with run")
    procedure = opened.procedure.with_noise(noise_mm=noise_mm, noise_deg=noise_deg)
    opened = opened.model_copy(update={"procedure": procedure})
    session, odd = import_postures(source, path, opened)
    tell_warnings(odd)
    say(f"{counted(len(session.readings), 'posture')} written to {path}")


def run(
    machine: str | None,
    protocol: str | None,
    output: Path | None,
    resume: Path | None,
    operator: str,
    temperature_c: float | None,
    note: str,
    seed: int | None,
    dry_run: bool,
    indicators: Sequence[str],
    *,
    posture_file: Postures = None,
    behind: Annotated[
        Path | None, file("Hexa Slide, --simulated: the machine of this earlier simulated session.")
    ] = None,
) -> None:
    """Posture after posture: simulated with a ``seed``, or typed in a terminal."""
    from app.measuring.hexaslide import PostureTaking, commanded, measure_simulated
    from app.report.streams import need_terminal
    from app.report.text.hexaslide_session import plan_text
    from protocols.hexaslide_session import read_postures, simulated_truth

    if resume is not None:
        if posture_file is not None or behind is not None:
            raise UsageError("--posture-file, --behind", "beside --continue", "--continue alone")
        taking = PostureTaking.resume(resume)
    else:
        opened = _opened(
            machine,
            protocol,
            posture_file,
            origin="measured" if seed is None else "simulated",
            operator=operator,
            temperature_c=temperature_c,
            remarks=tuple(filter(None, [note])),
            seed=seed,
            indicator="".join(indicators),
        )
        _check_indicators(opened, indicators)
        if behind is not None:
            if seed is None:
                raise UsageError("--behind", "no --simulated", "with --simulated alone")
            truth = simulated_truth(read_postures(behind)[0])
            opened = opened.model_copy(update={"truth": truth})
        if dry_run:
            typer.echo(plan_text(commanded(opened)))
            return
        if seed is None:
            need_terminal("run", "--simulated, or glidecal import of a table")
        name = Path(protocol).stem if protocol else NAME
        path = output or Path(f"{date.today():%Y-%m-%d}-{name}.jsonl")
        taking = PostureTaking.begin(path, opened)
    try:
        seed = taking.session.opened.seed
        if seed is not None:
            measure_simulated(taking, seed, say)
        else:
            need_terminal("run", "glidecal import of a table")
            _take_typed(taking)
    except (KeyboardInterrupt, typer.Abort):
        say(f"Paused. Go on with: glidecal run --continue {taking.path}")
        raise typer.Exit(Exit.INTERRUPTED) from None
    finally:
        taking.close()
    say(f"{counted(len(taking.session.readings), 'posture')} in {taking.path}")


def _check_indicators(opened: PosturesOpened, indicators: Sequence[str]) -> None:
    """Raises UsageError for more than one, and where none can read what is measured."""
    from app.measuring.hexaslide import INDICATED

    if len(indicators) > 1:
        raise UsageError("--indicator", f"{len(indicators)}", "one, in the link")
    if not indicators:
        return
    if opened.seed is not None or opened.procedure.whole().measured != INDICATED:
        words = f"procedure {opened.procedure.name}" if opened.seed is None else "--simulated"
        raise UsageError("--indicator", words, "a procedure that measures length alone")
    _line_of(indicators[0])


def _line_of(indicator: str) -> IndicatorLine:
    """The line of ``PROFILE:PORT``, not open yet. Raises UsageError."""
    from drivers.line import IndicatorLine
    from drivers.profiles import profile_named

    profile, mark, port = indicator.partition(":")
    if not (mark and port):
        raise UsageError("--indicator", repr(indicator), "PROFILE:PORT")
    return IndicatorLine(profile_named(profile), port)


def _take_typed(taking: PostureTaking) -> None:
    """Ask for one posture after the other until all are measured or left out."""
    indicator = taking.session.opened.indicator
    if not indicator:
        _ask_all(taking, None)
        return
    line = _line_of(indicator)
    line.start()
    with closing(line):
        _ask_all(taking, line)


def _ask_all(taking: PostureTaking, line: IndicatorLine | None) -> None:
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


def validated(path: Path) -> tuple[PostureSession, Record]:
    """Raises RecordError for a record that is not whole, or not closed."""
    from protocols.hexaslide_session import read_postures

    session, record = read_postures(path)
    if record.unfinished:
        text = record.unfinished.removeprefix(f"{path.name}: ")
        next_step = f"glidecal run --continue {path} goes on with it"
        raise RecordError(f"session {path}", reason=text, next_step=next_step)
    return session, record


def replayed(path: Path) -> Answer[Any]:
    """Every reading of a session."""
    from app.report.schema.hexaslide_replay import HexaSlideReplayReport
    from app.report.text.hexaslide_session import replay_text
    from protocols.hexaslide_session import read_postures

    session, record = read_postures(path)
    if record.unfinished:
        say(f"glidecal: {record.unfinished}")
    return Answer(session, replay_text, lambda replayed: HexaSlideReplayReport.of(replayed, record))


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
) -> tuple[Answer[Any], str]:
    """Whether the platform is in tolerance with the calibrated machine, and that in a word."""
    from app.evaluating.hexaslide_calibration import verify_sessions
    from app.exit_codes import NOT_JUDGED
    from app.report.schema.hexaslide import HexaSlideVerificationReport
    from app.report.text.hexaslide_calibration import verification_text

    with working("Solving"):
        verification = verify_sessions(earlier_path, later_path, tolerance_mm)
    tell_warnings(verification.warnings)
    answer = Answer(verification, verification_text, HexaSlideVerificationReport.of)
    return answer, verification.decision or NOT_JUDGED


def diagnosed(
    path: Path, model: Path | None, adopt: Path | None, candidate: str | None, may_replace: bool
) -> Answer[Any]:
    """What is missing beside a model of the machine, and the model with it."""
    from app.evaluating.hexaslide_adoption import adopted, diagnose_postures
    from app.report.schema.hexaslide_diagnosis import HexaSlideDiagnosisReport
    from app.report.text.hexaslide_diagnosis import diagnosis_text
    from protocols.files import write_files

    with working("Diagnosing"):
        diagnosis = diagnose_postures(path, model)
        adoption = adopted(diagnosis, candidate) if adopt else None
    tell_warnings(diagnosis.warnings)
    if adoption is not None and adopt is not None:
        write_files(adopt, {"": adoption.model.text()}, replace=may_replace)
        say(f"model written: {adopt}")
    return Answer(
        diagnosis,
        lambda diagnosed: diagnosis_text(diagnosed, adoption),
        lambda diagnosed: HexaSlideDiagnosisReport.of(diagnosed, adoption),
    )


def modelled(path: Path, effect: str, why: str) -> tuple[str, str]:
    """A model as it stands, or without an effect: in words, and the file."""
    from app.evaluating.hexaslide_adoption import remove
    from app.report.text.hexaslide_diagnosis import model_text
    from protocols.hexaslide_model import read_hexaslide_model

    model = remove(path, effect, why) if effect else read_hexaslide_model(path)
    return model_text(model), model.text().rstrip("\n")


def compared(earlier_path: Path, later_path: Path) -> Answer[Any]:
    """Whether the machine is the same in both sessions."""
    from app.evaluating.hexaslide import compare_postures
    from app.report.schema.hexaslide_diagnosis import HexaSlideComparisonReport
    from app.report.text.hexaslide_comparison import comparison_text

    with working("Solving"):
        comparison = compare_postures(earlier_path, later_path)
    tell_warnings(comparison.warnings)
    return Answer(comparison, comparison_text, HexaSlideComparisonReport.of)


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
