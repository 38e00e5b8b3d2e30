"""What a procedure sees, optimum postures and the next measurement in words."""

from __future__ import annotations

import math

from app.measuring.plan import Plan
from app.planning.tripod import MeasurementPlan, before_measuring
from app.report.text.correction import FRAME_WORDS, HOLDS_WORDS
from app.report.text.tables import (
    map_table,
    new_table,
    paragraphs,
    result_table,
    uncertain,
    wrapped,
)
from calib.arrays import LEG_NAMES, FloatArray
from calib.design.criteria import Criterion
from calib.design.identifiability import SeenBy
from calib.diagnosis.results import AliasMap, EffectName
from calib.errors import GlidecalError
from calib.posterior.expected import ExpectedParameter, ExpectedResult
from calib.posterior.measurements import stand_words
from calib.posterior.planning import WORTH, OutsideMeasurement, Reach, Separation
from calib.stats import coverage_factor
from calib.tripod.optimum import ChosenPostures
from calib.tripod.workspace import PostureOfTool, Workspace
from protocols.machine import Machine
from protocols.procedure import position_words

COVERAGE = coverage_factor(math.inf)
"""Factor from standard to expanded uncertainty (95 %) with a known noise."""

PARTS = "noise, tolerances of the parts"

CRITERION_WORDS = {
    Criterion.DETERMINANT: "geometric mean of the singular values (largest is best)",
    Criterion.AVERAGE_VARIANCE: "mean variance of the parameters, mm² (smallest is best)",
    Criterion.SMALLEST_SINGULAR_VALUE: "smallest singular value, 1/mm (largest is best)",
    Criterion.CONDITION: "condition number (smallest is best)",
    Criterion.NOISE_AMPLIFICATION: "smallest squared by largest singular value (largest is best)",
    Criterion.TOOL_VARIANCE: "mean square tool error, mm² (smallest is best)",
}


def identifiability_text(seen_by: SeenBy) -> str:
    """The sentence that matters, combinations with added measurements, then the classical test."""
    examined, identifiability = seen_by.examined, seen_by.identifiability
    steps = "steps" if examined.fewest_postures is None else "postures"
    return paragraphs(
        f"{seen_by.machine}, {examined.procedure}: {examined.posture_count} {steps} reading "
        f"{', '.join(examined.measured)}; noise {examined.noise_words}",
        _verdict(seen_by),
        _combinations(seen_by),
        f"Condition number {identifiability.condition_number:.1f} of the identifiable combinations "
        f"({examined.units}; 1 is the least possible).\n"
        f"Classical QR (papers/001), |r_ii| ≤ {seen_by.qr.tolerance:.2g}: flags "
        f"{', '.join(seen_by.qr.flagged) or 'none'}. "
        "WARNING: that test uses neither noise nor tolerance and depends on the order of the "
        "parameters; the lines above decide.",
    )


def expected_text(expected: ExpectedResult) -> str:
    """What each parameter and the tool will be known to, once this is measured."""
    table = result_table(ExpectedParameter, expected.parameters)
    because = f", most of it because of {' ('.join(expected.worst)})" if expected.worst else ""
    return paragraphs(
        table,
        "Tool over the workspace with joint offsets entered, if the readings show nothing else: at "
        f"most {uncertain(expected.bound_mm)} mm r.m.s. (95 %), {FRAME_WORDS['touched-off']}"
        f"{because}.",
    )


def before_measuring_text(expected: ExpectedResult, noise_words: str) -> str:
    """What is expected, below the steps of a procedure."""
    return f"Before measuring, noise {noise_words}:\n\n{expected_text(expected)}"


def plan_expected_text(plan: Plan) -> str:
    """What is expected of a plan, or why nothing can be."""
    try:
        expected = before_measuring(plan.procedure, plan.machine, plan.instruments)
    except GlidecalError as problem:
        return str(problem)
    return before_measuring_text(*expected)


