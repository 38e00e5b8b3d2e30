"""Whether what offsets and lengths leave in several sessions is one pattern, whatever its name.

The mean residuals of the postures that all sessions have, whitened alike, are a vector of d free
directions for each session. What is reproducible has the same direction in all of them; how large
it is may differ, as after a mechanical change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import betainc

from calib.arrays import DEPENDENT, FloatArray, basis_of, incidence, tilts, without
from calib.diagnosis.gap import AGREEMENT, FREE, LOOSE, Leftover
from calib.diagnosis.results import PatternPair, SharedPattern
from calib.identify.fit import design_of
from calib.posterior.cells import BASE, Cells
from calib.posterior.gaussian import About
from calib.stats import variance_ratio_p_value

SEED = 20221
DRAWS = 1999
TIE = 1e-9
SHOWS = 1.0
"""Noise that a tolerance of an offset must make for the direction to be free."""

RAREST = 1e-6
"""Rarer chances are all alike to a reader."""


def shared_pattern(sessions: Sequence[Cells]) -> SharedPattern | None:
    """Compare what is left in those of these sessions that have a gap.

    None where they are fewer than two, or their common postures leave fewer than two directions.
    """
    if len(sessions) < 2:
        return None
    chances = [Leftover.of([cells]).gap().p_value for cells in sessions]
    real = [k for k, chance in enumerate(chances) if chance <= AGREEMENT]
    if len(real) < 2:
        return None
    patterns = _Patterns.of([sessions[k] for k in real])
    if patterns is None:
        return None
    chance = patterns.chance_of_directions()
    return SharedPattern(
        sessions=tuple(real),
        directions=patterns.directions,
        common_share=patterns.common_share,
        p_value_directions=chance,
        p_value_permutations=patterns.chance_of_permutations(),
        reproducible=chance <= AGREEMENT,
        pairs=tuple(
            patterns.pair(i, j, (real[i], real[j])) for i, j in combinations(range(len(real)), 2)
        ),
    )


def repeats_words(pattern: SharedPattern) -> str:
    """What a reproducible pattern says, beginning with a space; empty where it is not one."""
    if not pattern.reproducible:
        return ""
    sessions = " and ".join(str(k + 1) for k in pattern.sessions)
    return (
        f" It is reproducible: sessions {sessions} have the same residual pattern, by chance"
        f" {once_in(pattern.p_value_directions)}."
    )


def once_in(p_value: float) -> str:
    """A p-value as how often; of the rarest, which may be 0 in floating point, only a limit."""
    rarer = "less than " if p_value < RAREST else ""
    return f"{rarer}once in {1.0 / max(p_value, RAREST):.0f} times"


@dataclass(frozen=True, eq=False)
class _Patterns:
    """m sessions at the same k postures.

    ``means`` ``(m, k)`` are mean residuals, mm, ``variance`` ``(m, k)`` theirs, mm²; ``root``
    ``(k,)`` divides by the noise of all, ``base`` takes away what zeros, offsets and lengths do, of
    which ``free`` directions are free; ``setups`` are the postures of each leg, axis and station.
    """

    means: FloatArray
    variance: FloatArray
    root: FloatArray
    base: About
    free: int
    setups: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, sessions: Sequence[Cells]) -> _Patterns | None:
        """The patterns at the postures that all sessions have, whichever way they were reached.

        Zeros are those of every session, offsets and lengths act as they do in the first one.
        """
        keyed = [_rows_by_posture(cells) for cells in sessions]
        common = sorted(set.intersection(*(set(rows) for rows in keyed)))
        if not common:
            return None
        means, variances, zeros, bases = [], [], [], []
        for cells, rows in zip(sessions, keyed, strict=True):
            cell_means, variance = cells.means, cells.variance_mm2
            average = np.zeros((len(common), len(cell_means)))  # weighted means of these rows
            for k, key in enumerate(common):
                weight = 1.0 / variance[rows[key]]
                average[k, rows[key]] = weight / weight.sum()
            means.append(average @ (cell_means.value_mm - cells.model.readings(cell_means)))
            variances.append(average**2 @ variance)
            zeros.append(average @ np.hstack([incidence(cell_means.mount), tilts(cell_means)]))
            by_base = design_of(cells.model, cell_means, range(BASE), ())
            bases.append(average @ (by_base * cells.case.spread_mm))
        variance_of_sessions = np.array(variances)
        root = 1.0 / np.sqrt(variance_of_sessions.mean(axis=0))
        zero = root[:, None] * np.hstack(zeros)
        zero = basis_of(zero[:, zero.any(axis=0)], DEPENDENT)
        by_base = root[:, None] * bases[0]
        columns = np.hstack([LOOSE * zero, FREE * by_base[:, :3], by_base[:, 3:]])
        base = About.of(columns, np.zeros(len(root)), np.zeros(columns.shape[1]))
        free = zero.shape[1] + basis_of(without(zero, by_base[:, :3]), SHOWS, 1.0).shape[1]
        groups: dict[tuple[float, ...], list[int]] = {}
        for k, key in enumerate(common):
            groups.setdefault(key[:3], []).append(k)
        set_ups = tuple(map(tuple, groups.values()))
        patterns = cls(np.array(means), variance_of_sessions, root, base, free, set_ups)
        return patterns if patterns.directions > 1 else None

    @property
    def directions(self) -> int:
        """How many directions zeros and offsets leave."""
        return int(self.means.shape[1] - self.free)

    @cached_property
    def left(self) -> FloatArray:
        """What is left of each session ``(m, k)``, whitened."""
        return self.base.left_by((self.root * self.means).T).T

    @cached_property
    def common_share(self) -> float:
        """The part of the patterns, made equally long, that one direction holds.

        Of two it is (1 + |cosine|) / 2.
        """
        return float(_shares(self.left[None])[0])

    def chance_of_directions(self) -> float:
        """Chance of so large a share of directions drawn at random."""
        if len(self.means) == 2:
            sine = 1.0 - (2.0 * self.common_share - 1.0) ** 2
            return float(betainc((self.directions - 1) / 2, 0.5, max(sine, 0.0)))
        size = DRAWS, len(self.means), self.directions
        return self._reached(np.random.default_rng(SEED).normal(size=size))

    def chance_of_permutations(self) -> float:
        """The chance where set-ups read alike change places in all sessions but the first."""
        generator = np.random.default_rng(SEED)
        samples = np.repeat(self.means[None], DRAWS, axis=0)
        for count in {len(rows) for rows in self.setups}:
            alike = np.array([rows for rows in self.setups if len(rows) == count])
            for k in range(1, len(self.means)):
                order = np.argsort(generator.random((DRAWS, len(alike))), axis=1)
                samples[:, k, alike.ravel()] = self.means[k][alike[order]].reshape(DRAWS, -1)
        white = self.base.left_by((self.root * samples).reshape(-1, len(self.root)).T).T
        return self._reached(white.reshape(*samples.shape[:2], -1))

    def _reached(self, samples: FloatArray) -> float:
        """How often patterns ``(draws, m, k)`` are as much alike; a tie counts."""
        reached = np.count_nonzero(_shares(samples) >= self.common_share - TIE)
        return float((1 + reached) / (1 + len(samples)))

    def pair(self, i: int, j: int, numbers: tuple[int, int]) -> PatternPair:
        """What is left of session j when the pattern of i, made as large as fits, is taken off."""
        first, second = self.left[i], self.left[j]
        scale = float(first @ second / (first @ first))
        remainder = second - scale * first
        variance = self.variance[j] + scale**2 * self.variance[i]
        freedom = self.directions - 1
        ratio = float(remainder @ remainder) / float((self.root**2 * variance).mean()) / freedom
        return PatternPair(
            *numbers,
            cosine=float(first @ second / (np.linalg.norm(first) * np.linalg.norm(second))),
            scale=scale,
            before_rms_mm=self._rms_mm(second),
            after_rms_mm=self._rms_mm(remainder),
            noise_rms_mm=float(np.sqrt(variance.mean() * freedom / len(self.root))),
            p_value=variance_ratio_p_value(ratio, freedom, np.inf),
        )

    def _rms_mm(self, residual: FloatArray) -> float:
        return float(np.sqrt(((residual[: len(self.root)] / self.root) ** 2).mean()))


def _shares(residual: FloatArray) -> FloatArray:
    """`common_share` of patterns ``(draws, m, k)``, ``(draws,)``."""
    unit = residual / np.linalg.norm(residual, axis=2, keepdims=True)
    return np.asarray(np.linalg.eigvalsh(unit @ unit.transpose(0, 2, 1))[:, -1] / residual.shape[1])


def _rows_by_posture(cells: Cells) -> dict[tuple[float, ...], list[int]]:
    """Rows by leg, axis, station, displacement and position."""
    cell_means = cells.means
    keys = [
        cell_means.leg,
        cell_means.axis,
        cell_means.station,
        cell_means.displacement_mm,
        *cell_means.position_mm.T,
    ]
    rows: dict[tuple[float, ...], list[int]] = {}
    for k, key in enumerate(np.column_stack(keys).round(4).tolist()):
        rows.setdefault(tuple(key), []).append(k)
    return rows
