"""A turned or swapped indicator beside an effect: both at once must explain what effects cannot.

Beside a strong effect a mistake may take away only part of the disagreement, and an effect may
bend the slopes that tell it. Then the mistake with some effects is weighed against effects alone:
each side takes the effects that explain most, pays for each, and the variance of the noise is
taken from what is left and the scatter of repeats (Student's likelihood).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.diagnosis.gross_errors import GrossError, Suspicion
from calib.diagnosis.hypotheses import MOST_LOSS, Hypothesis, chosen, entries_of, implausible
from calib.diagnosis.problem import FittedSession, Problem
from calib.diagnosis.results import Named
from calib.diagnosis.selection import LOG_UNIT
from calib.linalg import squares_in, union, without
from calib.observations import FloatArray
from calib.stats import variance_ratio_p_value
from calib.ties import descending
from calib.tripod.effects.effect import Law

MOST_EFFECTS = 3
BEAM = 4
CLOSED = 0.001
"""With a mistake that is not clear, and effects, no gap of smaller chance may be left."""

WEIGHED = 8
"""Of the effects that promise most, so many are weighed by the size they need."""

LEAST_GAIN = 1e-6


@dataclass(frozen=True, eq=False)
class _Field:
    """Every effect that may stand beside a mistake, as orthonormal blocks ``(n, r)``."""

    problem: Problem
    entries: Sequence[Hypothesis]
    blocks: Sequence[FloatArray]
    chosen: FloatArray
    _prices: dict[int, float] = field(default_factory=dict)

    @classmethod
    def of(cls, fitted_session: FittedSession, laws: Sequence[Law]) -> _Field:
        """All candidates of the catalogue that show in this session."""
        problem = Problem.of([fitted_session])
        every = [e for e in entries_of(problem, laws) if e.kind != "blunder"]
        blocks = [problem.block(e.columns) for e in every]
        shown = [k for k, block in enumerate(blocks) if block.shape[1]]
        entries = [every[k] for k in shown]
        return cls(problem, entries, [blocks[k] for k in shown], chosen(entries))

    @property
    def freedom(self) -> int:
        """Readings less zeros and base parameters."""
        return int(len(self.problem.y) - self.problem.nuisance.shape[1])

    def width(self, explained: float, block: FloatArray) -> float:
        """What a prior as wide as the effect found costs (unit information, fitted)."""
        rank = max(block.shape[1], 1)
        return float(0.5 * block.shape[1] * math.log(max(explained / rank, 1.0)))

    def log_prior(self, member: int) -> float:
        """What it costs to have been chosen, and to be of implausible size."""
        if member not in self._prices:
            size = min(implausible(self.problem, [self.entries[member]]), MOST_LOSS)
            self._prices[member] = float(self.chosen[member]) + size
        return self._prices[member]


@dataclass(frozen=True, eq=False)
class _Account:
    """Some effects and how well they account for the readings: log likelihood less the price."""

    members: tuple[int, ...]
    basis: FloatArray
    log_prior: float
    log_weight: float


def needed_beside_effects(
    before: FittedSession,
    suspicions: Sequence[tuple[Suspicion, FittedSession]],
    laws: Sequence[Law],
) -> GrossError | None:
    """The mistake, of those suspected, that is needed whatever effects there are; or None.

    Each comes with its corrected session, fitted. One that is not clear must be beyond doubt and
    leave no gap. Effects that do almost as well are named with it.
    """
    alone = _Field.of(before, laws)
    if not alone.problem.has_repeats() or alone.problem.structure_df < 1:
        return next((one.blunder for one, _ in suspicions if one.clear), None)
    without = _best(alone, MOST_EFFECTS)
    for one, fitted_session in sorted(suspicions, key=lambda each: not each[0].clear):
        corrected = _Field.of(fitted_session, laws)
        account = _best(corrected, MOST_EFFECTS if one.clear else MOST_EFFECTS - 1)
        without = _heaviest_first([without, _same(corrected, account, alone)])[0]
        likelier = account.log_weight - without.log_weight
        if likelier > one.log_odds and (one.clear or _closes(corrected.problem, account)):
            return one.blunder
        if one.clear and likelier > one.log_doubtful_odds:
            entries = [alone.entries[k] for k in without.members]
            named = tuple(Named(entry.id, entry.where) for entry in entries)
            return replace(one.blunder, or_else=named)
    return None


def _same(there: _Field, account: _Account, here: _Field) -> _Account:
    """The effects of an account in other readings, or better ones near them.

    What was found beside a mistake must be tried without it, too.
    """
    known = {(e.id, e.where, e.columns.shape[1]): k for k, e in enumerate(here.entries)}
    taken = [there.entries[k] for k in account.members]
    keys = [(e.id, e.where, e.columns.shape[1]) for e in taken]
    return _exchanged(here, _weighed(here, tuple(known[key] for key in keys if key in known)))


def _closes(problem: Problem, account: _Account) -> bool:
    """Whether no gap is left beyond chance."""
    left = without(account.basis, problem.y)
    df = problem.structure_df - account.basis.shape[1]
    return df > 0 and (
        variance_ratio_p_value(problem.gap(left) / df, df, problem.noise_df) > CLOSED
    )


def _best(among: _Field, most: int) -> _Account:
    """The best account with so many effects or fewer; a few of the best are followed up."""
    start = _weighed(among, ())
    best, beam = start, [start]
    for _ in range(most):
        found = {a.members: a for one in beam for a in _extended(among, one)}
        beam = _heaviest_first(found.values())[:BEAM]
        if not beam:
            break
        best = _heaviest_first([best, beam[0]])[0]
    return _exchanged(among, best)


def _exchanged(among: _Field, best: _Account) -> _Account:
    """One effect after the other left out or replaced, as long as that is better."""
    while True:
        fewer = [_weighed(among, tuple(k for k in best.members if k != m)) for m in best.members]
        others = [a for one in fewer for a in (one, *_extended(among, one))]
        better = _heaviest_first([best, *others])[0]
        if better.log_weight <= best.log_weight + LEAST_GAIN:
            return best
        best = better


def _heaviest_first(accounts: Iterable[_Account]) -> list[_Account]:
    return descending(accounts, lambda one: one.log_weight, LOG_UNIT)


def _extended(among: _Field, one: _Account) -> list[_Account]:
    """One effect more than this account; only the most promising."""
    left = without(one.basis, among.problem.y)
    total = float(left @ left)
    promise = []
    for block in among.blocks:
        explained = squares_in(block, left)
        rest = max(total - explained, 1e-9 * total)
        promise.append(0.5 * among.freedom * math.log(total / rest) - among.width(explained, block))
    order = descending(
        (k for k in range(len(promise)) if k not in one.members), promise.__getitem__
    )
    return [_weighed(among, (*one.members, k), one) for k in order[:WEIGHED]]


def _weighed(among: _Field, members: tuple[int, ...], upon: _Account | None = None) -> _Account:
    """These effects; ``upon`` is the account of all but the last, if there is one."""
    y = among.problem.y
    if not members:
        return _Account((), np.zeros((len(y), 0)), 0.0, -0.5 * among.freedom * math.log(y @ y))
    before = upon or _weighed(among, members[:-1])
    basis = union([before.basis, among.blocks[members[-1]]])
    more = basis[:, before.basis.shape[1] :]
    explained = squares_in(more, y)
    log_prior = before.log_prior + among.width(explained, more) + among.log_prior(members[-1])
    left = without(basis, y)
    weight = -0.5 * among.freedom * math.log(left @ left) - log_prior
    return _Account(tuple(sorted(members)), basis, log_prior, weight)