def _verdict(seen_by: SeenBy) -> str:
    count, rank = len(seen_by.identifiability.names), seen_by.identifiability.rank
    if rank == count:
        text = f"All {count} combinations of the {count} parameters are identifiable"
        text += f", {len(seen_by.weak)} of them weakly." if seen_by.weak else "."
    else:
        text = f"{rank} of {count} combinations of the parameters are identifiable"
        text += f", {count - rank} not."
    known_names = ", ".join(seen_by.identifiability.individually_known) or "none"
    text += f"\nParameters identifiable alone: {known_names}."
    text += f"\n{seen_by.examined.remark}" if seen_by.examined.remark else ""
    fewest = seen_by.examined.fewest_postures
    if seen_by.limited_by == "too-few-postures" and fewest is not None:
        text += f"\nToo few postures: {fewest} or more are needed. Measure more postures."
    elif seen_by.limited_by == "too-few-postures":
        text += (
            f"\nOnly {seen_by.examined.independent_count} differences for {count} parameters: "
            "measure more postures."
        )
    return text


def _combinations(seen_by: SeenBy) -> str:
    lines = []
    enough = seen_by.limited_by == "nothing"
    without = "No posture of this procedure shows" if enough else "More postures may show"
    for direction in (*seen_by.unidentifiable, *seen_by.weak):
        u, tool_mm = direction.standard_uncertainty_mm, direction.tool_mm
        sentence = f"NOT IDENTIFIABLE: {direction.name}."
        if u is not None and tool_mm is not None:
            half, tool = COVERAGE * u, COVERAGE * tool_mm
            sentence = (
                f"WEAK: {direction.name} known only to ±{half:.3f} mm (95 %), "
                f"{FRAME_WORDS['machine']} ±{tool:.3f} mm at the tool."
            )
        lines.append(sentence)
        if direction.cure is not None:
            half = COVERAGE * direction.cure.standard_uncertainty_mm
            lines.append(f"  Best single addition: {direction.cure.posture}; then ±{half:.3f} mm.")
        elif u is None:
            lines.append(f"  {without} it.")
    return "\n".join(lines)


def postures_text(optimum: ChosenPostures) -> str:
    """Criteria before and after, then the postures."""
    figures = new_table("", optimum.procedure, "chosen")
    for name, kind in (
        ("postures", "count"),
        ("criterion", "value"),
        ("condition number", "condition_number"),
        ("smallest singular value, 1/mm", "smallest_singular_value"),
        ("tool error from noise, r.m.s. mm", "tool_mm"),
        ("minutes with set-up", "minutes"),
    ):
        values = (getattr(figure, kind) for figure in (optimum.before, optimum.after))
        figures.add_row(name, *("not identifiable" if v is None else f"{v:.4g}" for v in values))
    names = list(optimum.postures[0])
    table = new_table(*(name.replace("_mm", ", mm") for name in names))
    for posture in optimum.postures:
        values = (posture[name] for name in names)
        table.add_row(*(v if isinstance(v, str) else f"{v:g}" for v in values))
    grid, value = optimum.grid_value, optimum.after.value
    if grid is None:  # a file holds just what is judged here
        moved = "The postures keep to the grid: --no-refine."
    elif value is None or value == grid:
        moved = "The grid is kept: off it nothing is better within the time."
    else:
        moved = (
            f"Moved off the grid: criterion {grid:.4g} → {value:.4g}. Displacements are whole "
            "tenths of a millimetre or a joint limit, stations whole hundredths; --no-refine keeps "
            "round ones."
        )
    return paragraphs(
        f"{optimum.machine}: {optimum.after.count} postures for the {optimum.criterion.value} "
        f"criterion, {CRITERION_WORDS[optimum.criterion]}; noise {optimum.noise_words}",
        figures,
        table,
        moved,
        f"{optimum.coordinates_on_bound} coordinates are on a bound of the search. Best of "
        f"{optimum.starts} starts, seed {optimum.seed}, {optimum.exchanges} exchanges, "
        f"{optimum.seconds:.2f} s.",
    )


