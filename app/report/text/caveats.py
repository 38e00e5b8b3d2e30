"""What a person must know before using the numbers of a result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from app.evaluating.correction import ControllerCorrections
from app.evaluating.solution import NoisyChannel, SessionSolution
from app.report.text.correction import FRAME_WORDS, SUBSET_WORDS
from app.report.text.tables import free_words, signed, uncertain
from calib.arrays import LEG_NAMES
from calib.noise.reading import LEAST_NOISE_MM, Repeated
from protocols.observations import indicator_figures
from protocols.procedure import position_words
from protocols.session import Reading

UNKNOWN_HOME_OFFSET = (
    "the present HOME_OFFSET is not stated: the files contain only what to add to it. State it "
    "in the machine file, or by glidecal export --ini or --home-offset."
)

MOST_NAMED = 8
"""So many of a kind are named; nobody reads hundreds."""


def caveats(result: SessionSolution) -> list[str]:
    """What to know of the readings and the model, one line each, the gravest first."""
    lines = []
    if result.ambiguous:
        from protocols.model_file import ambiguity  # with a model only

        lines.append(f"WARNING: {ambiguity(result.ambiguous)}")
    if result.held:
        lines.append(f"Held as a person stated it, not fitted: {'; '.join(result.held)}.")
    lines += changed_lines(result.corrections, result.names)
    for part in (_of_noise, _of_readings, _of_the_measurement):
        lines += part(result)
    return lines


def changed_lines(corrections: ControllerCorrections, names: Sequence[str]) -> list[str]:
    """Joint offsets that changed between sessions for no reason that their files state."""
    return [
        f"WARNING: the offset of joint {change.joint} changed by {signed(change.change_mm)} mm "
        f"from {names[change.session - 1]} to {names[change.session]}, and the files state no "
        f"reason: a switch that was moved, values that were entered? Values are those of "
        f"{names[-1]}."
        for change in corrections.offset_changes
    ]


def caveats_of_view(result: SessionSolution) -> list[str]:
    """What to know of the set of parameters that is shown, one line each, the gravest first."""
    if result.view_solution is None:
        return []
    return [*_of_the_fit(result), *_of_weak_directions(result), *_of_residuals(result)]


def _of_the_fit(result: SessionSolution) -> Iterator[str]:
    """What the model leaves, and sets that the readings do not determine."""
    solution, refused = result.solution, result.choice.refused
    fit = solution.lack_of_fit
    if fit and solution.lacks_fit and result.is_part_of_the_model:
        yield (
            f"Identified parameters alone leave {math.sqrt(fit.statistic):.1f} times the noise. "
            "With the lines of the drives, for which the values to enter allow, nothing is missing."
        )
    elif fit and solution.lacks_fit:
        larger = float(solution.inflated_expanded_mm.max())
        yield (
            f"WARNING: the residual is {math.sqrt(fit.statistic):.1f} times the noise: the "
            "identified parameters alone do not explain the readings (glidecal diagnose). With the "
            f"residual as noise their uncertainty is ±{uncertain(larger)} mm "
            f"(k = {solution.lack_of_fit_factor:.3f}, {free_words(fit.degrees_of_freedom)})."
        )
    for subset, problem in refused.items():
        yield f"LEFT OUT: {SUBSET_WORDS[subset]}: {problem.found}."
    if "both" in refused:
        yield (
            "Identified parameters are valid within ± U only if parts are within their tolerances: "
            "these readings show neither a larger error nor what it does at the tool."
        )
    if solution.beyond_tolerance and not result.is_part_of_the_model:
        parts_beyond = ", ".join(
            f"{name} {signed(value, 2)} mm (tolerance {within:g})"
            for name, value, within in solution.beyond_tolerance
        )
        yield (
            f"WARNING: far beyond the tolerance that the machine file states: {parts_beyond}. "
            "Either the "
            "tolerance is wrong, or these values stand for something that is missing from the "
            "model (glidecal diagnose)."
        )


def taken_word(result: SessionSolution) -> str:
    """One thing that was measured."""
    return "contact" if result.of_contacts else "reading"


def gauge_word(result: SessionSolution) -> str:
    """What measured it."""
    return "probe" if result.of_contacts else "indicator"


def _of_noise(result: SessionSolution) -> Iterator[str]:
    """No noise at all, indicators with more of it, drift."""
    noise = result.noise
    if noise.standard_deviation_mm < LEAST_NOISE_MM:
        yield (
            f"WARNING: these {taken_word(result)}s show no noise, so the uncertainties are only "
            f"rounding. State the resolution and repeatability of the {gauge_word(result)}s."
        )
    if result.noisy:
        noisy_words = "; ".join(map(_noisy, result.noisy[:MOST_NAMED]))
        remaining = len(result.noisy) - MOST_NAMED
        yield (
            f"NOTE: the {gauge_word(result)}s scatter differently: {noisy_words}"
            f"{f'; {remaining} more' if remaining > 0 else ''}; the others "
            f"{uncertain(math.sqrt(result.noise_of_each.quiet_mm2), 4)} mm. Each is weighted by "
            "its own scatter. Check the one that scatters most."
        )
    if noise.cycle_drift_mm is not None:
        yield (
            f"NOTE: the {taken_word(result)}s drift from cycle to cycle by "
            f"{uncertain(noise.cycle_drift_mm)} mm r.m.s. This is not part of the noise, but drift "
            "within a cycle is part of the differences. Is the machine warm? Is the "
            f"{'probe' if result.of_contacts else 'stand'} firm? "
            "glidecal diagnose looks for drift."
        )


CLEARLY_BETTER = 0.5
"""Of what a combination is known to: an opposite one that is known as poorly says nothing."""

NOTHING_MM = 0.0001
"""At the tool: less is not worth its digits."""


def _of_weak_directions(result: SessionSolution) -> Iterator[str]:
    """Combinations of parameters that the noise hides."""
    solution = result.solution
    factor = solution.coverage_factor
    for direction in solution.weak_directions:
        half_mm, tool_mm = direction.standard_uncertainty_mm * factor, direction.tool_mm * factor
        against = ""
        if direction.against:
            name, uncertainty = direction.against
            if uncertainty * factor < CLEARLY_BETTER * half_mm:
                against = f" ({name} to ±{uncertain(uncertainty * factor)})"
        at_tool = f"{uncertain(tool_mm, 2)}" if tool_mm >= NOTHING_MM else f"below {NOTHING_MM}"
        yield (
            f"WEAK: {direction.combination} known only to ±{uncertain(half_mm, 2)} mm{against}; at "
            f"the tool, {FRAME_WORDS['machine']}, that is {at_tool} mm."
        )
    if solution.weak_directions and not result.reads_tool:
        yield "What to measure to improve this: glidecal plan."


def _noisy(channel: NoisyChannel) -> str:
    r, indicator = channel.reading, channel.indicator
    touched = f"leg {r.leg.upper()}" if r.leg != "tool" else "the tool"
    place = f"{touched} along {r.axis.upper()}, set-up {r.mount} of {channel.session}"
    where = place if indicator.mounting else f"indicator {indicator.number}"
    return f"{where} {uncertain(indicator.scatter_mm, 4)} mm"


def _of_readings(result: SessionSolution) -> Iterator[str]:
    """Readings that do not fit their repeats, that lack another posture, or that never change."""
    for suspect in result.suspects[:MOST_NAMED]:
        r = suspect.reading
        yield (
            f"SUSPECT: {taken_word(result)} {r.reading} of {suspect.session} ({_place(r)}, "
            f"cycle {r.cycle}) is {signed(suspect.studentised, 1)} standard deviations from its "
            "repeats. It is used. Measure it again."
        )
    yield from _more("SUSPECT", len(result.suspects) - MOST_NAMED)
    for isolated in result.isolated[:MOST_NAMED]:
        numbers = ", ".join(str(reading.reading) for reading in isolated.readings)
        yield (
            f"NOT USED: {taken_word(result)} {numbers} of {isolated.session} "
            f"({_place(isolated.readings[0])}) is alone with its zero: without a second posture it "
            "gives no difference. Measure at least two postures between two breaks."
        )
    yield from _more("NOT USED", len(result.isolated) - MOST_NAMED)
    for session, reading, count in result.still[:MOST_NAMED]:
        yield (
            f"STILL: all {count} readings of leg {reading.leg.upper()} along "
            f"{reading.axis.upper()} in set-up {reading.mount} of {session} are "
            f"{signed(reading.value_mm, 4)} mm, wherever the machine was. Does the plunger touch "
            "the leg? Is the display on hold?"
        )
    yield from _more("STILL", len(result.still) - MOST_NAMED)


def _more(kind: str, count: int) -> list[str]:
    return [f"{kind}: {count} more; --json names them all."] if count > 0 else []


def _place(r: Reading) -> str:
    if r.position_mm is not None:
        return f"the tool, along {r.axis.upper()}, at {position_words(r.position_mm)}"
    return f"leg {r.leg.upper()}, along {r.axis.upper()}, at {r.displacement_mm:+g} mm"


def _of_the_measurement(result: SessionSolution) -> Iterator[str]:
    """Repeats that show no scatter, readings without a movement between, legs not touched."""
    # such repeats tell only that the noise is below the display's step
    step_mm = indicator_figures(result.sessions).display_mm
    if result.noise.repeated == "equal" and step_mm:
        yield (
            f"NOTE: all repeats agree within a step of the display, {step_mm:g} mm. They do not "
            f"show how much the {taken_word(result)}s scatter, and more of them would not make the "
            "result better."
        )
    in_place = len(result.observations) - len(result.visits)
    if in_place:
        yield (
            f"NOTE: {in_place} readings were taken without leaving the posture. They have the "
            "error of the reading before, so they are averaged with it and not used as repeats."
        )
    touched = {reading.leg for session in result.sessions for reading in session.readings}
    missing = [leg.upper() for leg in LEG_NAMES if leg not in touched]
    if missing and "tool" not in touched:
        legs = f"leg {missing[0]} was" if len(missing) == 1 else f"legs {', '.join(missing)} were"
        yield (
            f"NOTE: {legs} not measured. The values come from readings on the other legs, too few "
            "to check the model well."
        )


REPEATS_WORDS: dict[Repeated, str] = {
    "nothing": "there are no repeats",
    "equal": "all repeats read the same",
    "rounding": "repeats scatter by less than rounding",
    "scatter": "repeats are not used",
}


def _of_residuals(result: SessionSolution) -> Iterator[str]:
    """A fit without residuals cannot be checked."""
    solution = result.solution
    if solution.noise.source == "residuals":
        alternative = "" if solution.noise.repeated == "equal" else "measure more cycles, or "
        yield (
            f"NOTE: {REPEATS_WORDS[solution.noise.repeated]}, and there are no stated figures of "
            f"the {gauge_word(result)}, so the residual is taken as noise and cannot show whether "
            f"the model fits: {alternative}import with --resolution and --repeatability."
        )
    elif solution.lack_of_fit is None:
        yield "NOTE: no degree of freedom is left, so the fit of the model cannot be checked."
