"""Constants that decide have the values of the pages: a change of either shows here."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib import stats
from calib.design import identifiability
from calib.diagnosis import claims, gap, thresholds
from calib.noise import display, repeats, serial
from calib.posterior import (
    apart,
    cells,
    correction,
    first_takes,
    labels,
    library,
    problem,
    selection,
    statements,
    tool_errors,
)
from calib.posterior.posterior import CHANGED, CHANGES_MM, TYPED_IN
from calib.tripod.effects import empirical
from tests.conftest import ROOT


def page(name: str) -> str:
    """Without line breaks."""
    return " ".join((ROOT / "docs" / name).read_text(encoding="utf-8").split())


def row(name: str) -> str:
    """Of the table of constants, by what its first cell begins with."""
    text = (ROOT / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    (line,) = (line for line in text.splitlines() if line.startswith(f"| {name}"))
    return line.split("|")[2].strip()


def part(value: float) -> str:
    return f"{value:.2f}"


SORTS = library.SORTS
HARMONICS_IN_WORDS = {2: "two", 3: "three", 4: "four"}[empirical.HARMONICS]
CAUSES = selection.CAUSES
SCALES = [f"{scale:g}" for scale in selection.SCALES]
PRIORS = [f"{prior:g}" for prior in np.exp(selection.LOG_SCALES).round(12)]
STATED = [statement.prior for statement in statements.AS_STATED]
CASES = [f"{prior:g}" for prior in CAUSES]


@pytest.mark.parametrize(
    "words",
    [
        f"with the prior {', '.join(CASES[:-1])} or {CASES[-1]}; "
        f"each with a scale $g$ of {', '.join(SCALES[:-1])} or {SCALES[-1]}, "
        f"with the prior {', '.join(PRIORS[:-1])} or {PRIORS[-1]}.",
        f"all axes out of true at once | {library.SHARES['named']} |",
        f"effect beside the catalogue | {library.SHARES['beside']} |",
        f"{HARMONICS_IN_WORDS} harmonics of a searched period (one of {library.LEADS_APART}), ",
        f"product of two travels | {library.SHARES['nameless']} |",
        f"r.m.s. $g \\cdot {library.ELSE_UNIT_MM:g}$ mm, ",
        f"{1.0 - library.SIDED:g} of its square common to both approaches "
        f"| {library.SHARES[library.ELSE]} |",
        f"then as {part(SORTS['one'])} : {part(SORTS['same'])} : {part(SORTS['each'])} among",
        f"({problem.EVERYWHERE:g}\\,u)^2",
        f"with $h = {cells.HOMING_MM:g}$ mm",
        f"With a probability of {CHANGED:g} they changed nevertheless: "
        f"$h$ = {CHANGES_MM[0]:g} or {CHANGES_MM[1]:g} mm",
        f"$\\alpha \\sim N(0, \\max({selection.ADOPTED:g}u, z)^2)$",
        f"Distances of towers correlate by {cells.ALIKE:g}.",
        "Seven cases differ in what is free: all (prior {:g}); places, plate, bars ({:g}); "
        "places, bars alike ({:g}); places ({:g}); places, plate ({:g}); bars ({:g}); "
        "nothing ({:g}).".format(*STATED),
        f"What is not free is as stated, bars to {cells.STATED_MM:g} mm;",
        f"these have {1.0 - TYPED_IN:g} of the prior.",
        f"each round the plate by {cells.ROUND_GUESSED:g} times that.",
        f"the best {selection.PAIRS} pairs at all scales, "
        f"and every third component beside the {selection.TRIPLES_FROM} heaviest pairs. "
        f"Models below $10^{{{math.log10(selection.LIGHTEST):.0f}}}$ are dropped.",
        f"in less than $10^{{{math.log10(display.CHANCE):.0f}}}$",
        f"beyond {repeats.DISAGREES:g} typical deviations from its repeats it leaves mean and "
        f"noise; beyond {cells.USUAL:g} $\\sigma$ its weight is {cells.USUAL:g} $\\sigma$/distance",
        f"{len(serial.RHOS)} values from {serial.RHOS[0]:g} to {serial.RHOS[-1]:g}, half of the "
        f"prior on 0; below {serial.LEAST_RHO:g} it is 0",
        f"above {identifiability.UNSEEN:g} not seen; above {identifiability.WEAK:g}, or ten times",
        f"a penalty of $10^{{{math.log10(correction.TIED):.0f}}}$ of the mean square",
        f"by less than {correction.WORTH:.0%}".replace("%", " %")
        + f", tables by less than {correction.WORTH_A_TABLE:.0%}".replace("%", " %"),
        f"a model of weight {correction.DOUBTED:g} or more",
        f"the gain is less than {correction.LARGE:.0%}".replace("%", " %"),
        f"the root of the {tool_errors.KEPT:.1%} quantile".replace("%", " %"),
        f"with {tool_errors.UNPLACED_FREEDOM:g} degrees of freedom",
        f"readings that depart by {first_takes.APART:g} $\\sigma$ are tried with zeros of their "
        f"own, as within a play, with the prior {first_takes.WITHIN:g}.".capitalize(),
        f"its play, within ${first_takes.REACHES:g}u$,",
    ],
)
def test_the_theory_states_them(words: str) -> None:
    assert words in page("theory.md")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("`MISSING`", f"{thresholds.MISSING:g}"),
        ("`SURE`", f"{thresholds.SURE:g}; {thresholds.OPEN:g} of P(missing); {thresholds.EVEN:g}"),
        ("`UNSEEN`", f"{claims.UNSEEN:g} σ, all readings together"),
        ("`WITHIN`", f"{claims.WITHIN:g} tolerances"),
        ("`AGREEMENT`", f"{gap.AGREEMENT:g}; {stats.UNLIKELY:g}"),
        (
            "`LEAST_CHANGED`",
            f"{labels.LEAST_CHANGED:g} σ; {repeats.DISAGREES:g}, "
            f"slip {apart.LEAST['stand_slip']:g}, "
            f"first take {apart.LEAST['first_take']:g} σ of a reading",
        ),
        ("`KEPT`", f"{tool_errors.KEPT:g} of the posterior"),
    ],
)
def test_the_table_of_constants_has_them(name: str, values: str) -> None:
    assert row(name) == values