NOTHING_YET = (
    "With nothing measured yet this is a mean over machines of every kind, also over those whose "
    "errors no offset removes. Most are better: plan again after the first session."
)


def plan_text(plan: MeasurementPlan) -> str:
    """One sentence, then the runners-up; set-ups in turn, names, and instruments outside."""
    basis = f"after {', '.join(plan.sessions)}" if plan.sessions else "with nothing measured yet"
    table = new_table("next best", "minutes", "tool at most, mm")
    for proposal in plan.runners_up:
        candidate = proposal.candidate
        table.add_row(candidate.words, f"{candidate.minutes:.1f}", uncertain(proposal.bound_mm))
    planner, best = plan.planner, plan.best
    entered = planner.correction
    hardly = "hardly " if best.bound_mm > WORTH * planner.bound_mm else ""
    bound_after = (
        f"In {best.candidate.minutes:.1f} min this {hardly}lowers the bound (95 %) of the tool "
        f"error from {uncertain(planner.bound_mm)} to {uncertain(best.bound_mm)} mm r.m.s., "
        f"{FRAME_WORDS[entered.frame]}, {HOLDS_WORDS[entered.holds]} entered (noise "
        f"{plan.noise_words})."
    )
    return paragraphs(
        f"Next, {basis}: {best.candidate.words}, both axes. {bound_after}",
        table,
        further_text(planner.reach),
        "" if plan.sessions else NOTHING_YET,
        separation_text(planner.separation),
        outside_text(planner.outside),
    )


def separation_text(separation: Separation | None) -> str:
    """Which measurement separates the names that stay open; empty where none do."""
    return f"Open names: {separation.words}." if separation else ""


def outside_text(outside: OutsideMeasurement | None) -> str:
    """Which instrument shows what readings of legs do not; empty where that is the smaller part."""
    if outside is None:
        return ""
    return (
        f"{outside.share:.0%} of the square of this bound is a shift or turn of the whole "
        f"machine, which readings of legs do not show. With a {outside.instrument}, "
        f"{outside.words}. Without that part the bound is {uncertain(outside.bound_mm)} mm."
    )


def further_text(reach: Reach) -> str:
    """What bound each further set-up reaches, and when more would not help."""
    table = new_table("further set-ups", "minutes in all", "tool at most, mm")
    table.add_row("none", "0", uncertain(reach.bound_mm))
    for set_up in reach.further:
        where = stand_words(set_up.legs, set_up.station)
        table.add_row(where, f"{set_up.minutes:.0f}", uncertain(set_up.bound_mm))
    stop = "More set-ups would lower it further."
    if reach.is_last:
        subject = "After that none" if reach.further else "No set-up there and back"
        stop = f"{subject} lowers the bound by a tenth, as far as one can tell now."
    if reach.further:
        levels = ", ".join(f"{mm:+g}" if mm else "Zero" for mm in reach.further[0].displacements_mm)
        stop = f"Each is read there and back, both axes; the first at {levels} mm. {stop}"
    return paragraphs(
        "Expected bound (95 %) of the tool error after set-ups in turn, r.m.s. over the workspace:",
        table,
        stop,
    )


def alias_text(aliases: AliasMap) -> str:
    """For each effect the ones that imitate it; what no reading shows."""
    by_effect: dict[EffectName, list[str]] = {}
    for imitation in aliases.imitations:
        by = imitation.by
        by_effect.setdefault(imitation.effect, []).append(f"{by.id} ({by.where})")
    lines = [
        f"{len(aliases.effects)} effects and places; {len(by_effect)} of them can be imitated by "
        "another effect, offsets and zeros free, lengths within their tolerance:"
    ]
    lines += [
        f"{effect.id} ({effect.where}): {', '.join(dict.fromkeys(imitators))}"
        for effect, imitators in by_effect.items()
    ]
    if aliases.invisible:
        invisible_words = ", ".join(f"{effect.id} ({effect.where})" for effect in aliases.invisible)
        lines.append(f"No reading shows: {invisible_words}")
    return wrapped("\n".join(lines))


