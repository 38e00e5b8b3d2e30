"""Linear algebra of the bench: what an effect leaves after base parameters and zeros are refitted.

Derivatives are forward differences of the bench's own machine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from tests.blind.effects import LATERAL, Candidate, Direction
from tests.blind.forward import FloatArray, Hidden, Hypothesis, Rows, readings

STEP = {
    **dict.fromkeys(("offset", "length", "round"), 1e-3),
    **dict.fromkeys(("lag", "clearance"), 1e-4),
    **dict.fromkeys(("lean", "drift", "stand"), 1e-6),
    **dict.fromkeys(("curve", "bow"), 1e-8),
}
USUAL_STEP = 1e-5
RANK_TOLERANCE = 1e-6
JUDGED = 200
BASE: tuple[Hypothesis, ...] = tuple(
    (name, (i,)) for name in ("offset", "length") for i in range(3)
)


class Columns:
    """Derivatives of the readings at one hidden machine, computed once for each entry."""

    def __init__(self, rows: Rows, hidden: Hidden) -> None:
        self.rows = rows
        self.hidden = hidden
        self._found: dict[tuple[Hypothesis, float], FloatArray] = {}
        zeros = np.equal.outer(rows.mount, np.arange(rows.mount.max() + 1)).astype(np.float64)
        self._plain: dict[float, FloatArray] = {}
        self._spans: dict[Candidate, FloatArray] = {}
        leaning = [("plane", (leg, 2)) for leg in (0, 1) if rows.over_plane.any()]
        entries = (*BASE, *leaning)
        base = np.column_stack([self._entry(entry, hidden.lead_mm) for entry in entries])
        self.base = np.column_stack([base, zeros])
        self.nuisance = np.linalg.qr(self.base)[0]

    def beside(self, candidates: Sequence[Candidate]) -> Columns:
        """The same where these effects, too, are refitted before anything is compared."""
        if not candidates:
            return self
        joint = copy(self)
        joint._spans = {}
        spans = [self.span(candidate) for candidate in candidates]
        joint.nuisance = np.linalg.qr(np.column_stack([self.nuisance, *spans]))[0]
        return joint

    def _entry(self, entry: Hypothesis, lead_mm: float) -> FloatArray:
        key = (entry, lead_mm)
        if key not in self._found:
            step = STEP.get(entry[0], USUAL_STEP)
            machine = replace(self.hidden, lead_mm=lead_mm)
            if lead_mm not in self._plain:
                self._plain[lead_mm] = readings(self.rows, machine)
            moved = readings(self.rows, machine.plus([(entry, step)]))
            self._found[key] = (moved - self._plain[lead_mm]) / step
        return self._found[key]

    def direction(self, direction: Direction, lead_mm: float) -> FloatArray:
        """Derivative along one direction, ``(n,)``."""
        parts = [weight * self._entry(entry, lead_mm) for entry, weight in direction]
        return np.asarray(np.sum(parts, axis=0))

    def raw(self, candidate: Candidate) -> FloatArray:
        """Columns ``(n, r)`` of one candidate."""
        directions = [self.direction(d, candidate.lead_mm) for d in candidate.directions]
        return np.column_stack(directions)

    def left_over(self, values: FloatArray) -> FloatArray:
        """Without what base parameters and zeros explain; ``(n,)`` or ``(n, r)``."""
        return np.asarray(values - self.nuisance @ (self.nuisance.T @ values))

    def span(self, candidate: Candidate) -> FloatArray:
        """Orthonormal basis of what the candidate leaves, ``(n, rank)``."""
        if candidate not in self._spans:
            self._spans[candidate] = self._span(candidate)
        return self._spans[candidate]

    def _span(self, candidate: Candidate) -> FloatArray:
        raw = self.raw(candidate)
        scale = np.linalg.norm(raw, axis=0)
        residual = self.left_over(raw) / np.where(scale > 0, scale, 1.0)
        basis, sizes, _ = np.linalg.svd(residual, full_matrices=False)
        return np.asarray(basis[:, sizes > RANK_TOLERANCE])


def parts(candidate: Candidate) -> list[Candidate]:
    """The same effect with one of its directions only: a place within its place.

    The contract names mountings and directions, too: a second value that hardly shows leaves
    nothing by which the data could tell "leg y" from "mounting yx".
    """
    if candidate.id not in LATERAL or len(candidate.directions) < 2:
        return []
    return [replace(candidate, directions=(direction,)) for direction in candidate.directions]


def contained(signal: FloatArray, basis: FloatArray) -> float:
    """Share of the signal's square inside the basis, 0 … 1."""
    return float(np.sum((basis.T @ signal) ** 2) / np.sum(signal**2))


def best_rival(
    columns: Columns, signal: FloatArray, rivals: Sequence[Candidate]
) -> tuple[str, float]:
    """Id of the candidate that can imitate the signal best, and how much of it."""
    residual = columns.left_over(signal)
    shares = [(contained(residual, columns.span(c)), c.id) for c in rivals]
    share, name = max(shares, default=(0.0, ""))
    return name, share


def named_by_a_judge(
    columns: Columns, signal: FloatArray, name: str, rivals: Sequence[Candidate], noise_mm: float
) -> float:
    """How often one who knows all but this effect would give it its name, 0 … 1.

    Known are the machine, the noise and what else is hidden. Noise is drawn, and of all candidates
    the one with the largest Bayes factor wins (Liang et al. 2008, fitted g, known variance); names
    are equally likely, and so are the places of each.
    """
    ways = Counter(c.id for c in rivals)
    noise = np.random.default_rng(len(signal)).standard_normal((len(signal), JUDGED))
    signals = columns.left_over(signal)[:, None] / noise_mm + noise
    weights = []
    for candidate in rivals:
        span = columns.span(candidate)
        rank = max(span.shape[1], 1)
        squares = np.maximum(np.sum((span.T @ signals) ** 2, axis=0), rank)
        evidence = 0.5 * (squares - rank) - 0.5 * rank * np.log(squares / rank)
        weights.append(evidence - np.log(ways[candidate.id]))
    best = np.argmax(weights, axis=0)
    return float(np.mean([rivals[k].id == name for k in best]))


def left_out_rms(design: FloatArray, values: FloatArray, groups: Sequence[object]) -> float:
    """Root mean square of readings predicted from a fit without their own group.

    Readings of group None are in every fit and never predicted.
    """
    basis, sizes, _ = np.linalg.svd(design / np.linalg.norm(design, axis=0), full_matrices=False)
    basis = basis[:, sizes > 1e-10 * sizes[0]]
    residual = values - basis @ (basis.T @ values)
    errors = []
    for key in set(groups) - {None}:
        rows = np.array([k for k, group in enumerate(groups) if group == key])
        inside = np.eye(len(rows)) - basis[rows] @ basis[rows].T
        errors.append(np.linalg.lstsq(inside, residual[rows], rcond=1e-8)[0])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
