"""Machines with three linear drives as commands ask them."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from app.machines.family import Answer, Family, Say, Search, Simulation, Solving
from app.planning.request import Request
from protocols.machine_files import USUAL_MACHINE, machine_names

if TYPE_CHECKING:  # heavy: imported where used
    from app.evaluating.solution import SessionSolution
    from app.report.schema.document import Report
    from calib.identify.monte_carlo import MonteCarlo


def identifiability(name: str, request: Request) -> Answer:
    """What the procedure sees."""
    from app.planning.tripod import tripod_planning
    from app.report.schema.planning import IdentifiabilityReport
    from app.report.text.planning import identifiability_text
    from calib.design.planning import seen_by

    seen = seen_by(tripod_planning(name, request)[0])
    return Answer(lambda: identifiability_text(seen), lambda: IdentifiabilityReport.of(seen=seen))


def postures(name: str, request: Request, search: Search, say: Say) -> Answer:
    """Postures from a list, and procedures that visit them."""
    from app.planning.tripod import tripod_planning, write_procedures
    from app.report.schema.planning import PosturesReport
    from app.report.text.planning import postures_text
    from calib.design.criteria import Criterion
    from calib.design.optimum import optimum_postures
    from calib.errors import UsageError

    if search.count is None:
        raise UsageError("--count", "none", "how many postures to choose")
    planned, like = tripod_planning(name, request)
    chosen = optimum_postures(
        planned,
        search.count,
        criterion=search.criterion or Criterion.DETERMINANT,
        budget_min=search.budget_min,
        seed=request.seed,
        starts=search.starts,
        repeats=search.repeats,
        common=search.common,
        refine=search.refine,
    )
    if search.output:
        for path in write_procedures(chosen.orders, like, search.output):
            say(f"procedure written to {path}")
    return Answer(lambda: postures_text(chosen), lambda: PosturesReport.of(chosen=chosen))


def simulate(asked: Simulation, say: Say) -> None:
    """A session of the nominal machine, or of that of a model file."""
    from app.evaluating.own_effects import known_laws
    from app.measuring.hidden_effect import hidden_effect
    from app.measuring.simulated import planned_readings, simulated_session
    from calib.errors import UsageError
    from calib.tripod.pipeline import Model
    from protocols.journal import write_whole
    from protocols.machine import load_machine
    from protocols.model_file import read_model
    from protocols.procedure import load_procedure

    if asked.size is not None and asked.effect is None:
        raise UsageError("--size", "no --effect", "the size of an effect: both options, or none")
    if asked.model and asked.machine:
        raise UsageError("--model and --machine", "both", "one: a model brings its own machine")
    known = load_machine(asked.machine)
    real = Model(known.geometry())
    if asked.model:
        real, known = read_model(asked.model, known_laws())
    planned = load_procedure(asked.protocol or known.usual_procedure, known.geometry())
    if asked.effect is not None:
        hidden = hidden_effect(
            asked.effect,
            real,
            planned_readings(planned, known),
            laws=known_laws(),
            seed=asked.seed,
            noise_mm=max(asked.scatter_mm, asked.resolution_mm),
            size=asked.size,
        )
        real = replace(real, effects=(*real.effects, *hidden))
    opened, readings = simulated_session(
        planned,
        known,
        real,
        seed=asked.seed,
        scatter_mm=asked.scatter_mm,
        resolution_mm=asked.resolution_mm,
    )
    write_whole(asked.output, opened, list(readings))
    say(f"{len(readings)} simulated readings written to {asked.output}")


def solve(asked: Solving, say: Say) -> Answer:
    """Parameters with uncertainties from sessions. Raises UsageError for what they do not allow."""
    from app.evaluating.solution import solve_files

    solved, warnings = solve_files(
        asked.files,
        subset=asked.subset,
        method=asked.method,
        weights=asked.weights,
        model=asked.model,
    )
    for warning in warnings:
        say(f"glidecal: {warning}")
    judged = mapped = simulated = None
    if asked.tolerance_mm is not None or asked.show_map:
        from app.evaluating.accuracy import judge, maps

        judged = None if asked.tolerance_mm is None else judge(solved, asked.tolerance_mm)
        mapped = maps(solved) if asked.show_map else None
    if asked.monte_carlo:
        simulated = _monte_carlo(solved, asked.monte_carlo, asked.seed)

    def text() -> str:
        from app.report.text.result import judged_text, maps_text, monte_carlo_text, solution_text

        parts = [solution_text(solved)]
        parts += [judged_text(judged)] if judged else []
        parts += [maps_text(mapped)] if mapped else []
        parts += [monte_carlo_text(simulated)] if simulated else []
        return "\n\n".join(parts)

    def document() -> Report:
        from app.report.schema.solution import SolutionReport

        sizes = solved.solution.sizes or None
        return SolutionReport.of(
            solved=solved, sizes=sizes, judged=judged, maps=mapped, simulated=simulated
        )

    return Answer(text, document)


def _monte_carlo(solved: SessionSolution, count: int, seed: int) -> MonteCarlo:
    """Many sessions with a progress bar on standard error."""
    from rich.console import Console
    from rich.progress import Progress

    from app.evaluating.accuracy import monte_carlo

    # a bar needs the terminal's own codes, and shows no text of a file
    with Progress(console=Console(file=sys.__stderr__), transient=True) as bar:
        task = bar.add_task("sessions", total=count)
        return monte_carlo(solved, count, seed, lambda done: bar.update(task, completed=done))


FAMILY = Family(
    name=USUAL_MACHINE,
    names=machine_names(),
    measured="sessions",
    own={
        "identifiability": frozenset({"noise"}),
        "postures": frozenset({"noise", "budget", "repeats", "common", "refine"}),
        "simulate": frozenset({"protocol", "model", "scatter", "resolution", "effect", "size"}),
        "solve": frozenset({"subset", "method", "weights", "tolerance", "show_map", "monte_carlo"}),
    },
    reads=lambda _path: False,
    identifiability=identifiability,
    postures=postures,
    simulate=simulate,
    solve=solve,
)