def workspace_text(machine: Machine, workspace: Workspace) -> str:
    """The box and how much of it is reached, the factors, the cut, the angles, then maps."""
    low, high = machine.travel_min_mm, machine.travel_max_mm
    basis = "stated in the machine file" if workspace.stated else "all that joint limits allow"
    box = ", ".join(
        f"{axis} {a:.0f} … {b:.0f}"
        for axis, a, b in zip(LEG_NAMES, workspace.low_mm, workspace.high_mm, strict=True)
    )
    joints = new_table("leg", "θ, °", "β, °")
    for leg, theta, beta in zip(LEG_NAMES, workspace.theta_deg, workspace.beta_deg, strict=True):
        joints.add_row(leg, *(f"{a:+z.1f} … {b:+z.1f}" for a, b in (theta, beta)))
    return paragraphs(
        f"{machine.name}: workspace {box} mm, {basis} (carriages {low:g} … {high:g} mm from Zero). "
        f"{workspace.reached:.0%} of this box is reached, {1e-6 * workspace.volume_mm3:.2f} dm³.",
        f"Velocity transmission factors, tool over carriages: {workspace.lowest_factor:.2f} … "
        f"{workspace.highest_factor:.2f}; at Zero {_factors(workspace.at_zero)}. "
        f"{_most(workspace.inside)} of the workspace keeps 1/{workspace.limit:g} … "
        f"{workspace.limit:g}.",
        _cube_words(workspace),
        "Passive joints over the workspace:",
        joints,
        "The factor furthest from 1, or its inverse, on planes through Zero (–: not reached)",
        *(map_table(plane, lambda factor: f"{factor:.2f}") for plane in workspace.maps),
    )


ROUNDED_TO_ALL = 0.9995


def _most(share: float) -> str:
    """A share in per cent; one that is not whole is never written as whole."""
    return "More than 99.9%" if ROUNDED_TO_ALL <= share < 1.0 else f"{share:.1%}"


def _cube_words(workspace: Workspace) -> str:
    limits = f"within 1/{workspace.limit:g} … {workspace.limit:g}"
    if workspace.cube is None:
        return (
            f"No cube that the joint limits allow has its factors {limits}: take a larger --limit."
        )
    side, lowest = workspace.cube.side_mm, workspace.cube.low_mm
    corners = [[float(f"{v:.1f}") for v in corner] for corner in (lowest, lowest + side)]
    return (
        f"Largest cube found that the joint limits allow, factors {limits}: {side:.1f} mm. For the "
        f"machine file: workspace_mm = {corners}"
    )


def posture_text(machine: Machine, posture: PostureOfTool) -> str:
    """Angles and factors at a place of the tool, then the other solutions."""
    stands = "allow" if posture.stands else "do NOT allow"
    joints = new_table("leg", "carriage from Zero, mm", "θ, °", "β, °")
    columns = (posture.modes[0].carriage_mm, posture.theta_deg, posture.beta_deg)
    for leg, *values in zip(LEG_NAMES, *columns, strict=True):
        joints.add_row(leg, *(f"{value:+z.3f}" for value in values))
    modes = new_table("working mode", *(f"carriage {leg}, mm" for leg in LEG_NAMES))
    for mode in posture.modes:
        signs = " ".join("+" if sign > 0 else "−" for sign in mode.signs)
        modes.add_row(signs, *(f"{v:+z.3f}" for v in mode.carriage_mm))
    x, y, z = (round(v, 3) for v in posture.assembly_mm.tolist())
    return paragraphs(
        f"{machine.name}, tool at {position_words(posture.tool_mm)}: joint limits {stands} it. "
        f"Velocity transmission factors {_factors(posture.factors)}.",
        joints,
        modes,
        "This machine is + + +: each carriage ahead of the platform. The same carriages could also "
        f"be assembled with the tool at {position_words((x, y, z))}.",
    )


def _factors(factors: FloatArray) -> str:
    return ", ".join(f"{factor:.3f}" for factor in factors)
