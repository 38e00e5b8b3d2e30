"""``glidecal diagnose`` looks for what is missing in a model; ``glidecal model`` shows one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.machines.options import (
    Answer,
    AsJson,
    Force,
    argument,
    file,
    machine_option,
    may_replace,
    option,
    say,
    tell_warnings,
    working,
)
from app.machines.registry import family_of_files, family_of_model, the_session, typed
from calib.errors import UsageError
from protocols.machine_files import machine_names

if TYPE_CHECKING:
    from app.evaluating.diagnosis import AdoptedTool, SessionDiagnosis
    from app.report.schema.document import Report


OF_ALIASES = ("procedure", "machine")
OF_INDICATORS = ("aliases", "correct", "held_out", "next_procedure", *OF_ALIASES)


def diagnose(
    context: typer.Context,
    sessions: Annotated[list[Path] | None, argument("Session files.")] = None,
    model: Annotated[Path | None, file("Model with established effects.", to_read=True)] = None,
    adopt: Annotated[Path | None, file("Write the model with the named effects added.")] = None,
    candidate: Annotated[
        str | None,
        option("Adopt this candidate, ID or ID:WHERE, instead; empirical: the unnamed effect."),
    ] = None,
    correct: Annotated[
        Path | None, file("Write a copy of the session with the named mistakes corrected.")
    ] = None,
    held_out: Annotated[
        list[Path] | None, file("Session for the gap only; may be repeated.")
    ] = None,
    next_procedure: Annotated[
        Path | None, file("Write the next measurement as a procedure.", "--next")
    ] = None,
    aliases: Annotated[
        bool, option("Effects that --procedure cannot separate; no data.", "--aliases")
    ] = False,
    procedure: Annotated[
        str | None, option("Procedure for --aliases.", show_default="the machine's")
    ] = None,
    machine: Annotated[
        str | None,
        machine_option(f"Machine for --aliases: {', '.join(machine_names())}, or a file (TOML)."),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """What is missing in the model, and where it shows. The gap before and after."""
    _refuse_idle(context)
    if sessions and (verbs := family_of_files(None, sessions).sessions) is not None:
        session = the_session(context, sessions, OF_INDICATORS)
        may = adopt == model or may_replace(force, adopt)
        answer = verbs.diagnosed(session, model, adopt, candidate, may)
        answer.show(as_json=as_json)
        return
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
        diagnosed = diagnose_files(sessions, model=model, held_out=held_out or [])
    tell_warnings(diagnosed.warnings)
    if next_procedure:
        evaluated.write_procedure(diagnosed, next_procedure, replace=may)
        say(f"next measurement: glidecal run --protocol {next_procedure}")
    adopted = None
    if adopt:
        evaluated.adopt(diagnosed, adopt, known_model=model, candidate=candidate, replace=may)
        say(f"model written: {adopt}")
        adopted = diagnosed.adopted_tool(candidate)
        if evaluated.left_behind(diagnosed, candidate):
            say("there is an unnamed effect too: --candidate empirical")
    if correct:
        evaluated.correct(diagnosed, sessions[0], correct)
        say(f"corrected session written: {correct}")
    _show(diagnosed, adopted, further=bool(next_procedure), as_json=as_json)


def _refuse_idle(context: typer.Context) -> None:
    """Raises UsageError for what would do nothing beside the other options."""
    parameters = context.params
    if parameters["candidate"] and not parameters["adopt"]:
        raise UsageError("--candidate", "no --adopt", "--adopt with the model to write")
    if not parameters["aliases"]:
        if idle := typed(context, OF_ALIASES):
            raise UsageError(idle, "no --aliases", "--aliases, without a session")
    elif sessions := parameters["sessions"]:
        raise UsageError("--aliases", f"session {sessions[0]}", "no session: a procedure is enough")


def _show(
    diagnosed: SessionDiagnosis, adopted: AdoptedTool | None, *, further: bool, as_json: bool
) -> None:
    """The diagnosis, the tool with adopted names, and its bound after ``further`` set-ups."""
    from app.report.text.diagnosis import diagnosis_text

    reach = diagnosed.reach() if further else None

    def text(diagnosed: SessionDiagnosis) -> str:
        if reach is None:
            return diagnosis_text(diagnosed, adopted)
        from app.report.text.planning import further_text  # drivers come with it

        return f"{diagnosis_text(diagnosed, adopted)}\n\n{further_text(reach)}"

    def document(diagnosed: SessionDiagnosis) -> Report:
        from app.report.schema.diagnosis import DiagnosisReport

        return DiagnosisReport.of(diagnosed, reach, adopted)

    Answer(diagnosed, text, document).show(as_json=as_json)


def _show_aliases(name: str | None, machine: str | None, *, as_json: bool) -> None:
    from app.evaluating.own_effects import known_effects
    from app.planning.tripod import alias_map
    from app.report.schema.diagnosis import AliasReport
    from app.report.text.planning import alias_text

    with working("Comparing effects"):
        aliases = alias_map(name, known_effects(), machine)
    Answer(aliases, alias_text, AliasReport.of).show(as_json=as_json)


def model(
    path: Annotated[Path, argument("Model file.")],
    remove: Annotated[str | None, option("Remove an effect: ID or ID:WHERE.")] = None,
    why: Annotated[str, option("The reason, for the history.")] = "",
    as_json: AsJson = False,
) -> None:
    """Parameters, effects and history of a model. Effects can be removed again."""
    if remove and not why:
        raise UsageError("--remove", "no reason", "--why with the reason, for the history")
    if why and not remove:
        raise UsageError("--why", "no effect to remove", "--remove with the effect")
    if (verbs := family_of_model(path).sessions) is not None:
        model_lines, text = verbs.modelled(path, remove or "", why)
        if remove:
            say(f"{remove} removed from {path}")
        typer.echo(text if as_json else model_lines)
        return
    from app.evaluating.diagnosis import remove as take_out
    from app.report.text.model import model_text
    from protocols.model_file import read_model_file

    model_file = take_out(path, remove, why) if remove else read_model_file(path)
    if remove:
        say(f"{remove} removed from {path}")
    typer.echo(model_file.text().rstrip("\n") if as_json else model_text(model_file))
