"""What a person must know before using the numbers of a result."""

from __future__ import annotations

import math
from collections.abc import Iterator

from app.evaluating.solution import NoisyChannel, SessionSolution, indicator_figures
from app.report.text.tables import decimals_for, signed, uncertain
from calib.design.identifiability import Direction
from calib.identify.solution import Subset
from calib.noise.reading import LEAST_NOISE_MM
from calib.observations import LEG_NAMES
from protocols.events import Reading
from protocols.procedure import position_words

SUBSET_WORDS: dict[Subset, str] = {
    "joint-offsets": "joint offsets",
    "leg-lengths": "leg lengths",
    "both": "joint offsets and leg lengths",
    "with-tolerances": "both, held by the tolerances of the parts",
}

UNKNOWN_HOME_OFFSET = (
    "nobody stated the present HOME_OFFSET, so the files hold no value to enter, only what to add "
    "to the present one; give --ini or --home-offset, or state it in the machine file."
)

MOST_NAMED = 8
"""So many of a kind are named; nobody reads hundreds."""


def caveats(solved: SessionSolution) -> list[str]:
    """One line each, the gravest first."""
    return [
        *_of_the_model(solved),
        *_of_the_fit(solved),
        *_of_noise(solved),
        *_of_readings(solved),
        *_of_the_measurement(solved),
        *_of_the_choice(solved),
    ]


def _of_the_model(solved: SessionSolution) -> Iterator[str]:
    if solved.ambiguous:
        from protocols.model_file import ambiguity  # with a model only

        yield f"WARNING: {ambiguity(solved.ambiguous)}"


def _of_the_fit(solved: SessionSolution) -> Iterator[str]:
    """What the model leaves, sets that the readings do not determine, values of no use."""
    solution, refused = solved.solution, solved.choice.refused
    fit = solution.lack_of_fit
    if fit and solution.lacks_fit:
        larger = float(solution.enlarged_expanded_mm.max())
        yield (
            f"WARNING: what the model leaves is {math.sqrt(fit.statistic):.1f} times the noise: "
            "something is missing from the model (glidecal diagnose). Counted as noise it makes "
            f"the uncertainty ±{uncertain(larger)} mm (k = {solution.left_over_factor:.3f}, "
            f"{fit.degrees_of_freedom:.3g} degrees of freedom)."
        )
    for subset, problem in refused.items():
        yield f"LEFT OUT: {SUBSET_WORDS[subset]}: {problem.found}."
    if "both" in refused:
        constrained = solution.subset == "with-tolerances"
        right = (
            "the parts keep their tolerances"
            if constrained
            else "what is outside this set is right"
        )
        yield (
            f"All figures hold only if {right}: an error there can hide below the noise, and what "
            "it does at the tool cannot be told."
        )
    if not solved.tool_after.rms_mm < solved.tool_before.rms_mm:
        yield (
            "WARNING: entering these values is not expected to make the tool better: what they "
            "would leave is no smaller than what is there now."
        )


def _of_noise(solved: SessionSolution) -> Iterator[str]:
    """No noise at all, combinations that it hides, indicators with more of it, drift."""
    solution, noise = solved.solution, solved.solution.noise
    if noise.standard_deviation_mm < LEAST_NOISE_MM:
        yield (
            "WARNING: these readings show no noise; the uncertainties are those of arithmetic. "
            "State the resolution and repeatability of the indicators."
        )
    for direction in solution.weak_directions:
        yield _weak(direction, solution.coverage_factor)
    reads_tool = any(r.leg == "tool" for session in solved.sessions for r in session.readings)
    if solution.weak_directions and not reads_tool:
        yield "What to measure against that: glidecal plan."
    if solved.noisy:
        shown = "; ".join(map(_noisy, solved.noisy[:MOST_NAMED]))
        rest = len(solved.noisy) - MOST_NAMED
        yield (
            f"NOTE: the indicators scatter differently: {shown}"
            f"{f'; {rest} more' if rest > 0 else ''}; the others "
            f"{uncertain(math.sqrt(noise.quiet_mm2), 4)} mm. Each is weighted by its own scatter. "
            "Look at the one that scatters most."
        )
    if noise.cycle_drift_mm is not None:
        yield (
            "NOTE: the readings drift from cycle to cycle by "
            f"{uncertain(noise.cycle_drift_mm)} mm r.m.s. That is not counted as noise, but what "
            "wanders within a cycle goes into the differences. Is the machine warm, is the stand "
            "firm? glidecal diagnose looks for drift."
        )


