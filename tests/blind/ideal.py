"""The least to expect from readings: what who knows all but the hidden names would correct.

The ideal judge knows the bench's own machine, its noise, how many effects act, with which shares
effects, places and strengths are drawn, and which readings are gross mistakes. It does not know
which effects act. Every model that the bench could have drawn is weighed by its evidence, and the
controller sends the mean of the joints that the weighted machines ask for: of all commands the one
with the least expected square of the tool's error, to first order. Where it leaves much more than
`corrections.fitted`, the readings do not show which effect it is.

Machines drawn from what it weighs give the tightest bound that is right for the bench as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from tests.blind.claims import Claim, detection_sizes
from tests.blind.effects import Candidate, Direction, candidates, visible
from tests.blind.forward import FloatArray, Hidden, readings
from tests.blind.generator import place_share, settings_of
from tests.blind.signatures import BASE, Columns

if TYPE_CHECKING:
    from tests.blind.tool import Commanded

ROUNDS = 4
"""Of Gauss and Newton."""

LEAST = 14.0
"""Models whose evidence is smaller by so many units of its logarithm are left out."""

MOST, LEAST_SHARE = 150, 2e-3
"""Models that are refitted, and the share from which one is kept: with 250 models 23 sessions of
two effects had 0.0086 mm left instead of 0.0087."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Offsets, bars and sizes ``(n,)``, and a root ``(n, n)`` of their covariance."""

    values: FloatArray
    root: FloatArray
    log_evidence: float


@dataclass(frozen=True)
class Model:
    """Effects that may act, each with the strength that is drawn; ``log_prior`` of all of it."""

    effects: tuple[Candidate, ...]
    strengths: tuple[float, ...]
    log_prior: float

    @property
    def lead_mm(self) -> float:
        return next((c.lead_mm for c in self.effects if c.id == "actuator_cyclic"), 5.0)

    @cached_property
    def directions(self) -> list[Direction]:
        return [visible(direction) for each in self.effects for direction in each.directions]


