"""The gap on readings that the choice did not see."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from calib.diagnosis.problem import FittedSession, Problem
from calib.diagnosis.results import HeldOutGap
from calib.diagnosis.selection import KNOWN, Search, Spread, heaviest_first
from calib.errors import NotIdentifiable
from calib.linalg import DEPENDENT, EXACT_BLIND, basis_of, lengths, new_directions, onto, without
from calib.observations import LEG_NAMES, TOOL, FloatArray, IntArray
from calib.tripod.effects.effect import EffectInstance


def left_out_postures(
    problem: Problem,
    columns: Sequence[FloatArray],
    size: int,
    tolerance_mm: FloatArray,
    groups: Sequence[IntArray] = (),
) -> HeldOutGap | None:
    """Leave out one side of one leg at a time; choose anew, fit, predict what was left out.

    ``columns`` are those of every candidate ``(n, r)`` in mm, ``size`` the number of effects to
    choose in each fold. Zeros come from the rest of each mounting, base parameters are held by
    their tolerances. ``groups`` are other rows to leave out together. None where nothing can be.
    """
    nuisance = problem.nuisance_columns()
    white = [problem.root_weight[:, None] * c for c in columns]
    y = problem.left
    before, after, used = 0.0, 0.0, 0
    for rows in groups or _groups(problem):
        train = np.setdiff1d(np.arange(len(y)), rows)
        chosen = _choose(problem, white, nuisance, y, train, size)
        for effects, add in ((False, 0), (True, 1)):
            design = np.hstack([nuisance, *([white[k] for k in chosen] if effects else [])])
            value = _held_fit(design, y, train, problem, tolerance_mm)
            left = (y[rows] - design[rows] @ value) / problem.root_weight[rows]
            if add:
                after += float((left**2).sum())
            else:
                before += float((left**2).sum())
        used += len(rows)
    if not used:
        return None
    noise = float(np.mean(problem.root_weight**-2.0))
    return HeldOutGap(
        "one side of one leg left out at a time, the choice made anew each time",
        math.sqrt(before / used),
        math.sqrt(after / used),
        math.sqrt(noise),
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


def _choose(
    problem: Problem,
    white: Sequence[FloatArray],
    nuisance: FloatArray,
    y: FloatArray,
    train: IntArray,
    size: int,
) -> tuple[int, ...]:
    """The best model of this size on these rows alone."""
    basis = basis_of(nuisance[train], DEPENDENT)
    rest = without(basis, y[train])
    spread = KNOWN
    if math.isfinite(problem.noise_df):
        spread = Spread(float(rest @ rest), float(len(train) - basis.shape[1]))
    blocks = [new_directions(basis, column[train] / lengths(column)) for column in white]
    search = Search(rest, tuple(blocks), spread, np.zeros(len(blocks)), (1,) * len(blocks))
    singles = search.singles()
    best = heaviest_first(singles)[0]
    while len(best.members) < size:
        larger = search.beside(best.members)
        if not larger:
            break
        best = heaviest_first(larger)[0]
    return best.members


def _held_fit(
    design: FloatArray, y: FloatArray, train: IntArray, problem: Problem, tolerance_mm: FloatArray
) -> FloatArray:
    """Least squares on some rows; base parameters held by their tolerances.

    Not to the fit without effects, which a missing effect has pulled away.
    """
    hold, middle = np.zeros(design.shape[1]), np.zeros(design.shape[1])
    start = 0
    for one in problem.fitted_sessions:
        start += one.observed.mount_count
        here = slice(start, start + len(tolerance_mm))
        hold[here] = 1.0 / tolerance_mm
        middle[here] = one.held_to_mm - np.array(one.model.parameters_mm)
        start = here.stop
    rows = np.vstack([design[train], np.diag(hold)[hold > 0.0]])
    right = np.concatenate([y[train], (hold * middle)[hold > 0.0]])
    size = lengths(rows)
    found = np.linalg.lstsq(rows / size, right, rcond=EXACT_BLIND)[0]
    return np.asarray(found / size)


def on_other_sessions(
    others: Sequence[FittedSession], effects: tuple[EffectInstance, ...], tolerance_mm: FloatArray
) -> HeldOutGap | None:
    """The gap on sessions that were not used at all: effects as they were found, base anew.

    Every session has its own base parameters and zeros, so only the effects are tested. None where
    the effects put the machine out of its own reach.
    """
    before = Problem.of(others)
    adopted = []
    for one in others:
        model = one.model.with_parameters(one.held_to_mm).with_effects(
            (*one.model.effects, *effects)
        )
        try:
            adopted.append(one.again(model, tolerance_mm))
        except NotIdentifiable:
            return None
    after = Problem.of(adopted)
    noise = float(np.mean(before.root_weight**-2.0))
    share = max(before.structure_df, 1) / len(before.y)
    return HeldOutGap(
        "sessions that were not used",
        structure_rms_mm(before),
        structure_rms_mm(after),
        math.sqrt(noise * share),
    )


def structure_rms_mm(problem: Problem, residual: FloatArray | None = None) -> float:
    """R.m.s. over the readings of what is left beyond the scatter of repeats, mm."""
    left = problem.y if residual is None else residual
    inside = onto(problem.structure, left)
    return math.sqrt(float(((inside / problem.root_weight) ** 2).mean()))
