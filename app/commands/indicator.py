"""``glidecal indicator``: one indicator outside any session."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from app.commands.options import AsJson, Channel, ProfileName, Unit, say
from calib.errors import IndicatorError

indicator_verbs = typer.Typer(help="One indicator outside any session.", no_args_is_help=True)

PortName = Annotated[str, typer.Argument(help="Port of the indicator.", show_default=False)]


@indicator_verbs.command("read")
def read(
    port: PortName,
    profile: ProfileName = "mitutoyo-01a",
    watch: Annotated[bool, typer.Option("--watch", help="Go on until Ctrl-C.")] = False,
    unit: Unit = "mm",
    channel: Channel = 1,
    as_json: AsJson = False,
) -> None:
    """One reading, or one after the other."""
    from app.measuring.indicators import asked_for
    from app.report.schema.document import to_json
    from app.report.schema.readings import outcome_report
    from app.report.text.indicator import outcome_text
    from drivers.line import IndicatorLine
    from drivers.profile import Fault, Verified
    from drivers.profiles import profile_named

    known = profile_named(profile)
    if known.verified is Verified.UNVERIFIED:
        say(f"glidecal: profile {known.name} is unverified: {known.source}")
    line = IndicatorLine(known, port, asked=asked_for(unit, channel))
    line.start()
    try:
        while True:
            outcome = line.ask().result()
            if as_json:
                typer.echo(to_json(outcome_report(known.name, outcome)))
            elif watch or not isinstance(outcome, Fault):
                typer.echo(outcome_text(outcome))
            if not watch:
                break
            time.sleep(known.interval_s)
    finally:
        line.close()
    if isinstance(outcome, Fault):
        thing = f"indicator on {port}"
        raise IndicatorError(thing, f"{outcome.kind}: {outcome.words}", "", known.hint)


@indicator_verbs.command("doctor")
def doctor(
    port: PortName,
    profile: ProfileName = "mitutoyo-01a",
    unit: Unit = "mm",
    channel: Channel = 1,
) -> None:
    """Everything that can be wrong, each with the next thing to do."""
    from app.exit_codes import Exit
    from app.measuring.indicators import asked_for
    from app.report.text.indicator import findings_text
    from drivers.doctor import examine
    from drivers.profiles import PROFILES, profile_named

    known = profile_named(profile)
    findings = examine(known, port, asked_for(unit, channel), PROFILES.values())
    typer.echo(findings_text(findings))
    raise typer.Exit(Exit.DONE if all(f.well for f in findings) else Exit.INDICATOR)