class Judge:
    """One session, weighed; ``spread`` ``(6,)`` mm is that of joint offsets and bars."""

    def __init__(self, session: Claim, values_mm: FloatArray, spread: FloatArray) -> None:
        self._session, self._values, self._spread = session, values_mm, spread
        self._plain = Hidden(Hidden().amounts, 5.0, *settings_of(session.hidden))
        self._sizes: dict[Candidate, FloatArray] = {}
        self._start = np.zeros(6)
        self._start = self._refined(Model((), (), 0.0)).values
        columns = Columns(session.rows, self.machine(Model((), (), 0.0), self._start))
        for candidate in candidates():
            sizes = detection_sizes(columns, candidate, session.noise_mm)
            if np.all(np.isfinite(sizes)):
                self._sizes[candidate] = sizes
        self._columns = columns

    def weighted(self, count: int, strengths: Sequence[float]) -> list[tuple[float, Model, Fit]]:
        """Every model of so many effects that has a share: the share, the model, its fit."""
        likely = self._likely(list(self._models(count, strengths)))
        fits = [(model, self._refined(model)) for model in likely]
        logs = np.array([fit.log_evidence + model.log_prior for model, fit in fits])
        shares = np.exp(logs - logs.max())
        shares /= shares.sum()
        kept = [
            (float(share), model, fit)
            for share, (model, fit) in zip(shares, fits, strict=True)
            if share > LEAST_SHARE
        ]
        total = sum(share for share, _, _ in kept)
        return [(share / total, model, fit) for share, model, fit in kept]

    def drawn(
        self, weighted: Sequence[tuple[float, Model, Fit]], count: int, rng: np.random.Generator
    ) -> Iterator[Hidden]:
        """So many machines that may be the hidden one, each as often as it is likely."""
        shares = np.array([share for share, _, _ in weighted])
        for k in rng.choice(len(weighted), size=count, p=shares / shares.sum()):
            _, model, fit = weighted[k]
            yield self.machine(model, fit.values + fit.root @ rng.standard_normal(len(fit.values)))

    def _models(self, count: int, strengths: Sequence[float]) -> Iterator[Model]:
        for effects in combinations(self._sizes, count):
            if len({each.id for each in effects}) == count:
                log_prior = float(sum(np.log(place_share(each)) for each in effects))
                for drawn in product(strengths, repeat=count):
                    yield Model(effects, drawn, log_prior)

    def _likely(self, models: Sequence[Model]) -> list[Model]:
        """By the evidence of all of them with derivatives of the machine without effects."""
        columns = self._columns
        residual = self._values - readings(self._session.rows, columns.hidden)
        base = columns.base[:, : len(BASE)]
        zeros = np.linalg.qr(columns.base[:, len(BASE) :])[0]
        wide = base * (self._spread / self._session.noise_mm)
        vectors, size, _ = np.linalg.svd(wide - zeros @ (zeros.T @ wide), full_matrices=False)
        shrink = (1.0 / np.hypot(1.0, size) - 1.0)[:, None]

        def white(values: FloatArray) -> FloatArray:
            inside = (values - zeros @ (zeros.T @ values)) / self._session.noise_mm
            return np.asarray(inside + vectors @ (shrink * (vectors.T @ inside)))

        seen = white((residual + base @ self._start)[:, None])[:, 0]
        shapes = {c: white(columns.raw(c)) * self._sizes[c] for c in self._sizes}
        logs = []
        for model in models:
            pairs = zip(model.effects, model.strengths, strict=True)
            design = np.hstack([np.empty((len(seen), 0)), *(shapes[c] * s for c, s in pairs)])
            logs.append(model.log_prior + _fit(design, seen).log_evidence)
        order = np.argsort(logs)[::-1][:MOST]
        return [models[k] for k in order if logs[k] > max(logs) - LEAST]

    def _refined(self, model: Model) -> Fit:
        """By Gauss and Newton, with the evidence where they end."""
        rows, noise = self._session.rows, self._session.noise_mm
        sizes = [self._sizes[c] * s for c, s in zip(model.effects, model.strengths, strict=True)]
        spread = np.concatenate([self._spread, *sizes])
        values = np.concatenate([self._start, np.zeros(len(spread) - len(BASE))])
        fit = Fit(values, np.diag(spread), 0.0)
        for _ in range(ROUNDS):
            machine = self.machine(model, fit.values)
            columns = Columns(rows, machine)
            moved = [columns.direction(d, model.lead_mm) for d in model.directions]
            design = np.column_stack([columns.base[:, : len(BASE)], *moved])
            seen = self._values - readings(rows, machine) + design @ fit.values
            zeros = np.linalg.qr(columns.base[:, len(BASE) :])[0]
            design, seen = ((v - zeros @ (zeros.T @ v)) / noise for v in (design, seen))
            unit = _fit(design * spread, seen)
            fit = Fit(unit.values * spread, unit.root * spread[:, None], unit.log_evidence)
        return fit

    def machine(self, model: Model, values: FloatArray) -> Hidden:
        """The bench's machine with these offsets, bars and sizes ``(n,)``."""
        plain = Hidden(self._plain.amounts, model.lead_mm, *settings_of(self._plain))
        base: list[Direction] = [((entry, 1.0),) for entry in BASE]
        pairs = zip((*base, *model.directions), values.tolist(), strict=True)
        return plain.plus([(e, weight * size) for d, size in pairs for e, weight in d])


def _fit(design: FloatArray, seen: FloatArray) -> Fit:
    """Of values ``(n,)`` with unit noise, by coefficients of unit spread."""
    factor = np.linalg.cholesky(np.eye(design.shape[1]) + design.T @ design)
    reached = np.linalg.solve(factor, design.T @ seen)
    log_evidence = 0.5 * float(reached @ reached - seen @ seen) - float(
        np.log(np.diag(factor)).sum()
    )
    root = np.linalg.inv(factor).T
    return Fit(root @ reached, root, log_evidence)


def mean_of(commands: Sequence[tuple[float, Commanded]]) -> Commanded:
    """The joints that weighted commands ask for, on average."""
    return lambda tool_mm, way: np.asarray(
        sum(share * command(tool_mm, way) for share, command in commands)
    )
