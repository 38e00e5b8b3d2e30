"""What is claimed of the tool, of joint offsets and lengths, against the hidden machine itself.

``python -m tests.blind.claims -o docs/claims.md`` makes the page. An effect of strength 1 leaves
what is found nine times in ten beside zeros, joint offsets and lengths within their tolerance; none
is larger than a workshop would have it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from tests.blind import blunders
from tests.blind.cases import PROCEDURES, SHAPES, STRENGTHS, USUAL_NOISES, Case
from tests.blind.effects import EFFECT_IDS, Candidate
from tests.blind.forward import FloatArray, Hidden, Hypothesis, Rows, readings
from tests.blind.generator import (
    LENGTH_SPREAD_MM,
    ZERO_LIMIT_MM,
    changes_of,
    check_size,
    drawn_outside,
    drawn_place,
    scatter_mm,
    settings_of,
    table_text,
)
from tests.blind.noise import NOISES, draw
from tests.blind.nuisances import parameters_mm
from tests.blind.scoring import Rate, detection_ncp
from tests.blind.signatures import BASE, Columns
from tests.blind.steps import PLANS, rows_of
from tests.blind.tool import rms_mm, tool_errors_mm

TOLERANCE_MM = 0.1
"""Of lengths, as the prototype's machine file states it."""

OFFSET_LIMIT_MM = 2.0
KNOWN_NOISES = tuple(noise for noise in NOISES if noise != "wander")
"""A slow wander is an effect, not noise."""

TILTED = "axes tilted"
LEAN_LIMITS = (0.3e-3, 2e-3)
SHIFT_LIMITS_MM = (0.1, 0.8)

UNSEEN = 1e-6
"""Of an amount of 1 mm or 1 rad, in noise: it does not show."""
TRIES = 400


@dataclass(frozen=True)
class Claim:
    """One session: its table, the resolution of its indicators, and the machine behind it.

    ``rows``, ``values_mm`` and ``noise_mm`` are the readings before any gross mistake and their
    r.m.s. noise, ``effects`` what is hidden beside offsets and lengths.
    """

    table: str
    resolution_mm: float | None
    hidden: Hidden
    rows: Rows
    values_mm: FloatArray
    noise_mm: float
    effects: tuple[Candidate, ...]


def claim(case: Case, seed: int, length_spread_mm: float = LENGTH_SPREAD_MM) -> Claim:
    """The session of a case, ``strengths`` in units of detection. Raises ValueError.

    In the cell `TILTED` all three axes lean and are shifted, too.
    """
    rng = case.generator(seed)
    for _ in range(TRIES):
        try:
            return _attempt(case, rng, length_spread_mm)
        except ValueError:
            continue
    raise ValueError(f"case {case.key}: no session in {TRIES} draws")


def _attempt(case: Case, rng: np.random.Generator, length_spread_mm: float) -> Claim:
    rows = rows_of(PLANS[case.procedure], rng, homed=case.homed)
    sigma_mm = float(rng.uniform(0.0007, 0.0015) if case.noise == "quantised" else scatter_mm(rng))
    noise = draw(case.noise, rows, sigma_mm, rng)
    drawn = [*rng.uniform(-OFFSET_LIMIT_MM, OFFSET_LIMIT_MM, 3)]
    drawn += [*(length_spread_mm * rng.standard_normal(3))]
    plain = Hidden().plus([(e, float(v)) for e, v in zip(BASE, drawn, strict=True)])
    waves = tuple((float(rng.uniform(0.03, 0.09)), float(rng.uniform(0, 6.3))) for _ in range(3))
    hidden = Hidden(plain.amounts, 5.0, float(rng.uniform(17.0, 45.0)), waves)
    effects: list[Candidate] = []
    if case.cell == TILTED:
        tilts = _tilts(rng)
        effects.append(Candidate(TILTED, "all", tuple(((entry, 1.0),) for entry, _ in tilts)))
        hidden = hidden.plus(tilts)
    columns = Columns(rows, hidden)
    for effect, strength in zip(
        case.effects or (case.shape,) * bool(case.shape), case.strengths, strict=True
    ):
        candidate = (drawn_outside if effect in SHAPES else drawn_place)(effect, rng)
        raw = columns.raw(candidate)
        scale = np.sqrt((_held(columns, raw, noise.rms_mm) ** 2).sum(axis=0))
        weights = rng.standard_normal(len(scale)) / np.maximum(scale, 1e-9)
        if candidate.id in ("backlash", "gravity_sag"):
            weights = np.abs(weights)
        signal = _held(columns, raw @ weights, noise.rms_mm)
        weights *= strength * np.sqrt(detection_ncp(len(scale)) / float(signal @ signal))
        changes = changes_of(candidate.directions, weights, rng)
        check_size(changes)
        lead_mm = candidate.lead_mm if candidate.id == "actuator_cyclic" else hidden.lead_mm
        hidden = Hidden(hidden.plus(changes).amounts, lead_mm, *settings_of(hidden))
        effects.append(candidate)
    zeros = rng.uniform(-ZERO_LIMIT_MM, ZERO_LIMIT_MM, rows.mount.max() + 1)
    values = readings(rows, hidden) + zeros[rows.mount] + noise.values_mm
    table = blunders.Table(rows, values)
    if case.blunder:
        table = blunders.commit(case.blunder, table, noise.rms_mm, rng)[0]
    text, truth = table_text(table, noise.resolution_mm), (rows, values, noise.rms_mm)
    return Claim(text, noise.resolution_mm, hidden, *truth, tuple(effects))


