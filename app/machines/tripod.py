"""Machines with three linear drives as commands ask them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from app.machines.options import (
    RESOLUTION_MM,
    SCATTER_MM,
    Answer,
    Family,
    Force,
    FrameName,
    HoldsName,
    MacroName,
    Method,
    Place,
    PostureSearch,
    PrintableRadius,
    Protocol,
    Question,
    Say,
    Simulation,
    SubsetName,
    deliver,
    figure,
    file,
    may_replace,
    may_write,
    number,
    option,
    working,
)
from calib.errors import UsageError
from calib.printable import counted
from protocols.machine_files import SCHEMA, USUAL_MACHINE, machine_names

if TYPE_CHECKING:  # heavy: imported where used
    from app.exports.macros import Dialect
    from app.report.schema.document import Report
    from protocols.machine import Machine
    from protocols.procedure import Procedure


Noise = Annotated[
    float | None, number("Standard deviation of a reading, mm, more than 0.", most=10.0)
]
MountingSeconds = Annotated[float, number("Time for a new mounting.", 0.0, 86400.0)]


@dataclass(frozen=True)
class IdentifiabilityOptions:
    """Options of ``identifiability``."""

    noise: Noise = None


def identifiability(question: Question, options: IdentifiabilityOptions) -> Answer:
    """What the procedure sees."""
    from app.planning.tripod import tripod_planning
    from app.report.schema.planning import IdentifiabilityReport
    from app.report.text.planning import expected_text, identifiability_text
    from calib.design.identifiability import seen_by
    from calib.posterior.expected import expected_of

    machine, procedure = _machine_and_procedure(question)
    planned = tripod_planning(machine, procedure, options.noise)
    identifiable = seen_by(planned)
    expected = expected_of(planned, machine.tolerances_mm())
    return Answer(
        lambda: f"{identifiability_text(identifiable)}\n\n{expected_text(expected)}",
        lambda: IdentifiabilityReport.of(identifiable, expected),
    )


def _machine_and_procedure(question: Question) -> tuple[Machine, Procedure]:
    """A machine, with its usual procedure where none is named."""
    from protocols.machine import load_machine
    from protocols.procedure import procedure_on

    machine = load_machine(question.machine_file or question.machine)
    return machine, procedure_on(machine, question.procedure)


@dataclass(frozen=True)
class PostureOptions:
    """Options of ``postures``."""

    noise: Noise = None
    budget: Annotated[float | None, number("Minutes at most, with set-up.", 0.0)] = None
    mounting_seconds: MountingSeconds = 120.0
    repeats: Annotated[bool, option("A posture may be chosen more than once.", "--repeats")] = False
    common: Annotated[bool, option("The same displacements on all legs: one file.", "--common")] = (
        False
    )
    refine: Annotated[bool, option("Move the chosen postures off the grid, or keep to it.")] = True


def postures(
    question: Question, search: PostureSearch, options: PostureOptions, say: Say
) -> Answer:
    """Postures from a list, and procedures that visit them."""
    from app.planning.tripod import procedure_files, tripod_planning
    from app.report.schema.planning import PosturesReport
    from app.report.text.planning import postures_text
    from calib.tripod.optimum import optimum_postures
    from protocols.files import targets_of, write_files

    if search.count is None:
        raise UsageError("--count", "none", "how many postures to choose")
    may = may_write(search.output, ".toml", force=search.force)  # run --protocol takes no other
    minutes = options.mounting_seconds / 60.0
    machine, like = _machine_and_procedure(question)
    planned = tripod_planning(machine, like, options.noise, minutes)
    with working("Looking for postures"):
        optimum = optimum_postures(
            planned,
            search.count,
            criterion=search.criterion,
            budget_min=options.budget,
            seed=search.seed,
            starts=search.starts,
            repeats=options.repeats,
            common=options.common,
            refine=options.refine,
        )
    if search.output:
        target, contents = procedure_files(optimum.orders, like, search.output)
        may = may_replace(may, *targets_of(target, contents))
        for path in write_files(target, contents, replace=may):
            say(f"procedure written to {path}")
    return Answer(lambda: postures_text(optimum), lambda: PosturesReport.of(optimum))


@dataclass(frozen=True)
class SimulateOptions:
    """Options of ``simulate``."""

    protocol: Protocol = None
    model: Annotated[Path | None, file("Model file (JSON).", to_read=True)] = None
    scatter: Annotated[float, figure("Scatter of a re-approach, mm.")] = SCATTER_MM
    resolution: Annotated[float, figure("Step of the display, mm; 0: none.")] = RESOLUTION_MM
    effect: Annotated[str | None, option("Hide an effect in the machine: ID or ID:WHERE.")] = None
    size: Annotated[
        float | None, number("Its largest value, in its own unit; default: well above the scatter.")
    ] = None


def simulate(simulation: Simulation, options: SimulateOptions, say: Say) -> None:
    """A session of the nominal machine, or of that of a model file."""
    from app.measuring.simulated import simulated_of_files
    from protocols.journal import write_whole

    simulated = simulated_of_files(
        options.protocol,
        simulation.machine,
        options.model,
        effect=options.effect,
        size=options.size,
        seed=simulation.seed,
        scatter_mm=options.scatter,
        resolution_mm=options.resolution,
    )
    write_whole(simulation.output, simulated.opened, [*simulated.readings])
    say(f"{counted(len(simulated.readings), 'simulated reading')} written to {simulation.output}")


@dataclass(frozen=True)
class SolveOptions:
    """Options of ``solve``."""

    subset: Annotated[
        SubsetName | None,
        option("Set of parameters to view; default: joint-offsets, else with-tolerances."),
    ] = None
    method: Method = "exact"
    frame: FrameName = None
    holds: HoldsName = "offsets"
    weights: Annotated[
        Literal["equal", "covariance"],
        option("Linear method only: equal as in the papers, or covariance (14)."),
    ] = "equal"
    model: Annotated[
        Path | None, file("Fit the sizes of this model's effects together with the parameters.")
    ] = None
    tolerance: Annotated[
        float | None, number("Judge the tool's r.m.s. error against this, mm.")
    ] = None
    show_map: Annotated[bool, option("Expected tool error on three planes.", "--map")] = False
    show_figures: Annotated[bool, option("Draw readings and residuals, by leg.", "--figures")] = (
        False
    )
    monte_carlo: Annotated[
        int | None, option("Check with this number of simulated sessions.", min=1)
    ] = None
    seed: Annotated[int | None, option("Seed of --monte-carlo.", min=0, show_default="1")] = None


def _check_options(options: SolveOptions) -> None:
    """Raises UsageError for an option that would be ignored."""
    if options.weights != "equal" and options.method != "linear":
        raise UsageError(
            "--weights", f"{options.weights} with --method {options.method}", "--method linear"
        )
    if options.seed is not None and options.monte_carlo is None:
        raise UsageError("--seed", f"{options.seed} without --monte-carlo", "both")


def solve(files: Sequence[Path], options: SolveOptions, say: Say) -> Answer:
    """Values to enter and parameters of sessions. Raises UsageError for what they do not allow."""
    from app.evaluating.solution import solve_files

    _check_options(options)
    with working("Solving"):
        result = solve_files(
            files,
            subset=options.subset,
            method=options.method,
            weights=options.weights,
            model=options.model,
            frame=options.frame,
            holds=options.holds,
        ).work_out()
    for warning in result.warnings:
        say(f"glidecal: {warning}")
    judged = mapped = simulated = None
    if options.tolerance is not None:
        from app.evaluating.solution import judge

        judged = judge(result, options.tolerance)
    if options.show_map:
        mapped = result.tool_maps
    if options.monte_carlo:
        from app.evaluating.solution import monte_carlo

        with working("Simulating sessions"):
            simulated = monte_carlo(
                result, options.monte_carlo, 1 if options.seed is None else options.seed
            )

    def text() -> str:
        from app.report.text.result import judged_text, maps_text, monte_carlo_text, solution_text

        parts = [solution_text(result)]
        parts += [judged_text(judged)] if judged else []
        parts += [maps_text(mapped, result.frame)] if mapped else []
        if options.show_figures:
            from app.report.charts.characters import legs_text
            from app.report.charts.legs import leg_figures

            parts.append(legs_text(leg_figures(result)))
        parts += [monte_carlo_text(simulated)] if simulated else []
        return "\n\n".join(parts)

    def document() -> Report:
        from app.report.schema.solution import SolutionReport

        if options.show_figures:
            raise UsageError("--json", "beside --figures, which are text", "one of them")
        return SolutionReport.of(result, judged, mapped, simulated)

    return Answer(text, document)


@dataclass(frozen=True)
class PlanOptions:
    """Options of ``plan``."""

    model: Annotated[Path | None, file("Model file (JSON).", to_read=True)] = None
    noise: Noise = None
    mounting_seconds: MountingSeconds = 120.0
    frame: FrameName = None
    holds: HoldsName = "offsets"
    macro: MacroName = None
    protocol: Annotated[str | None, option("With --macro: procedure by name, or a .toml file.")] = (
        None
    )
    printable_radius: PrintableRadius = None
    output: Annotated[Path | None, file("With --macro: file to write.", "--output", "-o")] = None
    force: Force = False


def plan(machine: str | None, sessions: Sequence[Path], options: PlanOptions, say: Say) -> Answer:
    """The measurement that is worth its minutes most; or the places of a plate as a macro."""
    from app.evaluating.loading import load_sessions
    from app.planning.tripod import next_measurement
    from app.report.schema.plan import PlanReport
    from app.report.text.planning import plan_text

    if options.macro:
        return _macro(options.macro, machine, sessions, options)
    for name in ("protocol", "printable_radius", "output", "force"):
        if getattr(options, name):
            raise UsageError(f"--{name.replace('_', '-')}", "no --macro", "with --macro alone")
    with working("Looking for the next measurement"):
        measured, warnings = load_sessions(sessions)
        measurement = next_measurement(
            measured,
            machine_file=machine,
            model_file=options.model,
            noise_mm=options.noise,
            minutes_per_mounting=options.mounting_seconds / 60.0,
            frame=options.frame,
            holds=options.holds,
        )
        text = plan_text(measurement)  # works out all that the document has, too
    for warning in warnings:
        say(f"glidecal: {warning}")
    return Answer(lambda: text, lambda: PlanReport.of(measurement))


def _macro(
    dialect: Dialect, machine: str | None, sessions: Sequence[Path], options: PlanOptions
) -> Answer:
    """The places of a procedure on the machine of the last session, or on this one."""
    from app.evaluating.loading import load_sessions
    from app.exports.macros import macro
    from protocols.files import STANDARD_OUTPUT
    from protocols.machine import load_machine
    from protocols.procedure import procedure_on

    if sessions and machine is not None:
        raise UsageError("--machine", "beside a session, which has its own", "one of them")
    measured, _ = load_sessions(sessions)
    machine_known = measured[-1].opened.machine if measured else load_machine(machine)
    procedure = procedure_on(machine_known, options.protocol)
    text = macro(dialect, procedure, machine_known, options.printable_radius)

    def shown() -> str:
        if options.output in (None, STANDARD_OUTPUT):
            return text.removesuffix("\n")
        deliver(options.output, {"": text}, force=options.force)
        return "Run it on the printer, save all that the firmware answers, and import that log."

    def document() -> Report:
        raise UsageError("--json", "beside --macro, which is G-code", "one of them")

    return Answer(shown, document)


def workspace(name: str, limit: float, at_mm: Place | None) -> Answer:
    """What joint limits allow, the factors there, a cut at a limit of them; or one posture."""
    from app.report.schema.planning import PostureReport, WorkspaceReport
    from app.report.text.planning import posture_text, workspace_text
    from calib.tripod.workspace import posture_of_tool, workspace_of
    from protocols.machine import load_machine

    machine = load_machine(name)
    geometry = machine.geometry()
    if at_mm is not None:
        posture = posture_of_tool(geometry, at_mm)
        return Answer(
            lambda: posture_text(machine, posture), lambda: PostureReport.of(machine, posture)
        )
    with working("Looking at the workspace"):
        reachable = workspace_of(geometry, limit)
    return Answer(
        lambda: workspace_text(machine, reachable), lambda: WorkspaceReport.of(machine, reachable)
    )


FAMILY = Family(
    name=USUAL_MACHINE,
    names=machine_names(),
    schema=SCHEMA,
    measured="sessions of legs or contacts",
    criterion="determinant",
    posture_file="procedure (.toml)",
    options={
        "identifiability": IdentifiabilityOptions,
        "postures": PostureOptions,
        "simulate": SimulateOptions,
        "solve": SolveOptions,
        "plan": PlanOptions,
    },
    reads=lambda _path: False,
    identifiability=identifiability,
    postures=postures,
    simulate=simulate,
    solve=solve,
    plan=plan,
    workspace=workspace,
)
