"""What a person must know before using the numbers of a result."""

from __future__ import annotations

import math

from app.evaluating.solution import (
    IsolatedReadings,
    NoisyChannel,
    SessionSolution,
    Suspect,
    indicator_figures,
)
from app.report.text.tables import decimals_for, signed, uncertain
from calib.design.identifiability import Direction
from calib.identify.solution import LACK_OF_FIT_LEVEL, Solution, Subset
from calib.noise.reading import LEAST_NOISE_MM, Noise
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
    "nobody stated the present HOME_OFFSET, 0 was assumed for every joint; state it in the "
    "machine file, or give --ini or --home-offset to glidecal export."
)

MOST_NAMED = 8
"""So many of a kind are named; nobody reads hundreds."""


def caveats(solved: SessionSolution) -> list[str]:
    """One line each, the gravest first."""
    solution = solved.solution
    factor = solution.coverage_factor
    return [
        *_lack_of_fit(solved),
        *_left_out(solved),
        *_useless(solved),
        *_no_noise(solution.noise),
        *(_weak(direction, factor) for direction in solution.weak_directions),
        *_cures(solved),
        *_unequal_indicators(solved),
        *_wander(solution.noise),
        *(_suspect(suspect) for suspect in solved.suspects[:MOST_NAMED]),
        *_more("SUSPECT", len(solved.suspects) - MOST_NAMED),
        *(_alone(alone) for alone in solved.alone[:MOST_NAMED]),
        *_more("LOST", len(solved.alone) - MOST_NAMED),
        *_equal_repeats(solved),
        *_in_place(solved),
        *_missing_legs(solved),
        *_no_check(solution),
        *_recommended(solved),
    ]


def _lack_of_fit(solved: SessionSolution) -> list[str]:
    fit = solved.solution.lack_of_fit
    if not fit or fit.p_value >= LACK_OF_FIT_LEVEL:
        return []
    larger = float(solved.solution.enlarged_expanded_mm.max())
    return [
        f"WARNING: what the model leaves is {math.sqrt(fit.statistic):.1f} times the noise: "
        "something is missing from the model (glidecal diagnose). Counted as noise it makes "
        f"the uncertainty ±{uncertain(larger)} mm (k = {solved.solution.left_over_factor:.3f}, "
        f"{fit.degrees_of_freedom:.3g} degrees of freedom)."
    ]


def _useless(solved: SessionSolution) -> list[str]:
    """Values that would leave as much as there is, for all that is known."""
    if solved.tool_after.rms_mm < solved.tool_before.rms_mm:
        return []
    return [
        "WARNING: entering these values is not expected to make the tool better: what they would "
        "leave is no smaller than what is there now."
    ]


def _left_out(solved: SessionSolution) -> list[str]:
    """Sets that the readings do not determine: what they would add is in no figure."""
    said = [
        f"LEFT OUT: {SUBSET_WORDS[subset]}: {problem.found}."
        for subset, problem in solved.choice.refused.items()
    ]
    if "both" in solved.choice.refused:
        held = solved.solution.subset == "with-tolerances"
        right = "the parts keep their tolerances" if held else "what is outside this set is right"
        said.append(
            f"All figures hold only if {right}: an error there can hide below the noise, and what "
            "it does at the tool cannot be told."
        )
    return said


def _no_noise(noise: Noise) -> list[str]:
    if noise.standard_deviation_mm >= LEAST_NOISE_MM:
        return []
    return [
        "WARNING: these readings show no noise; the uncertainties are those of arithmetic. "
        "State the resolution and repeatability of the indicators."
    ]


def _weak(direction: Direction, factor: float) -> str:
    said = (
        f"WEAK: {direction.combination} known only to "
        f"±{uncertain(direction.standard_uncertainty_mm * factor, 2)} mm"
    )
    if direction.against:
        name, uncertainty = direction.against
        said += f" ({name} to ±{uncertain(uncertainty * factor)})"
    return f"{said}; at the tool that is {uncertain(direction.tool_mm * factor, 2)} mm."


def _reads_tool(solved: SessionSolution) -> bool:
    return any(r.leg == "tool" for session in solved.sessions for r in session.readings)


def _cures(solved: SessionSolution) -> list[str]:
    if not solved.solution.weak_directions or _reads_tool(solved):
        return []
    return ["What to measure against that: glidecal plan."]


def _unequal_indicators(solved: SessionSolution) -> list[str]:
    if not solved.loud:
        return []
    quiet_mm = math.sqrt(solved.solution.noise.quiet_mm2)
    shown = "; ".join(map(_loud, solved.loud[:MOST_NAMED]))
    rest = len(solved.loud) - MOST_NAMED
    return [
        f"NOTE: the indicators scatter differently: {shown}{f'; {rest} more' if rest > 0 else ''}; "
        f"the others {uncertain(quiet_mm, 4)} mm. Each is weighted by its own scatter. Look at the "
        "one that scatters most."
    ]