def _tilts(rng: np.random.Generator) -> list[tuple[Hypothesis, float]]:
    """Leans and shifts of all three axes, each in a direction of its own."""
    changes: list[tuple[Hypothesis, float]] = []
    for name, (low, high) in (("lean", LEAN_LIMITS), ("shift", SHIFT_LIMITS_MM)):
        for axis in range(3):
            size, angle = rng.uniform(low, high), rng.uniform(0.0, 2.0 * np.pi)
            across = (size * np.cos(angle), size * np.sin(angle))
            sides = [side for side in range(3) if side != axis]
            changes += [((name, (axis, k)), float(v)) for k, v in zip(sides, across, strict=True)]
    return changes


def detection_sizes(columns: Columns, candidate: Candidate, noise_mm: float) -> FloatArray:
    """Standard deviation of each amount ``(r,)`` at strength 1; infinite where nothing shows."""
    scale = np.sqrt((_held(columns, columns.raw(candidate), noise_mm) ** 2).sum(axis=0))
    sizes = np.full(len(scale), np.sqrt(detection_ncp(len(scale)) / len(scale)))
    return np.where(scale > UNSEEN, sizes / np.maximum(scale, UNSEEN), np.inf)


def _held(columns: Columns, values: FloatArray, noise_mm: float) -> FloatArray:
    """``(n,)`` or ``(n, r)`` in noise, without zeros and offsets, lengths held: (I + B P Bᵀ)^-½."""
    free = np.linalg.qr(np.delete(columns.base, (3, 4, 5), axis=1))[0]
    bars = columns.base[:, 3:6] * (TOLERANCE_MM / noise_mm)
    vectors, size, _ = np.linalg.svd(bars - free @ (free.T @ bars), full_matrices=False)
    residual = (values - free @ (free.T @ values)) / noise_mm
    shrink = (1.0 / np.hypot(1.0, size) - 1.0)[:, None]
    inside = vectors.T @ residual
    return np.asarray(
        residual + vectors @ (shrink * inside if inside.ndim > 1 else shrink[:, 0] * inside)
    )


@dataclass(frozen=True)
class Scored:
    """One session: what was claimed, and what is true.

    ``off_u`` ``(6,)`` is how far joint offsets and lengths are off, in standard uncertainties.
    """

    case: Case
    spread_mm: float
    bound_mm: float
    true_mm: float
    off_u: FloatArray

    @property
    def holds(self) -> bool:
        """Whether the tool keeps the bound."""
        return self.true_mm <= self.bound_mm


def scored(case: Case, seed: int, folder: Path, spread_mm: float = LENGTH_SPREAD_MM) -> Scored:
    """Make the session, solve it as a user would, and look at the machine."""
    from app.commands.sessions import import_files
    from app.evaluating.solution import solve_files

    simulated = claim(case, seed, spread_mm)
    table, session = folder / f"{case.session}.csv", folder / f"{case.session}.jsonl"
    table.write_text(simulated.table, encoding="utf-8")
    with contextlib.redirect_stderr(io.StringIO()):
        import_files([table], session, machine=None, resolution=simulated.resolution_mm)
    result = solve_files([session])
    entered_mm = np.array(result.joint_offsets_mm)
    stated_mm, uncertainty_mm = parameters_mm(result.corrections.posterior)
    amounts = simulated.hidden.amounts
    true_mm = np.concatenate([amounts["offset"], amounts["length"]])
    return Scored(
        case,
        spread_mm,
        result.correction.off.bound_mm["machine"],
        rms_mm(tool_errors_mm(simulated.hidden, entered_mm, np.zeros(3))),
        (stated_mm - true_mm) / uncertainty_mm,
    )


SPREADS_MM = (0.0, 0.1, 0.3)
"""Standard deviations of hidden bars: none, one and three tolerances."""

COVERAGE = 2.0
"""Standard uncertainties of a stated interval (GUM, k = 2)."""


