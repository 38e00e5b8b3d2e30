"""``glidecal plan``: the next measurement worth making."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.identifiability import MountingSeconds, Noise
from app.commands.options import AsJson, Machine, say


def plan(
    sessions: Annotated[
        list[Path] | None, typer.Argument(help="Sessions already measured.", readable=False)
    ] = None,
    session: Annotated[
        list[Path] | None, typer.Option("--session", help="The same as an option.", readable=False)
    ] = None,
    machine: Machine = None,
    model: Annotated[Path | None, typer.Option(help="Model file (JSON).", readable=False)] = None,
    noise: Noise = None,
    mounting_seconds: MountingSeconds = 120.0,
    as_json: AsJson = False,
) -> None:
    """The one added mounting that lowers the expected tool error most per minute."""
    from app.planning.next_measurement import next_measurement
    from app.report.schema.document import to_json
    from app.report.schema.plan import PlanReport
    from app.report.text.planning import plan_text

    found = next_measurement(
        [*(sessions or ()), *(session or ())],
        machine_file=machine,
        model_file=model,
        noise_mm=noise,
        minutes_per_mounting=mounting_seconds / 60.0,
    )
    for warning in found.warnings:
        say(f"glidecal: {warning}")
    typer.echo(to_json(PlanReport.of(plan=found)) if as_json else plan_text(found))
