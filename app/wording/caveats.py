"""What a person must know before using the numbers of a result."""

from __future__ import annotations

import math

from app.solving import Alone, Solved, Suspect
from app.wording.tables import signed
from calib.noise import LEAST_NOISE_MM, Noise
from calib.solution import Direction, Solution, Subset

SUBSET_WORDS: dict[Subset, str] = {
    "joint-offsets": "joint offsets",
    "leg-lengths": "leg lengths",
    "both": "joint offsets and leg lengths",
    "with-tolerances": "both, held by the tolerances of the parts",
}

LACK_OF_FIT_LEVEL = 0.01


def caveats(solved: Solved) -> list[str]:
    """One line each, the gravest first."""
    solution = solved.solution
    factor = solution.coverage_factor
    return [
        *_lack_of_fit(solved),
        *_no_noise(solution.noise),
        *(_weak(direction, factor) for direction in solution.weak_directions),
        *_cures(solved),
        *_unequal_indicators(solution.noise),
        *(_suspect(suspect) for suspect in solved.suspects),
        *(_alone(alone) for alone in solved.alone),
        *_no_check(solution),
        *_recommended(solved),
    ]


def _lack_of_fit(solved: Solved) -> list[str]:
    fit = solved.solution.lack_of_fit
    if not fit or fit.p_value >= LACK_OF_FIT_LEVEL:
        return []
    larger = float(solved.solution.expanded_mm.max()) * solved.enlarged
    return [
        f"WARNING: what the model leaves is {math.sqrt(fit.statistic):.1f} times the noise: "
        "something is missing from the model (glidecal diagnose). Counted as noise it makes "
        "the uncertainty "
        f"±{larger:.3f} mm."
    ]


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
        f"±{direction.standard_uncertainty_mm * factor:.2f} mm"
    )
    if direction.against:
        name, uncertainty = direction.against
        said += f" ({name} to ±{uncertainty * factor:.3f})"
    return f"{said}; at the tool that is {direction.tool_mm * factor:.2f} mm."


def _cures(solved: Solved) -> list[str]:
    if not solved.solution.weak_directions:
        return []
    return ["What to measure against that: glidecal plan."]


def _unequal_indicators(noise: Noise) -> list[str]:
    if noise.pooled:
        return []
    shown = ", ".join(f"{math.sqrt(one.variance_mm2):.4f}" for one in noise.indicators)
    return [
        f"NOTE: the indicators scatter differently ({shown} mm); each is weighted by its own "
        "scatter. Look at the one that scatters most."
    ]


def _suspect(suspect: Suspect) -> str:
    r = suspect.reading
    return (
        f"SUSPECT: reading {r.reading} of {suspect.session} (leg {r.leg.upper()}, along "
        f"{r.axis.upper()}, at {r.displacement_mm:+g} mm, cycle {r.cycle}) is "
        f"{signed(suspect.studentised, 1)} standard deviations from its repeats. It counts; "
        "measure it again."
    )


def _alone(alone: Alone) -> str:
    first = alone.readings[0]
    numbers = ", ".join(str(reading.reading) for reading in alone.readings)
    return (
        f"LOST: reading {numbers} of {alone.session} (leg {first.leg.upper()}, along "
        f"{first.axis.upper()}, at {first.displacement_mm:+g} mm) has no other posture to its "
        "zero, so it says nothing. Between two breaks measure at least two postures."
    )


def _no_check(solution: Solution) -> list[str]:
    """A fit with nothing left over cannot be checked."""
    if solution.noise.source == "residuals" or solution.lack_of_fit is not None:
        return []
    return ["NOTE: no degree of freedom is left: whether the model fits cannot be told."]


def _recommended(solved: Solved) -> list[str]:
    choice = solved.choice
    if solved.solution.subset == choice.recommended:
        return [f"Recommended set: {choice.reasons[0]}."]
    return [f"RECOMMENDED instead: {SUBSET_WORDS[choice.recommended]}; {choice.reasons[0]}."]