def effect_cases(
    count: int, shapes: Sequence[str] = ("cubic", "sawtooth", "product")
) -> Iterator[Case]:
    """Every procedure, effect and strength so many times."""
    for number, (n, procedure, effect, k) in enumerate(
        product(range(count), PROCEDURES, (*EFFECT_IDS, *shapes), STRENGTHS)
    ):
        noise, key = USUAL_NOISES[number % len(USUAL_NOISES)], f"claim/{procedure}/{effect}/{k}/{n}"
        if effect in SHAPES:
            yield Case(key, "claim", procedure, noise, (), (k,), shape=effect)
        else:
            yield Case(key, "claim", procedure, noise, (effect,), (k,))


def plain_cases(count: int) -> Iterator[Case]:
    """Nothing hidden: every noise and procedure so many times."""
    for n, noise, procedure in product(range(count), KNOWN_NOISES, PROCEDURES):
        yield Case(f"claim/none/{noise}/{procedure}/{n}", "none", procedure, noise)


def page(hidden: Sequence[Scored], plain: Sequence[Scored], seed: int) -> str:
    """The two tables."""
    lines = [
        "# What is claimed, against hidden machines",
        "",
        f"Made by `python -m tests.blind.claims` (seed {seed}). Strength 1 is what is found nine "
        "times in ten; joint offsets up to 2 mm, bars off by 0.03 and 0.1 mm. The tool's true "
        "error is its r.m.s. distance over the reachable workspace in the machine's own frame, "
        "with the joint offsets of the correction entered (touched off).",
        "",
        "| hidden | sessions | true ≤ bound (95 % bounds) | bound / true, median |",
        "|---|---|---|---|",
    ]
    groups = [("every effect", hidden)]
    groups += [(f"strength {k:g}", [o for o in hidden if k in o.case.strengths]) for k in STRENGTHS]
    groups += [(p, [o for o in hidden if o.case.procedure == p]) for p in PROCEDURES]
    names = dict.fromkeys((*o.case.effects, o.case.shape)[0] for o in hidden)
    groups += [(e, [o for o in hidden if e in (*o.case.effects, o.case.shape)]) for e in names]
    groups += [("nothing", plain)]
    lines += [tool_row(title, outcomes) for title, outcomes in groups]
    return "\n".join([*lines, "", *intervals_table(plain), ""])


def tool_row(title: str, outcomes: Sequence[Scored]) -> str:
    """How often the tool keeps its bound, and how wide that is."""
    rate = Rate(sum(o.holds for o in outcomes), len(outcomes))
    low, high = rate.bounds
    ratio = float(np.median([o.bound_mm / o.true_mm for o in outcomes]))
    return (
        f"| {title} | {len(outcomes)} | {rate.share:.1%} ({low:.0%} … {high:.0%}) | {ratio:.1f} |"
    )


def intervals_table(plain: Sequence[Scored]) -> list[str]:
    """How often intervals of joint offsets and lengths hold the truth."""
    groups = [(f"noise {n}", [o for o in plain if o.case.noise == n]) for n in KNOWN_NOISES]
    groups += [
        (
            f"bars off by {spread / TOLERANCE_MM:g} tolerances",
            [o for o in plain if o.spread_mm == spread],
        )
        for spread in SPREADS_MM
    ]
    lines = [
        "Nothing else hidden, tolerance of the bars 0.1 mm: share of the intervals of two standard "
        "uncertainties that contain the truth.",
        "",
        "| sessions of | sessions | joint offsets | lengths |",
        "|---|---|---|---|",
    ]
    for title, outcomes in groups:
        within_bound = np.abs([o.off_u for o in outcomes]) <= COVERAGE
        offsets, lengths = (
            f"{part.mean():.1%}" for part in (within_bound[:, :3], within_bound[:, 3:])
        )
        lines.append(f"| {title} | {len(outcomes)} | {offsets} | {lengths} |")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry of ``python -m tests.blind.claims``."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.claims", description=__doc__)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--count", type=int, default=2, help="sessions of each combination")
    parser.add_argument("--every", type=int, default=1, help="only every so many of the effects")
    parser.add_argument("-o", "--output", type=Path, help="the page; else printed")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        hidden = [
            scored(case, options.seed, folder, (LENGTH_SPREAD_MM, TOLERANCE_MM)[k % 2])
            for k, case in enumerate([*effect_cases(options.count)][:: options.every])
        ]
        plain = [
            scored(Case(f"{case.key}/{spread}", *case_fields(case)), options.seed, folder, spread)
            for spread in SPREADS_MM
            for case in plain_cases(3 * options.count)
        ]
    text = page(hidden, plain, options.seed)
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0


def case_fields(case: Case) -> tuple[str, str, str]:
    """Cell, procedure and noise."""
    return case.cell, case.procedure, case.noise


if __name__ == "__main__":
    sys.exit(main())
