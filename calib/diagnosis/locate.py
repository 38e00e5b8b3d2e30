"""Where the gap lies: by leg, axis, posture, direction of approach, cycle, mounting."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from calib.diagnosis.problem import Problem
from calib.diagnosis.results import Share
from calib.diagnosis.scan import gap_p_value
from calib.linalg import incidence, onto, squares_in
from calib.observations import LEG_NAMES, TOOL, TOUCHED_NAMES, FloatArray
from calib.ties import descending

Mask = NDArray[np.bool_]


def locate(problem: Problem) -> tuple[Share, ...]:
    """Share of the gap in each part of the readings, with its chance under pure noise.

    The gap is the structure that the model leaves (cells and cycles). A part of the readings holds
    as much of it as the squares there; patterns hold what they explain.
    """
    explained = onto(problem.structure, problem.y)
    if not problem.structure_df:
        explained = np.zeros_like(explained)  # nothing is left but rounding
    total = float((explained**2).sum())
    shares = [
        _share(problem, explained, total, mask, leg, axis, pattern)
        for leg, axis, pattern, mask in _parts(problem)
    ]
    shares += [_of_pattern(problem, total, name, columns) for name, columns in _patterns(problem)]
    return tuple(descending(descending(shares, lambda s: s.share), lambda s: -s.p_value))


def _share(
    problem: Problem,
    explained: FloatArray,
    total: float,
    mask: Mask,
    leg: str,
    axis: str,
    pattern: str,
) -> Share:
    inside = float((explained[mask] ** 2).sum())
    basis = problem.structure[mask]
    hidden = problem.nuisance[mask]
    freedom = float((basis**2).sum() - (hidden**2).sum())
    chance = gap_p_value(inside, max(round(freedom), 1), problem.noise_df)
    return Share(leg, axis, pattern, inside / total if total else 0.0, chance)


def _of_pattern(problem: Problem, total: float, name: str, columns: FloatArray) -> Share:
    block = problem.block(columns)
    inside = squares_in(block, problem.y)
    chance = gap_p_value(inside, block.shape[1], problem.noise_df)
    return Share("", "", name, min(inside / total, 1.0) if total else 0.0, chance)


def _parts(problem: Problem) -> Iterator[tuple[str, str, str, Mask]]:
    leg, axis = problem.conditions("leg"), problem.conditions("axis")
    for k, name in enumerate(LEG_NAMES):
        if (leg == k).any():
            yield name, "", "leg", leg == k
        if (axis == k).any():
            yield "", name, "axis", axis == k
    for i, leg_name in zip((0, 1, 2, TOOL), TOUCHED_NAMES, strict=True):
        for j, axis_name in enumerate(LEG_NAMES):
            here = (leg == i) & (axis == j)
            if here.any():
                yield leg_name, axis_name, "mounting", here


def _patterns(problem: Problem) -> Iterator[tuple[str, FloatArray]]:
    """What may differ within a mounting, one column for each mounting and power."""
    displacement = problem.conditions("displacement_mm") / 100.0
    approach, time = problem.conditions("approach"), problem.conditions("time_s")
    temperature = problem.conditions("temperature_c")
    moves: list[tuple[str, FloatArray]] = [
        ("odd in displacement", np.stack([displacement, displacement**3], axis=1)),
        ("even in displacement", np.stack([displacement**2, displacement**4], axis=1)),
        ("direction of approach", approach[:, None]),
    ]
    position, movement = problem.conditions("position_mm"), problem.conditions("movement")
    if position.any():
        moves = [
            ("in proportion to the position", position / 100.0),
            ("with the square of the position", _squares(position / 100.0)),
            ("direction of approach", movement),
        ]
    if np.isfinite(time).all() and np.ptp(time) > 0.0:
        moves.append(("time", (time / np.ptp(time))[:, None]))
    if np.isfinite(temperature).all() and np.ptp(temperature) > 0.0:
        moves.append(("temperature", temperature[:, None]))
    for name, columns in moves:
        yield name, each_mounting(problem, columns)


def _squares(position: FloatArray) -> FloatArray:
    """Products of two coordinates ``(n, 6)``."""
    first, second = np.triu_indices(3)
    return np.asarray(position[:, first] * position[:, second])


def each_mounting(problem: Problem, columns: FloatArray) -> FloatArray:
    """The columns ``(n, k)`` once for each mounting, zero elsewhere ``(n, k * mounts)``."""
    mounts = incidence(problem.mount)
    return np.asarray((mounts[:, :, None] * columns[:, None, :]).reshape(len(columns), -1))


def left_over_words(shares: tuple[Share, ...], level: float) -> str:
    """A short sentence on where the gap is: the least likely parts by name."""
    significant = [s for s in shares if s.p_value < level]
    patterns = [s for s in significant if not s.leg and not s.axis]
    legs = [s for s in significant if s.pattern == "leg"]
    if not significant:
        return "nowhere in particular"
    parts = []
    if legs and len(legs) < 3:
        parts.append("on leg " + " and ".join(s.leg for s in legs))
    elif legs:
        parts.append("on all legs")
    if patterns:
        strongest = descending(patterns, lambda s: s.share)[0]
        parts.append(f"mostly with {strongest.pattern} ({strongest.share:.0%})")
    return ", ".join(parts) or f"most on {significant[0].leg}{significant[0].axis}"
