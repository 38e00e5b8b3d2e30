"""``glidecal solve``: from sessions to parameters with uncertainties."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.commands.hexaslide_calibration import is_hexaslide, refuse_checks, solve_hexaslide
from app.commands.options import (
    AsJson,
    Method,
    MethodName,
    Seed,
    Sessions,
    Subset,
    WeightsName,
    finite,
    say,
)
from protocols.machine_files import machine_names

HEXASLIDE = "hexaslide"

if TYPE_CHECKING:  # heavy: imported where used
    from app.evaluating.accuracy import Judged
    from app.evaluating.solution import Solved
    from calib.identify.accuracy import ToolMap
    from calib.identify.monte_carlo import MonteCarlo


def solve(
    sessions: Sessions,
    subset: Subset = None,
    method: Method = MethodName.EXACT,
    weights: Annotated[
        WeightsName,
        typer.Option(help="Linear method only: equal as in the papers, or covariance (14)."),
    ] = WeightsName.EQUAL,
    tolerance: Annotated[
        float | None,
        typer.Option(help="Judge the tool's r.m.s. error against this, mm.", callback=finite),
    ] = None,
    show_map: Annotated[
        bool, typer.Option("--map", help="Expected tool error on three planes.")
    ] = False,
    monte_carlo: Annotated[
        int, typer.Option("--monte-carlo", help="Check on so many simulated sessions.", min=0)
    ] = 0,
    seed: Seed = 1,
    machine: Annotated[
        str | None,
        typer.Option(help=f"{', '.join((*machine_names(), HEXASLIDE))}; default: by the file."),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="Hexa Slide: the true machine that simulate wrote.", readable=False),
    ] = None,
    held_out: Annotated[
        float | None,
        typer.Option(
            help="Hexa Slide: share of postures kept out as a check (default 0.2).",
            min=0.0,
            max=0.9,
            callback=finite,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Averages, differences, parameters with uncertainties, residuals, what is not seen."""
    if is_hexaslide(sessions, machine):
        foreign = subset is not None or tolerance is not None or show_map or monte_carlo > 0
        foreign |= method is not MethodName.EXACT or weights is not WeightsName.EQUAL
        solve_hexaslide(sessions, truth, held_out, foreign=foreign, as_json=as_json)
        return
    refuse_checks(truth, held_out)
    from app.evaluating.solution import solve_files

    solved, warnings = solve_files(
        sessions,
        subset=subset.value if subset else None,
        method=method.value,
        weights=weights.value,
    )
    for warning in warnings:
        say(f"glidecal: {warning}")
    asked = _Asked.of(solved, tolerance, monte_carlo, seed, show_map=show_map)
    typer.echo(_document(solved, asked) if as_json else _text(solved, asked))


@dataclass(frozen=True)
class _Asked:
    """What was asked for beyond the solution."""

    judged: Judged | None = None
    maps: tuple[ToolMap, ...] | None = None
    simulated: MonteCarlo | None = None

    @staticmethod
    def of(
        solved: Solved, tolerance: float | None, count: int, seed: int, *, show_map: bool
    ) -> _Asked:
        """Raises UsageError for a tolerance or a session that does not allow it."""
        from app.evaluating.accuracy import judge, maps

        return _Asked(
            None if tolerance is None else judge(solved, tolerance),
            maps(solved) if show_map else None,
            _simulate(solved, count, seed) if count else None,
        )


def _document(solved: Solved, asked: _Asked) -> str:
    from app.report.schema.document import to_json
    from app.report.schema.solution import SolutionReport

    return to_json(SolutionReport.of(solved=solved, **vars(asked)))


def _text(solved: Solved, asked: _Asked) -> str:
    from app.report.text.accuracy import judged_text, maps_text, monte_carlo_text
    from app.report.text.result import solution_text

    texts = [solution_text(solved)]
    if asked.judged:
        texts.append(judged_text(asked.judged))
    if asked.maps:
        texts.append(maps_text(asked.maps))
    if asked.simulated:
        texts.append(monte_carlo_text(asked.simulated))
    return "\n\n".join(texts)


def _simulate(solved: Solved, count: int, seed: int) -> MonteCarlo:
    """Many sessions with a progress bar on standard error."""
    from rich.console import Console
    from rich.progress import Progress

    from app.evaluating.accuracy import monte_carlo

    # a bar needs the terminal's own codes, and shows no text of a file
    with Progress(console=Console(file=sys.__stderr__), transient=True) as bar:
        task = bar.add_task("sessions", total=count)
        return monte_carlo(solved, count, seed, lambda done: bar.update(task, completed=done))
