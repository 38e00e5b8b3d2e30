"""Machines with three linear drives as commands ask them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

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
    SubsetName,
    check_ending,
    deliver,
    figure,
    file,
    may_replace,
    may_write,
    number,
    option,
    say,
    tell_warnings,
    working,
)
from calib.errors import UsageError
from calib.printable import counted
from protocols.machine_files import SCHEMA, USUAL_MACHINE, machine_names

if TYPE_CHECKING:  # heavy: imported where used
    from app.evaluating.solution import SessionSolution
    from app.exports.macros import Dialect
    from app.report.schema.document import Report
    from protocols.machine import Machine
    from protocols.procedure import Procedure


Noise = Annotated[
    float | None, number("Standard deviation of a reading, mm, more than 0.", most=10.0)
]
MountingSeconds = Annotated[float, number("Time for a new mounting.", 0.0, 86400.0)]


def identifiability(
    name: str, procedure_name: str | None, machine_file: Path | None, *, noise: Noise = None
) -> Answer[Any]:
    """What the procedure sees."""
    from app.planning.tripod import tripod_planning
    from app.report.schema.planning import IdentifiabilityReport
    from app.report.text.planning import expected_text, identifiability_text
    from calib.design.identifiability import seen_by
    from calib.posterior.expected import expected_of

    machine, procedure = _machine_and_procedure(machine_file or name, procedure_name)
    planned = tripod_planning(machine, procedure, noise)
    identifiable = seen_by(planned)
    expected = expected_of(planned, machine.tolerances_mm())
    return Answer(
        identifiable,
        lambda view: f"{identifiability_text(view)}\n\n{expected_text(expected)}",
        lambda view: IdentifiabilityReport.of(view, expected),
    )


def _machine_and_procedure(
    machine_name: Path | str, procedure_name: str | None
) -> tuple[Machine, Procedure]:
    """A machine, with its usual procedure where none is named."""
    from protocols.machine import load_machine
    from protocols.procedure import procedure_on

    machine = load_machine(machine_name)
    return machine, procedure_on(machine, procedure_name)


def postures(
    name: str,
    procedure_name: str,
    machine_file: Path | None,
    search: PostureSearch,
    *,
    noise: Noise = None,
    budget: Annotated[float | None, number("Minutes at most, with set-up.", 0.0)] = None,
    mounting_seconds: MountingSeconds = 120.0,
    repeats: Annotated[
        bool, option("A posture may be chosen more than once.", "--repeats")
    ] = False,
    common: Annotated[bool, option("The same displacements on all legs: one file.", "--common")] = (
        False
    ),
    refine: Annotated[bool, option("Move the chosen postures off the grid, or keep to it.")] = True,
) -> Answer[Any]:
    """Postures from a list, and procedures that visit them."""
    from app.planning.tripod import procedure_files, tripod_planning
    from app.report.schema.planning import PosturesReport
    from app.report.text.planning import postures_text
    from calib.design.criteria import Criterion
    from calib.tripod.optimum import optimum_postures
    from protocols.files import targets_of, write_files

    if search.count is None:
        raise UsageError("--count", "none", "how many postures to choose")
    may = may_write(search.output, ".toml", force=search.force)  # run --protocol takes no other
    machine, like = _machine_and_procedure(machine_file or name, procedure_name)
    planned = tripod_planning(machine, like, noise, mounting_seconds / 60.0)
    with working("Looking for postures"):
        optimum = optimum_postures(
            planned,
            search.count,
            criterion=Criterion(search.criterion),
            budget_min=budget,
            seed=search.seed,
            starts=search.starts,
            repeats=repeats,
            common=common,
            refine=refine,
        )
    if search.output:
        target, contents = procedure_files(optimum.orders, like, search.output)
        may = may_replace(may, *targets_of(target, contents))
        for path in write_files(target, contents, replace=may):
            say(f"procedure written to {path}")
    return Answer(optimum, postures_text, PosturesReport.of)


def simulate(
    output: Path,
    machine: str | None,
    seed: int,
    _force: bool = False,
    *,
    protocol: Protocol = None,
    model: Annotated[Path | None, file("Model file (JSON).", to_read=True)] = None,
    scatter: Annotated[float, figure("Scatter of a re-approach, mm.")] = SCATTER_MM,
    resolution: Annotated[float, figure("Step of the display, mm; 0: none.")] = RESOLUTION_MM,
    effect: Annotated[str | None, option("Hide an effect in the machine: ID or ID:WHERE.")] = None,
    size: Annotated[
        float | None, number("Its largest value, in its own unit; default: well above the scatter.")
    ] = None,
) -> None:
    """A session of the nominal machine, or of that of a model file."""
    from app.measuring.simulated import simulated_of_files
    from protocols.journal import write_whole

    check_ending(output, ".jsonl")
    simulated = simulated_of_files(
        protocol,
        machine,
        model,
        effect=effect,
        size=size,
        seed=seed,
        scatter_mm=scatter,
        resolution_mm=resolution,
    )
    write_whole(output, simulated.opened, [*simulated.readings])
    say(f"{counted(len(simulated.readings), 'simulated reading')} written to {output}")


def solve(
    files: Sequence[Path],
    *,
    subset: Annotated[
        SubsetName | None,
        option("Set of parameters to view; default: joint-offsets, else with-tolerances."),
    ] = None,
    method: Method = "exact",
    frame: FrameName = None,
    holds: HoldsName = "offsets",
    weights: Annotated[
        Literal["equal", "covariance"],
        option("Linear method only: equal as in the papers, or covariance (14)."),
    ] = "equal",
    model: Annotated[
        Path | None, file("Fit the sizes of this model's effects together with the parameters.")
    ] = None,
    tolerance: Annotated[
        float | None, number("Judge the tool's r.m.s. error against this, mm.")
    ] = None,
    show_map: Annotated[bool, option("Expected tool error on three planes.", "--map")] = False,
    show_figures: Annotated[bool, option("Draw readings and residuals, by leg.", "--figures")] = (
        False
    ),
    monte_carlo: Annotated[
        int | None, option("Check with this number of simulated sessions.", min=1)
    ] = None,
    seed: Annotated[int | None, option("Seed of --monte-carlo.", min=0, show_default="1")] = None,
) -> Answer[Any]:
    """Values to enter and parameters of sessions.

    Raises UsageError for what they do not allow, and for an option that would be ignored.
    """
    from app.evaluating.solution import judge, monte_carlo_of, solve_files

    if weights != "equal" and method != "linear":
        raise UsageError("--weights", f"{weights} with --method {method}", "--method linear")
    if seed is not None and monte_carlo is None:
        raise UsageError("--seed", f"{seed} without --monte-carlo", "both")
    with working("Solving"):
        result = solve_files(
            files,
            subset=subset,
            method=method,
            weights=weights,
            model=model,
            frame=frame,
            holds=holds,
        ).work_out()
    tell_warnings(result.warnings)
    judged = None if tolerance is None else judge(result, tolerance)
    mapped = result.tool_maps if show_map else None
    simulated = None
    if monte_carlo:
        with working("Simulating sessions"):
            simulated = monte_carlo_of(result, monte_carlo, 1 if seed is None else seed)

    def text(result: SessionSolution) -> str:
        from app.report.text.result import judged_text, maps_text, monte_carlo_text, solution_text

        parts = [solution_text(result)]
        parts += [judged_text(judged)] if judged else []
        parts += [maps_text(mapped, result.frame)] if mapped else []
        if show_figures:
            from app.report.charts.characters import legs_text
            from app.report.charts.legs import leg_figures

            parts.append(legs_text(leg_figures(result)))
        parts += [monte_carlo_text(simulated)] if simulated else []
        return "\n\n".join(parts)

    def document(result: SessionSolution) -> Report:
        from app.report.schema.solution import SolutionReport

        if show_figures:
            raise UsageError("--json", "beside --figures, which are text", "one of them")
        return SolutionReport.of(result, judged, mapped, simulated)

    return Answer(result, text, document)


def plan(
    machine: str | None,
    sessions: Sequence[Path],
    *,
    model: Annotated[Path | None, file("Model file (JSON).", to_read=True)] = None,
    noise: Noise = None,
    mounting_seconds: MountingSeconds = 120.0,
    frame: FrameName = None,
    holds: HoldsName = "offsets",
    macro: MacroName = None,
    protocol: Annotated[str | None, option("With --macro: procedure by name, or a .toml file.")] = (
        None
    ),
    printable_radius: PrintableRadius = None,
    output: Annotated[Path | None, file("With --macro: file to write.", "--output", "-o")] = None,
    force: Force = False,
) -> Answer[Any]:
    """The measurement that is worth its minutes most; or the places of a plate as a macro."""
    from app.evaluating.loading import load_sessions
    from app.planning.tripod import next_measurement
    from app.report.schema.plan import PlanReport
    from app.report.text.planning import plan_text

    if macro:
        if sessions and machine is not None:
            raise UsageError("--machine", "beside a session, which has its own", "one of them")
        return _macro(macro, machine, sessions, protocol, printable_radius, output, force=force)
    with_macro = {
        "--protocol": protocol,
        "--printable-radius": printable_radius,
        "--output": output,
        "--force": force,
    }
    for name, value in with_macro.items():
        if value:
            raise UsageError(name, "no --macro", "with --macro alone")
    with working("Looking for the next measurement"):
        measured, warnings = load_sessions(sessions)
        measurement = next_measurement(
            measured,
            machine_file=machine,
            model_file=model,
            noise_mm=noise,
            minutes_per_mounting=mounting_seconds / 60.0,
            frame=frame,
            holds=holds,
        )
        text = plan_text(measurement)  # works out all that the document has, too
    tell_warnings(warnings)
    return Answer(measurement, lambda _: text, PlanReport.of)


def _macro(
    dialect: Dialect,
    machine_name: str | None,
    sessions: Sequence[Path],
    procedure_name: str | None,
    printable_mm: float | None,
    output: Path | None,
    *,
    force: bool,
) -> Answer[str]:
    """The places of a procedure on the machine of the last session, or on this one."""
    from app.evaluating.loading import load_sessions
    from app.exports.macros import macro
    from protocols.files import STANDARD_OUTPUT
    from protocols.machine import load_machine
    from protocols.procedure import procedure_on

    measured, _ = load_sessions(sessions)
    machine = measured[-1].opened.machine if measured else load_machine(machine_name)
    procedure = procedure_on(machine, procedure_name)

    def shown(text: str) -> str:
        if output in (None, STANDARD_OUTPUT):
            return text.removesuffix("\n")
        deliver(output, {"": text}, force=force)
        return "Run it on the printer, save all that the firmware answers, and import that log."

    def document(_text: str) -> Report:
        raise UsageError("--json", "beside --macro, which is G-code", "one of them")

    return Answer(macro(dialect, procedure, machine, printable_mm), shown, document)


def workspace(name: str, limit: float, at_mm: Place | None) -> Answer[Any]:
    """What joint limits allow, the factors there, a cut at a limit of them; or one posture."""
    from app.report.schema.planning import PostureReport, WorkspaceReport
    from app.report.text.planning import posture_text, workspace_text
    from calib.tripod.workspace import posture_of_tool, workspace_of
    from protocols.machine import load_machine

    machine = load_machine(name)
    geometry = machine.geometry()
    if at_mm is not None:
        posture = posture_of_tool(geometry, at_mm)
        return Answer(posture, partial(posture_text, machine), partial(PostureReport.of, machine))
    with working("Looking at the workspace"):
        reachable = workspace_of(geometry, limit)
    return Answer(reachable, partial(workspace_text, machine), partial(WorkspaceReport.of, machine))


FAMILY = Family(
    name=USUAL_MACHINE,
    names=machine_names(),
    schema=SCHEMA,
    measured="sessions of legs or contacts",
    criterion="determinant",
    posture_file="procedure (.toml)",
    reads=lambda _path: False,
    identifiability=identifiability,
    postures=postures,
    simulate=simulate,
    solve=solve,
    plan=plan,
    workspace=workspace,
)