def _wander(noise: Noise) -> list[str]:
    if noise.cycle_drift_mm is None:
        return []
    return [
        f"NOTE: the readings wander from cycle to cycle by {uncertain(noise.cycle_drift_mm)} mm "
        "r.m.s. "
        "That is not counted as noise, but what wanders within a cycle goes into the differences. "
        "Is the machine warm, is the stand firm? glidecal diagnose looks for drift."
    ]


def _loud(loud: NoisyChannel) -> str:
    r = loud.reading
    touched = f"leg {r.leg.upper()}" if r.leg != "tool" else "the tool"
    place = f"{touched} along {r.axis.upper()}, mounting {r.mount} of {loud.session}"
    found = loud.indicator
    where = place if found.mounting else f"indicator {found.number}"
    return f"{where} {uncertain(found.scatter_mm, 4)} mm"


def _more(kind: str, count: int) -> list[str]:
    return [f"{kind}: {count} more; --json names them all."] if count > 0 else []


def _suspect(suspect: Suspect) -> str:
    r = suspect.reading
    return (
        f"SUSPECT: reading {r.reading} of {suspect.session} ({_place(r)}, cycle {r.cycle}) is "
        f"{signed(suspect.studentised, 1)} standard deviations from its repeats. It counts; "
        "measure it again."
    )


def _place(r: Reading) -> str:
    if r.position_mm is not None:
        return f"the tool, along {r.axis.upper()}, at {position_words(r.position_mm)}"
    return f"leg {r.leg.upper()}, along {r.axis.upper()}, at {r.displacement_mm:+g} mm"


def _alone(alone: IsolatedReadings) -> str:
    first = alone.readings[0]
    numbers = ", ".join(str(reading.reading) for reading in alone.readings)
    return (
        f"LOST: reading {numbers} of {alone.session} ({_place(first)}) has no other posture to its "
        "zero, so it says nothing. Between two breaks measure at least two postures."
    )


def _equal_repeats(solved: SessionSolution) -> list[str]:
    """Repeats that agree to the last digit tell only that the noise is below the display's step."""
    noise = solved.solution.noise
    step_mm = indicator_figures(solved.sessions).step_mm
    if noise.repeated != "equal" or not step_mm:
        return []
    step = f"{step_mm:.{decimals_for(step_mm, 0) - 1}f} mm"
    return [
        f"NOTE: all repeats agree to the last digit, {step}. They do not show "
        "how much the readings scatter, and more of them would not make the result better."
    ]


def _in_place(solved: SessionSolution) -> list[str]:
    rest = solved.reading_count - solved.visit_count
    if not rest:
        return []
    return [
        f"NOTE: {rest} readings follow another one of their posture without a movement between. "
        "They share its error, so they are averaged with it and are no repeats."
    ]


def _missing_legs(solved: SessionSolution) -> list[str]:
    touched = {reading.leg for session in solved.sessions for reading in session.readings}
    missing = [leg.upper() for leg in LEG_NAMES if leg not in touched]
    if not missing or _reads_tool(solved):
        return []
    legs = f"leg {missing[0]} was" if len(missing) == 1 else f"legs {', '.join(missing)} were"
    return [
        f"NOTE: {legs} not touched. What is said there comes from readings on the other legs; with "
        "so few the model is hardly checked."
    ]


def _no_check(solution: Solution) -> list[str]:
    """A fit with nothing left over cannot be checked."""
    if solution.noise.source == "residuals":
        return [
            "NOTE: without repeats and without a stated indicator the noise is what the model "
            "leaves: whether the model fits cannot be told. Measure more cycles, or import with "
            "--resolution and --repeatability."
        ]
    if solution.lack_of_fit is not None:
        return []
    return ["NOTE: no degree of freedom is left: whether the model fits cannot be told."]


def _recommended(solved: SessionSolution) -> list[str]:
    choice = solved.choice
    same = solved.solution.subset == choice.recommended
    begin = "Recommended set" if same else "RECOMMENDED instead"
    errors = ", ".join(f"{name} {uncertain(mm)}" for name, mm in choice.tool_error_mm.items())
    said = f"{begin}: {SUBSET_WORDS[choice.recommended]}; expected tool error, mm: {errors}"
    if any(mm < choice.tool_error_mm[choice.recommended] for mm in choice.tool_error_mm.values()):
        said += f"; {choice.reasons[1]}"
    return [f"{said}."]