def _weak(direction: Direction, factor: float) -> str:
    said = (
        f"WEAK: {direction.combination} known only to "
        f"±{uncertain(direction.standard_uncertainty_mm * factor, 2)} mm"
    )
    if direction.against:
        name, uncertainty = direction.against
        said += f" ({name} to ±{uncertain(uncertainty * factor)})"
    return f"{said}; at the tool that is {uncertain(direction.tool_mm * factor, 2)} mm."


def _noisy(channel: NoisyChannel) -> str:
    r, found = channel.reading, channel.indicator
    touched = f"leg {r.leg.upper()}" if r.leg != "tool" else "the tool"
    place = f"{touched} along {r.axis.upper()}, mounting {r.mount} of {channel.session}"
    where = place if found.mounting else f"indicator {found.number}"
    return f"{where} {uncertain(found.scatter_mm, 4)} mm"


def _of_readings(solved: SessionSolution) -> Iterator[str]:
    """Readings that do not fit their repeats, and those without another posture."""
    for suspect in solved.suspects[:MOST_NAMED]:
        r = suspect.reading
        yield (
            f"SUSPECT: reading {r.reading} of {suspect.session} ({_place(r)}, cycle {r.cycle}) is "
            f"{signed(suspect.studentised, 1)} standard deviations from its repeats. It counts; "
            "measure it again."
        )
    yield from _more("SUSPECT", len(solved.suspects) - MOST_NAMED)
    for one in solved.isolated[:MOST_NAMED]:
        numbers = ", ".join(str(reading.reading) for reading in one.readings)
        yield (
            f"LOST: reading {numbers} of {one.session} ({_place(one.readings[0])}) has no "
            "other posture to its zero, so it says nothing. Between two breaks measure at least "
            "two postures."
        )
    yield from _more("LOST", len(solved.isolated) - MOST_NAMED)


def _more(kind: str, count: int) -> list[str]:
    return [f"{kind}: {count} more; --json names them all."] if count > 0 else []


def _place(r: Reading) -> str:
    if r.position_mm is not None:
        return f"the tool, along {r.axis.upper()}, at {position_words(r.position_mm)}"
    return f"leg {r.leg.upper()}, along {r.axis.upper()}, at {r.displacement_mm:+g} mm"


def _of_the_measurement(solved: SessionSolution) -> Iterator[str]:
    """Repeats that show no scatter, readings without a movement between, legs not touched."""
    # repeats that agree to the last digit tell only that the noise is below the display's step
    step_mm = indicator_figures(solved.sessions).step_mm
    if solved.solution.noise.repeated == "equal" and step_mm:
        yield (
            f"NOTE: all repeats agree to the last digit, "
            f"{step_mm:.{decimals_for(step_mm, 0) - 1}f} mm. They do not show how much the "
            "readings scatter, and more of them would not make the result better."
        )
    in_place = solved.reading_count - solved.visit_count
    if in_place:
        yield (
            f"NOTE: {in_place} readings follow another one of their posture without a movement "
            "between. They share its error, so they are averaged with it and are no repeats."
        )
    touched = {reading.leg for session in solved.sessions for reading in session.readings}
    missing = [leg.upper() for leg in LEG_NAMES if leg not in touched]
    if missing and "tool" not in touched:
        legs = f"leg {missing[0]} was" if len(missing) == 1 else f"legs {', '.join(missing)} were"
        yield (
            f"NOTE: {legs} not touched. What is said there comes from readings on the other legs; "
            "with so few the model is hardly checked."
        )


def _of_the_choice(solved: SessionSolution) -> Iterator[str]:
    """A fit without residuals cannot be checked; which set of parameters is recommended."""
    solution, choice = solved.solution, solved.choice
    if solution.noise.source == "residuals":
        yield (
            "NOTE: without repeats and without a stated indicator the noise is what the model "
            "leaves: whether the model fits cannot be told. Measure more cycles, or import with "
            "--resolution and --repeatability."
        )
    elif solution.lack_of_fit is None:
        yield "NOTE: no degree of freedom is left: whether the model fits cannot be told."
    same = solution.subset == choice.recommended
    begin = "Recommended set" if same else "RECOMMENDED instead"
    errors = ", ".join(f"{name} {uncertain(mm)}" for name, mm in choice.tool_error_mm.items())
    said = f"{begin}: {SUBSET_WORDS[choice.recommended]}; expected tool error, mm: {errors}"
    if any(mm < choice.tool_error_mm[choice.recommended] for mm in choice.tool_error_mm.values()):
        said += f"; {choice.reasons[1]}"
    yield f"{said}."
