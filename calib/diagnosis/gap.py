"""What a model leaves of the readings: how much, where, and how much of what it did not see.

Rows are those of the posterior: means of cells, and what readings do in time within them. Joint
offsets are free, for a calibration is there to find them; bar lengths are as far off as their
tolerance allows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag  # scipy.linalg would take 0.04 s more to import

from calib.arrays import (
    DEPENDENT,
    LEG_NAMES,
    TOOL,
    TOUCHED_NAMES,
    FloatArray,
    basis_of,
    descending,
    incidence,
    lengths,
    numbered,
    set_up_unknowns,
    squares_in,
)
from calib.diagnosis.results import Cell, CellResiduals, Gap, GapPart
from calib.identify.fit import prior_fit
from calib.posterior.cells import Cells
from calib.posterior.gaussian import About
from calib.posterior.readings import LENGTHS, Rows, rows_of
from calib.stats import variance_ratio_p_value
from calib.tripod.effects.candidates import placed_columns
from calib.tripod.effects.effect import Effect, EffectInstance, Placed

LOOSE = 1e4
"""Standard deviations of a mean within which a zero may be anything."""

FREE = 1e3
"""Tolerances within which a joint offset may be anything."""

AGREEMENT = 0.01
"""Chance below which a gap counts: one sound session in a hundred may be looked at."""

VISIBLE = 1e-6
"""Least length of a pattern beside the base, over its length before."""


@dataclass(frozen=True)
class BarLengths:
    """What sessions tell of the lengths that they share, mm: mean ``(3,)``, root ``(3, 3)``."""

    mean_mm: FloatArray
    root_mm: FloatArray


@dataclass(frozen=True, eq=False)
class Leftover:
    """What a model of each session leaves of its rows, joint offsets and lengths fitted.

    ``about`` has the base fitted, then the sizes of adopted effects, which are free within
    ``free`` standard deviations; ``values`` are how many sizes of effects were fitted beside it.
    """

    sessions: tuple[Cells, ...]
    rows: Rows
    about: About
    values: int = 0
    free: Mapping[Placed, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        sessions: Sequence[Cells],
        effects: tuple[EffectInstance, ...] = (),
        timed: Sequence[Effect] = (),
        bars: BarLengths | None = None,
    ) -> Leftover:
        """What is left with ``effects`` in the models; ``timed`` are laws of time that readings may
        show.

        Raises NotIdentifiable where the legs cannot meet, and UnreachablePosture.
        """
        models, placed_laws = [], []
        free = sessions[0].case.free_spread
        laws = tuple(dict.fromkeys((*timed, *(law for law, _ in free))))
        for cells in sessions:
            acting = cells.case.model.with_effects((*cells.case.model.effects, *effects))
            if bars is not None:
                here = (*acting.parameters_mm[:3], *bars.mean_mm.tolist())
                acting = acting.with_parameters(np.array(here))
            weight = 1.0 / cells.variance_mm2
            model = prior_fit(acting, cells.means, weight, cells.case.spread_mm).model
            models.append(model)
            columns = placed_columns(model, cells.means, laws)
            placed_laws.append(
                {law: c for law, c in columns.items() if law[0] in timed or law in free}
            )
        shared = np.mean([model.parameters_mm[3:] for model in models], axis=0)
        models = [m.with_parameters(np.array([*m.parameters_mm[:3], *shared])) for m in models]
        rows = rows_of(sessions, models, placed_laws)
        values = sum(len(effect.values) for effect in effects)
        of_time = np.zeros(rows.columns.shape[1], dtype=bool)
        for law, places in rows.places.items():
            of_time[places] = law[0] in timed
        free = {law: spread for law, spread in free.items() if law in rows.places}
        sizes = [rows.columns[:, rows.places[law]] * spread for law, spread in free.items()]
        about = _fitted(rows, bars, np.hstack([np.zeros((len(rows.columns), 0)), *sizes]))
        rows = replace(rows, columns=rows.columns[:, of_time])
        return cls(tuple(sessions), rows, about, values, free)

    @classmethod
    def about_rows(cls, sessions: Sequence[Cells], rows: Rows) -> Leftover:
        """What is left of rows about models of the sessions."""
        return cls(tuple(sessions), rows, _fitted(rows, None, np.zeros((len(rows.residual), 0))))

    @property
    def left(self) -> FloatArray:
        """Rows ``(n,)``, then what lengths need of their tolerance."""
        return self.about.left

    def resized(self) -> tuple[EffectInstance, ...]:
        """What adopted effects differ by from their sizes in the model."""
        values = (self.about.inverse @ self.about.along)[len(self.rows.value) :]
        ends = np.cumsum([len(spread) for spread in self.free.values()])
        laws = zip(self.free.items(), np.split(values, ends), strict=False)
        return tuple(
            EffectInstance(*law, tuple((spread * sizes).tolist())) for (law, spread), sizes in laws
        )

    @cached_property
    def freedom(self) -> int:
        """Rows less what zeros and joint offsets take."""
        fitted = sum(set_up_unknowns(cells.means) + 3 for cells in self.sessions)
        return max(len(self.rows.residual) - fitted, 0)

    @property
    def noise_freedom(self) -> float:
        """Degrees of freedom of the noise of all sessions; 0 where one has none."""
        all_known = all(cells.noise for cells in self.sessions)
        return sum(cells.freedom for cells in self.sessions) if all_known else 0.0

    def p_value(self, square: float, freedom: int) -> float:
        """Chance of a square at least this large from noise alone; 1 where nothing is free."""
        if freedom <= 0 or self.noise_freedom <= 0.0:
            return 1.0
        return variance_ratio_p_value(square / freedom, freedom, self.noise_freedom)

    def gap(self) -> Gap:
        """How much that is."""
        square, freedom = float(self.left @ self.left), max(self.freedom - self.values, 0)
        return Gap(self.rms_mm(self.left), square, freedom, self.p_value(square, freedom))

    def rms_mm(self, residual: FloatArray) -> float:
        """The r.m.s. of rows ``(n, ...)`` over the readings."""
        square = math.fsum(
            float((cells.means.averaged * off_mm**2).sum())
            for cells, off_mm in zip(self.sessions, self.cells_mm(residual), strict=True)
        )
        in_time = residual[self.rows.cells : len(self.rows.residual)]
        square += float(in_time @ in_time) * self.reading_mm2
        return math.sqrt(square / self._readings)

    @property
    def noise_mm(self) -> float:
        """The gap that noise alone would leave, r.m.s. over the readings."""
        return math.sqrt(self.reading_mm2 * max(self.freedom, 1) / self._readings)

    @cached_property
    def reading_mm2(self) -> float:
        """Variance of a single reading, mean over the visits, mm²."""
        visits = [cells.scatter_mm2 * cells.visits.averaged for cells in self.sessions]
        return float(np.concatenate(visits).mean())

    @cached_property
    def _readings(self) -> float:
        """How many there are."""
        return math.fsum(float(cells.means.averaged.sum()) for cells in self.sessions)

    def cells_mm(self, residual: FloatArray) -> list[FloatArray]:
        """Means of the cells ``(n_cells,)`` of each session."""
        ends = np.cumsum([len(cells.means) for cells in self.sessions])
        return [
            cells.coloured(residual[end - len(cells.means) : end, None])[:, 0]
            for cells, end in zip(self.sessions, ends.tolist(), strict=True)
        ]

    def explained_by(self, rows: FloatArray) -> FloatArray:
        """Orthonormal directions ``(n, r)`` of what rows ``(n, k)`` do beside the base."""
        remainder = self.about.left_by(rows)
        size, lengths_before = lengths(remainder), lengths(rows)
        visible = size > VISIBLE * np.maximum(lengths_before, VISIBLE)
        return basis_of(remainder[:, visible] / size[visible], DEPENDENT)

    def conditions(self, name: str) -> NDArray[Any]:
        """One array of the conditions of all cells ``(n_cells, ...)``."""
        return np.concatenate([getattr(cells.means, name) for cells in self.sessions])

    def bars(self) -> BarLengths:
        """What these sessions tell of the lengths."""
        scale = spread_of(self.rows)[:LENGTHS]
        value = self.about.inverse @ self.about.along
        root = scale[:, None] * self.about.inverse[:LENGTHS]
        return BarLengths(
            self.rows.value[:LENGTHS] + scale * value[:LENGTHS],
            np.asarray(np.linalg.cholesky(root @ root.T)),
        )


def spread_of(rows: Rows) -> FloatArray:
    """Standard deviations ``(b,)`` of the base: joint offsets are free."""
    free = np.arange(len(rows.spread)) >= LENGTHS
    return np.asarray(np.where(free, FREE, 1.0) * rows.spread)


def expected_base(rows: Rows) -> FloatArray:
    """Where lengths are expected ``(b,)`` less where rows are, in standard deviations."""
    spread = spread_of(rows)
    return np.asarray(np.where(spread == rows.spread, (rows.prior - rows.value) / spread, 0.0))


def _fitted(rows: Rows, bars: BarLengths | None, sizes: FloatArray) -> About:
    """The base, and ``sizes`` ``(n, k)`` of adopted effects per standard deviation, fitted."""
    spread, expected = spread_of(rows), expected_base(rows)
    base = rows.base * spread
    if bars is not None:
        base[:, :LENGTHS] = rows.base[:, :LENGTHS] @ bars.root_mm
        away = bars.mean_mm - rows.value[:LENGTHS]
        expected[:LENGTHS] = np.linalg.solve(bars.root_mm, away)
    expected = np.concatenate([expected, np.zeros(sizes.shape[1])])
    return About.of(np.hstack([base, sizes]), rows.residual, expected)


def locate(leftover: Leftover) -> tuple[GapPart, ...]:
    """Share of the gap in each part of the readings, with its chance under pure noise.

    A part of the readings holds as much of it as the squares there; patterns hold what they
    explain.
    """
    count = leftover.rows.cells
    square = leftover.left[:count] ** 2
    in_readings = leftover.left[: len(leftover.rows.residual)]  # not what lengths need of tolerance
    total = float(in_readings @ in_readings) if leftover.freedom else 0.0
    leverage = (leftover.about.basis[:count] ** 2).sum(axis=1)
    leverage = leverage + np.concatenate([(c.zeros**2).sum(axis=1) for c in leftover.sessions])

    def part(leg: str, axis: str, pattern: str, inside: float, free: int) -> GapPart:
        share = min(inside / total, 1.0) if total else 0.0
        chance = leftover.p_value(inside, free) if total else 1.0
        return GapPart(leg or None, axis or None, pattern, share, chance)

    shares = []
    for leg, axis, pattern, mask in _parts(leftover):
        if mask.any():
            free = max(round(float((1.0 - leverage[mask]).sum())), 1)
            shares.append(part(leg, axis, pattern, float(square[mask].sum()), free))
    for pattern, rows in _patterns(leftover):
        basis = leftover.explained_by(rows)
        inside = squares_in(basis, leftover.left)
        shares.append(part("", "", pattern, inside, basis.shape[1]))
    return tuple(descending(descending(shares, lambda s: s.share), lambda s: -s.p_value))


def _parts(leftover: Leftover) -> Iterator[tuple[str, str, str, NDArray[np.bool_]]]:
    leg, axis = leftover.conditions("leg"), leftover.conditions("axis")
    for k, name in enumerate(LEG_NAMES):
        yield name, "", "leg", leg == k
        yield "", name, "axis", axis == k
    for i, leg_name in zip((0, 1, 2, TOOL), TOUCHED_NAMES, strict=True):
        for j, axis_name in enumerate(LEG_NAMES):
            yield leg_name, axis_name, "mounting", (leg == i) & (axis == j)


def _patterns(leftover: Leftover) -> Iterator[tuple[str, FloatArray]]:
    """What may differ within a mounting, as rows ``(n, k)``."""
    by_name: dict[str, list[FloatArray]] = {}
    of_tool = bool(leftover.conditions("position_mm").any())
    for cells in leftover.sessions:
        means = cells.means
        if of_tool:
            position = means.position_mm / 100.0
            first, second = np.triu_indices(3)
            by_pattern = {
                "in proportion to the position": position,
                "with the square of the position": position[:, first] * position[:, second],
                "direction of approach": means.movement,
            }
        else:
            far = means.displacement_mm[:, None] / 100.0
            by_pattern = {
                "odd in displacement": np.hstack([far, far**3]),
                "even in displacement": np.hstack([far**2, far**4]),
                "direction of approach": means.approach[:, None],
            }
        for name, columns in by_pattern.items():
            by_mounting = incidence(means.mount)[:, :, None] * columns[:, None, :]
            by_name.setdefault(name, []).append(by_mounting.reshape(len(columns), -1))
    for name, parts in by_name.items():
        # columns of each session beside those of the others; nothing within cells
        whitened = [c.whitened(part) for c, part in zip(leftover.sessions, parts, strict=True)]
        rows = np.zeros((len(leftover.rows.residual), sum(part.shape[1] for part in parts)))
        rows[: leftover.rows.cells] = block_diag(whitened).toarray()
        yield name, rows
    if (columns := leftover.rows.columns).shape[1]:
        yield "time or temperature", columns


def where_words(shares: tuple[GapPart, ...]) -> str:
    """A short sentence on where the gap is: the least likely parts by name."""
    significant = [s for s in shares if s.p_value < AGREEMENT]
    patterns = [s for s in significant if not s.leg and not s.axis]
    legs = [s for s in significant if s.posture_or_pattern == "leg"]
    if not significant:
        return "no place stands out"
    parts = []
    if legs:
        legs_words = "leg " + " and ".join(s.leg or "" for s in legs)
        parts.append(f"on {legs_words if len(legs) < 3 else 'all legs'}")
    if patterns:
        strongest = descending(patterns, lambda s: s.share)[0]
        how = strongest.posture_or_pattern
        how = how if how.startswith(("odd", "even", "in ", "with")) else f"with the {how}"
        how = how.replace("the time or", "time or")
        parts.append(f"{strongest.share:.0%} of it {how}")
    return ", ".join(parts) or f"most on {significant[0].leg or ''}{significant[0].axis or ''}"


def residuals(plain: Leftover, adopted: Leftover | None) -> CellResiduals:
    """Means of each place of the readings, before and after effects were adopted."""
    names = ("leg", "axis", "station", "displacement_mm", "approach")
    columns = [*map(plain.conditions, names), *plain.conditions("position_mm").T]
    keys = [column.astype(np.float64).round(4) for column in columns]
    cell = numbered(*keys)
    first, count = np.unique(cell, return_index=True)[1], np.bincount(cell)

    def means_mm(leftover: Leftover) -> FloatArray:
        off_mm = np.concatenate(leftover.cells_mm(leftover.left))
        return np.asarray(np.bincount(cell, off_mm) / count)

    variance = np.concatenate([cells.variance_mm2 for cells in plain.sessions])
    noise = np.sqrt(np.bincount(cell, variance)) / count
    earlier, later = means_mm(plain), None if adopted is None else means_mm(adopted)
    values = zip(
        np.column_stack(keys)[first].tolist(),
        earlier.tolist(),
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
        for place, before_mm, after_mm, noise_mm in values
    )
    return CellResiduals(cells, _rms(earlier), None if later is None else _rms(later), _rms(noise))


def _rms(values_mm: FloatArray) -> float:
    return float(np.sqrt(np.mean(values_mm**2)))
