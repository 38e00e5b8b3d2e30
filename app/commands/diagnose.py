"""``glidecal diagnose``: where simulation and measurement disagree, and what is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.options import AsJson, say
from calib.errors import UsageError
from protocols.machine_files import USUAL_MACHINE, machine_names


def diagnose(
    sessions: Annotated[
        list[Path] | None, typer.Argument(help="Session files.", show_default=False, readable=False)
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", help="Model with effects that are known already.", readable=False),
    ] = None,
    adopt: Annotated[
        Path | None,
        typer.Option("--adopt", help="Write the model with what was named added.", readable=False),
    ] = None,
    candidate: Annotated[
        str | None,
        typer.Option(
            "--candidate",
            help="Adopt this candidate, ID or ID:WHERE, instead; empirical: the unnamed law.",
        ),
    ] = None,
    held_out: Annotated[
        list[Path] | None,
        typer.Option("--held-out", help="Session for the gap alone; repeat.", readable=False),
    ] = None,
    next_procedure: Annotated[
        Path | None,
        typer.Option("--next", help="Write the next measurement as a procedure.", readable=False),
    ] = None,
    aliases: Annotated[
        bool, typer.Option("--aliases", help="What --procedure cannot tell apart; no data needed.")
    ] = False,
    procedure: Annotated[
        str | None,
        typer.Option("--procedure", help="Procedure for --aliases.", show_default="the machine's"),
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option(
            "--machine",
            help=f"Machine for --aliases: {', '.join(machine_names())}, or a file (TOML).",
            show_default=USUAL_MACHINE,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Where simulation and measurement disagree, the missing effect, the gap before and after."""
    if aliases:
        _show_aliases(procedure, machine, as_json=as_json)
        return
    if not sessions:
        raise UsageError("diagnose", "no session", "at least one, or --aliases --procedure NAME")
    _diagnose(sessions, model, adopt, candidate, held_out or [], next_procedure, as_json=as_json)


def _diagnose(
    sessions: list[Path],
    model: Path | None,
    adopt: Path | None,
    candidate: str | None,
    held_out: list[Path],
    next_procedure: Path | None,
    *,
    as_json: bool,
) -> None:
    from app.evaluating.adoption import adopt as adopt_effects
    from app.evaluating.adoption import left_behind, write_procedure
    from app.evaluating.diagnosis import diagnose_files
    from app.evaluating.own_effects import known_laws
    from app.report.schema.diagnosis import DiagnosisReport
    from app.report.schema.document import to_json
    from app.report.text.diagnosis import diagnosis_text

    found = diagnose_files(sessions, model=model, held_out=held_out, laws=known_laws())
    for warning in found.warnings:
        say(f"glidecal: {warning}")
    if next_procedure:
        write_procedure(found, next_procedure)
        say(f"next measurement: glidecal run --protocol {next_procedure}")
    if adopt:
        adopt_effects(found, sessions, adopt, known=model, candidate=candidate)
        say(f"model written: {adopt}")
        if left_behind(found, candidate):
            say("there is an unnamed law, too: --candidate empirical")
    typer.echo(to_json(DiagnosisReport.of(found=found)) if as_json else diagnosis_text(found))


def _show_aliases(name: str | None, machine: str | None, *, as_json: bool) -> None:
    from app.evaluating.own_effects import known_laws
    from app.planning.aliases import alias_map
    from app.report.schema.diagnosis import AliasReport
    from app.report.schema.document import to_json
    from app.report.text.planning import alias_text

    found = alias_map(name, known_laws(), machine)
    typer.echo(to_json(AliasReport.of(found=found)) if as_json else alias_text(found))
