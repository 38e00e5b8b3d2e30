"""Where the gap lies, cell by cell and by patterns, and how large it is on readings not seen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.arrays import (
    EXACT_BLIND,
    LEG_NAMES,
    TOOL,
    TOUCHED_NAMES,
    FloatArray,
    IntArray,
    descending,
    incidence,
    lengths,
    numbered,
    onto,
)
from calib.diagnosis.problem import FittedSession, Problem, Whitening
from calib.diagnosis.results import Cell, CellResiduals, GapPart, HeldOutGap
from calib.diagnosis.selection import KNOWN, CandidateSearch, Spread, heaviest_first
from calib.errors import NotIdentifiable
from calib.tripod.effects.effect import EffectInstance


def locate(problem: Problem) -> tuple[GapPart, ...]:
    """Share of the gap in each part of the readings, with its chance under pure noise.

    The gap is the structure that the model leaves (cells and cycles). A part of the readings holds
    as much of it as the squares there; patterns hold what they explain.
    """
    explained = onto(problem.structure, problem.y)
    if not problem.structure_df:
        explained = np.zeros_like(explained)  # nothing is left but rounding
    total = float((explained**2).sum())
    shares = []
    for leg, axis, pattern, mask in _parts(problem):
        if not mask.any():
            continue
        inside = float((explained[mask] ** 2).sum())
        taken = (problem.whitening.free[mask] ** 2).sum()
        own = float((problem.structure[mask] ** 2).sum() - taken)
        chance = problem.gap_p_value(inside, max(round(own), 1))
        shares.append(GapPart(leg, axis, pattern, inside / total if total else 0.0, chance))
    mounts = incidence(problem.mount)
    for pattern, columns in _patterns(problem):
        each = (mounts[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)
        inside, freedom = problem.explained_by(each)
        chance = problem.gap_p_value(inside, freedom)
        shares.append(GapPart("", "", pattern, min(inside / total, 1.0) if total else 0.0, chance))
    return tuple(descending(descending(shares, lambda s: s.share), lambda s: -s.p_value))


def _parts(problem: Problem) -> Iterator[tuple[str, str, str, NDArray[np.bool_]]]:
    leg, axis = problem.conditions("leg"), problem.conditions("axis")
    for k, name in enumerate(LEG_NAMES):
        yield name, "", "leg", leg == k
        yield "", name, "axis", axis == k
    for i, leg_name in zip((0, 1, 2, TOOL), TOUCHED_NAMES, strict=True):
        for j, axis_name in enumerate(LEG_NAMES):
            yield leg_name, axis_name, "mounting", (leg == i) & (axis == j)


def _patterns(problem: Problem) -> Iterator[tuple[str, FloatArray]]:
    """What may differ within a mounting, as columns ``(n, k)``."""
    position = problem.conditions("position_mm") / 100.0
    if position.any():
        first, second = np.triu_indices(3)
        yield "in proportion to the position", position
        yield "with the square of the position", position[:, first] * position[:, second]
        yield "direction of approach", problem.conditions("movement")
    else:
        displacement = problem.conditions("displacement_mm")[:, None] / 100.0
        yield "odd in displacement", np.hstack([displacement, displacement**3])
        yield "even in displacement", np.hstack([displacement**2, displacement**4])
        yield "direction of approach", problem.conditions("approach")[:, None]
    time, temperature = problem.conditions("time_s"), problem.conditions("temperature_c")
    if np.isfinite(time).all() and np.ptp(time) > 0.0:
        yield "time", (time / np.ptp(time))[:, None]
    if np.isfinite(temperature).all() and np.ptp(temperature) > 0.0:
        yield "temperature", temperature[:, None]


def where_words(shares: tuple[GapPart, ...], level: float) -> str:
    """A short sentence on where the gap is: the least likely parts by name."""
    significant = [s for s in shares if s.p_value < level]
    patterns = [s for s in significant if not s.leg and not s.axis]
    legs = [s for s in significant if s.pattern == "leg"]
    if not significant:
        return "no place stands out"
    parts = []
    if legs:
        some = "leg " + " and ".join(s.leg for s in legs)
        parts.append(f"on {some if len(legs) < 3 else 'all legs'}")
    if patterns:
        strongest = descending(patterns, lambda s: s.share)[0]
        how = strongest.pattern
        how = how if how.startswith(("odd", "even", "in ", "with")) else f"with the {how}"
        parts.append(f"{strongest.share:.0%} of it {how}")
    return ", ".join(parts) or f"most on {significant[0].leg}{significant[0].axis}"


def residuals(problem: Problem, after: FloatArray | None) -> CellResiduals:
    """Means of each cell; ``after`` ``(n,)`` is the whitened residual with effects adopted."""
    names = ("leg", "axis", "station", "displacement_mm", "approach")
    columns = [*map(problem.conditions, names), *problem.conditions("position_mm").T]
    keys = [column.astype(np.float64).round(4) for column in columns]
    cell = numbered(*keys)
    first, count = np.unique(cell, return_index=True)[1], np.bincount(cell)
    before = np.bincount(cell, problem.mm(problem.y)) / count
    later = None if after is None else np.bincount(cell, problem.mm(after)) / count
    noise = np.sqrt(np.bincount(cell, problem.root_weight**-2.0)) / count
    each = zip(
        np.column_stack(keys)[first].tolist(),
        before.tolist(),
        [None] * len(first) if later is None else later.tolist(),
        noise.tolist(),
        strict=True,
    )
    cells = tuple(
        Cell(
            leg=TOUCHED_NAMES[int(place[0])],
            axis=LEG_NAMES[int(place[1])],
            station=place[2],
            displacement_mm=place[3],
            approach=int(place[4]),
            before_mm=before_mm,
            after_mm=after_mm,
            noise_mm=noise_mm,
            position_mm=tuple(place[5:]) if place[0] == TOOL else None,
        )
        for place, before_mm, after_mm, noise_mm in each
    )
    return CellResiduals(cells, _rms(before), None if later is None else _rms(later), _rms(noise))


def _rms(values_mm: FloatArray) -> float:
    return float(np.sqrt(np.mean(values_mm**2)))


def left_out_postures(
    problem: Problem,
    columns: Sequence[FloatArray],
    size: int,
    groups: Sequence[IntArray] = (),
) -> HeldOutGap | None:
    """Leave out one side of one leg at a time; choose anew, fit, predict what was left out.

    ``columns`` are those of every candidate ``(n, r)`` in mm, ``size`` the number of effects to
    choose in each fold. Zeros come from the rest of each mounting, base parameters are held by
    their tolerances. ``groups`` are other rows to leave out together. None where nothing can be.
    """
    base = np.hstack([problem.zeros, problem.offsets, problem.bars])
    white = [problem.root_weight[:, None] * c for c in columns]
    squares, used = [0.0, 0.0], 0
    for rows in groups or _groups(problem):
        train = np.setdiff1d(np.arange(len(problem.y)), rows)
        chosen = _chosen(problem, white, train, size)
        designs = base, np.hstack([base, *(white[k] for k in chosen)])
        for k, design in enumerate(designs):
            value = _prior_constrained(problem, design, train)
            missed = (problem.residual[rows] - design[rows] @ value) / problem.root_weight[rows]
            squares[k] += float((missed**2).sum())
        used += len(rows)
    if not used:
        return None
    return HeldOutGap(
        "one side of one leg left out at a time, the choice made again each time",
        math.sqrt(squares[0] / used),
        math.sqrt(squares[1] / used),
        problem.noise_mm,
    )


def _groups(problem: Problem) -> Iterator[IntArray]:
    """Rows of one leg on one side of Zero, in all sessions; of the tool along each coordinate."""
    leg, displacement = problem.conditions("leg"), problem.conditions("displacement_mm")
    places = [(k, displacement) for k in range(len(LEG_NAMES))]
    places += [(TOOL, coordinate) for coordinate in problem.conditions("position_mm").T]
    for k, coordinate in places:
        for side in (1.0, -1.0):
            rows = np.flatnonzero((leg == k) & (np.sign(coordinate) == side))
            if len(rows) and len(rows) < (leg == k).sum():
                yield rows


def _chosen(
    problem: Problem,
    white: Sequence[FloatArray],
    train: IntArray,
    size: int,
) -> tuple[int, ...]:
    """The best model of this size on these rows alone."""
    base = problem.zeros, problem.offsets, problem.bars
    whitening = Whitening.of(*(columns[train] for columns in base))
    rest = whitening(problem.residual[train])
    spread = KNOWN
    if math.isfinite(problem.noise_df):
        spread = Spread(float(rest @ rest), float(len(train) - whitening.free.shape[1]))
    blocks = whitening.blocks([column[train] for column in white])
    search = CandidateSearch(rest, blocks, spread, np.zeros(len(blocks)))
    members: tuple[int, ...] = ()
    while len(members) < size:
        larger = search.larger(members) if members else search.singles
        if not larger:
            break
        members = heaviest_first(larger)[0].members
    return members


def _prior_constrained(problem: Problem, design: FloatArray, train: IntArray) -> FloatArray:
    """Least squares on some rows; base parameters held by their tolerances.

    Not to the fit without effects, which a missing effect has pulled away.
    """
    first = problem.zeros.shape[1]
    held = np.eye(design.shape[1])[first : first + problem.offsets.shape[1] + 3]
    rows = np.vstack([design[train], held])
    right = np.concatenate([problem.residual[train], np.zeros(len(held))])
    size = lengths(rows)
    found = np.linalg.lstsq(rows / size, right, rcond=EXACT_BLIND)[0]
    return np.asarray(found / size)


def on_other_sessions(
    problem: Problem, others: Sequence[FittedSession], effects: tuple[EffectInstance, ...]
) -> HeldOutGap | None:
    """The gap on sessions that were not used at all: effects and lengths as they were found.

    Every session has its own offsets and zeros. None where the effects put the machine out of its
    own reach.
    """
    before = Problem.of(others, problem.bars_seen())
    try:
        found = problem.adopting(effects)
        after = Problem.of([one.adopting(effects) for one in others], found.bars_seen())
    except NotIdentifiable:
        return None
    noise_mm = before.noise_mm * math.sqrt(max(before.structure_df, 1) / len(before.y))
    how = "sessions that were not used"
    return HeldOutGap(how, before.gap_rms_mm(), after.gap_rms_mm(), noise_mm)
