"""Mistakes of labels and of single readings: other designs for the same readings.

Every exchange of labels puts readings elsewhere in the table; those of `apart` get zeros of their
own. So each mistake is a session with the same number of readings, and its evidence compares with
that of the session as it is written. Two mistakes that leave the same readings have equal evidence:
both come back, and neither alone is the answer.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np

from calib.arrays import FloatArray, IntArray, Observations, numbered, without_means
from calib.errors import NotIdentifiable
from calib.posterior.apart import LEAST, PRIOR, TRIED, Mistake, Scored, readings_apart
from calib.posterior.cells import Cells
from calib.posterior.exchanges import exchanges
from calib.posterior.problem import SolvedSessions, Way
from calib.posterior.screening import Screen, even_mm
from calib.tripod.effects.effect import Effect
from calib.tripod.movements import departures_mm

LEAST_CHANGED = 3.0
"""Standard deviations of a reading by which an exchange changes at least one."""

MOST = 3
"""Mistakes that are looked for together."""

RACED = 4
"""Of `TRIED` mistakes so many are compared with all that may be true."""

DOUBTED = 5.0
"""Of log evidence below the best: what is less likely than that is not tried."""

HOPELESS = 12.0
"""Of log weight below the best: of such sessions no other machine is tried."""

ROUGH = 20.0
"""The same below no mistake: how far an exchange beside the plain model alone may be off."""

FITS = 1.0
"""Standard deviations of the square sum above what noise leaves up to which labels fit."""

BENT = 50.0
"""Square sum, for each degree of freedom, from which on derivatives may be too far away."""

ALIKE = 3.0
"""Of log likelihood: exchanges that differ by less may be one and the same, but for its prior."""

FITTED = 12
"""Exchanges of tables, and as many of postures, that are fitted then."""

MOST_VALUES = 1_500_000
"""Values of exchanges that are held at once."""


def suspects(solved_sessions: SolvedSessions, number: int, *, depart: bool) -> list[Mistake]:
    """Mistakes of a session by its number that may be likelier than none, the likeliest first.

    They are looked for beside the models of ``solved_sessions``; exchanges beside single names,
    too. So are readings that stand apart where first takes ``depart`` from their repeats, for
    something else explains these.
    """
    now, problem = solved_sessions.way.sessions, solved_sessions.problem
    cells, log_evidence = now[number], solved_sessions.log_evidence
    screens = [Screen(cells_beside) for cells_beside in (*now[:number], *now[number + 1 :])]
    elsewhere = sum(screen.square for screen in screens), sum(screen.freedom for screen in screens)
    screened = partial(Screen, cells, root=even_mm(cells), elsewhere=elsewhere)
    rivals = [(log, screened(columns)) for log, columns in problem.rivals(number, alone=False)]
    scored: list[Scored] = []
    moved: MovedReadings | None = None
    for log_weight, screen in rivals:
        scores = [*readings_apart(screen)]
        fits = screen.freedom + FITS * math.sqrt(2.0 * max(screen.freedom, 0.0))
        # a contact is a place: it has no indicator, sign or unit, and no label beside it
        if screen.square > fits and not cells.visits.contact.any():
            moved = moved or MovedReadings(screen)
            scores += moved.scores(screen)
        scored += [(log_weight + score, mistake) for score, mistake in scores]
    for log_weight, columns in problem.rivals(number, alone=True) if depart else ():
        scores = [*readings_apart(screened(columns))]
        scored += [(log_weight + score, mistake) for score, mistake in scores]
    log_plain, plain = rivals[0]
    if moved is not None:
        scored += moved.beside_one_name(plain, partial(problem.with_one_name, number))
    likeliest: dict[tuple[str, str, str], Scored] = {}
    for score, mistake in sorted(scored, key=lambda entry: -entry[0]):
        likeliest.setdefault((mistake.id, mistake.where, mistake.title), (score, mistake))
    ordered = list(likeliest.values())
    likely = [entry for entry in ordered if entry[0] > log_evidence - DOUBTED][:TRIED]
    if plain.square > BENT * plain.freedom:
        likely = _fitted(plain, ordered, likely, log_plain, log_evidence)
    best = likely[0][0] if likely else 0.0
    return [mistake for score, mistake in likely if score > best - DOUBTED][:RACED]


def _fitted(
    plain: Screen,
    ordered: Sequence[Scored],
    likely: Sequence[Scored],
    log_plain: float,
    log_evidence: float,
) -> list[Scored]:
    """The likely exchanges, and those that are so by their own fit, the likeliest first.

    Where the plain model leaves much, its derivatives are far from where the labels are right.
    """
    postures = [entry for entry in ordered if entry[1].id == "postures_exchanged"]
    tables = [entry for entry in ordered if entry[1].id not in (*LEAST, "postures_exchanged")]
    fitted: list[tuple[float, float, Mistake]] = []
    for score, mistake in dict.fromkeys([*likely, *tables[:FITTED], *postures[:FITTED]]):
        score_of_fit = -math.inf if mistake.id in LEAST else log_plain + _gain(plain, mistake)
        allowed = ROUGH if (score, mistake) in tables else DOUBTED
        if max(score, score_of_fit) > log_evidence - allowed:
            fitted.append((max(score, score_of_fit), score_of_fit, mistake))
    # what fits as well by itself is the same exchange by another name, whatever stood beside it
    alike = {
        id(mistake): max(
            score for score, other_score, _ in fitted if abs(score_of_fit - other_score) < ALIKE
        )
        for _, score_of_fit, mistake in fitted
        if score_of_fit > -math.inf
    }
    best = [(alike.get(id(mistake), score), mistake) for score, _, mistake in fitted]
    return sorted(best, key=lambda entry_of_best: -entry_of_best[0])


def _gain(plain: Screen, mistake: Mistake) -> float:
    """Log likelihood that an exchange adds by its own plain fit, its prior included."""
    right = Cells.of_visits(plain.cells.case, mistake.visits)
    refit = Screen(right, root=plain.root)
    gain = plain.log_likelihood(refit.square) - plain.log_likelihood(plain.square)
    return float(gain) + mistake.log_prior


class MovedReadings:
    """Exchanges of a session that change what is read, and the values ``(n, k)`` of each.

    They are as many as memory has room for at once.
    """

    def __init__(self, screen: Screen) -> None:
        self.visits = visits = screen.cells.visits
        candidates = list(islice(exchanges(visits), MOST_VALUES // max(len(visits), 1)))
        put_right = [exchange.put_right(visits.value_mm) for exchange in candidates]
        values = np.array(put_right).reshape(len(candidates), len(visits)).T
        change = values - visits.value_mm[:, None]
        change = np.abs(without_means(visits.mount, visits.averaged, change)).max(axis=0)
        large = change > LEAST_CHANGED * np.median(screen.root)
        self.every = [candidates[k] for k in np.flatnonzero(large)]
        self.values_mm = values[:, large]
        self.places = Counter(exchange.id for exchange in candidates)

    def scores(self, screen: Screen) -> Iterator[Scored]:
        """Exchanges that leave least, and the log likelihood that each adds, with its prior."""
        squares = (screen.left_of(self.values_mm) ** 2).sum(axis=0)
        gains = screen.log_likelihood(squares) - screen.log_likelihood(screen.square)
        for k in np.argsort(-gains, kind="stable")[: 4 * TRIED].tolist():
            mistake = self._mistake(k)
            yield float(gains[k]) + mistake.log_prior, mistake

    def beside_one_name(
        self, plain: Screen, with_one_name: Callable[[FloatArray], FloatArray]
    ) -> Iterator[Scored]:
        """Exchanges that leave the plain model least, with their log weight beside one name."""
        squares = (plain.left_of(self.values_mm) ** 2).sum(axis=0)
        nearest = np.argsort(squares, kind="stable")[: 2 * TRIED]
        cells = plain.cells
        weight, change = cells.weight / cells.scatter_mm2, self.values_mm[:, nearest].T
        sums = [
            np.bincount(cells.cell, weight * (changed - self.visits.value_mm)) for changed in change
        ]
        change_mm = np.array(sums).T / np.bincount(cells.cell, weight)[:, None]
        log_weights = with_one_name(change_mm)
        for k, log_weight in zip(nearest.tolist(), log_weights.tolist(), strict=True):
            mistake = self._mistake(k)
            yield log_weight + mistake.log_prior, mistake

    def _mistake(self, k: int) -> Mistake:
        exchange, visits = self.every[k], self.visits
        changed = np.zeros(len(visits), dtype=bool)
        changed[exchange.here] = changed[exchange.there] = True
        rows = np.flatnonzero(changed)
        # of each mounting all readings but one tell a unit: its zero is free
        free = len(rows) - np.count_nonzero(np.bincount(visits.mount[rows]))
        log_prior = math.log(PRIOR[exchange.id] / self.places[exchange.id])
        log_prior += free * math.log(abs(exchange.factor))
        source = exchange.source(len(visits))
        mount = _with_values(visits, source)
        right = replace(visits, value_mm=self.values_mm[:, k], mount=mount)
        heading = exchange.id, exchange.where, exchange.words(visits), rows, right, log_prior
        return Mistake(*heading, source, exchange.factor)


def _with_values(visits: Observations, source: IntArray) -> IntArray:
    """Mountings ``(n,)`` where the value of visit i was written at visit ``source[i]``.

    A value that stands apart, in a mounting of its own, does so where it belongs.
    """
    mount = visits.mount
    alone = np.bincount(mount)[mount] == 1
    if not alone.any():
        return mount
    place = numbered(visits.leg, visits.axis, visits.station, visits.over_plane)
    usual = mount.copy()
    for row in np.flatnonzero(alone).tolist():
        mountings = mount[(place == place[row]) & ~alone]
        if len(mountings):
            usual[row] = np.bincount(mountings).argmax()
    apart = visits.mount_count + np.arange(len(mount))
    return numbered(np.where(alone[source], apart, usual))


def with_mistakes(ways: Sequence[Way], effects: Sequence[Effect]) -> list[SolvedSessions]:
    """The sessions as they are, and put right in each way that may be true; the likeliest first.

    The sessions may have come about in several ``ways``; ``effects`` are those of the library. One
    mistake after the other: each is looked for in the readings that the likeliest ones before
    leave, of the likeliest way; what was put right is so in the others, too.
    """
    of_ways = _solved(ways, effects)
    explanations, start = [*of_ways], max(of_ways, key=lambda result: result.log_weight)
    depart = [bool(departures_mm(cells.visits)) for cells in ways[0].sessions]
    best = start
    for _ in range(MOST):
        candidates = []
        for number, cells in enumerate(best.way.sessions):
            for mistake in suspects(best, number, depart=depart[number]):
                right = [*best.way.sessions]
                right[number] = Cells.of_visits(cells.case, mistake.visits)
                mistakes = (*best.way.mistakes, replace(mistake, session=number))
                try:
                    way = replace(best.way, sessions=right, mistakes=mistakes)
                    candidates.append(way.solved(effects))
                except NotIdentifiable:
                    continue
        explanations += candidates
        better = max(candidates, key=lambda result: result.log_weight, default=None)
        if better is None or better.log_weight < best.log_weight:
            break
        best = better
    put_right = best.way.mistakes[len(start.way.mistakes) :]
    for way in (result.way for result in of_ways if put_right and result is not start):
        if _of_same_visits(way, start.way):
            right = [
                Cells.of_visits(cells.case, changed.visits)
                for cells, changed in zip(way.sessions, best.way.sessions, strict=True)
            ]
            way = replace(way, sessions=right, mistakes=(*way.mistakes, *put_right))
            explanations.append(way.solved(effects))
    return sorted(explanations, key=lambda result: -result.log_weight)


def _solved(ways: Sequence[Way], effects: Sequence[Effect]) -> list[SolvedSessions]:
    """What may be true of each way.

    Of several machines the first is the freest: visits that had no chance on it, with the same
    changes between sessions, are not tried on the others.
    """
    solutions: list[SolvedSessions] = []
    for way in ways:
        best = max((result.log_weight for result in solutions), default=0.0)
        alike = (
            result.log_weight
            for result in solutions
            if _of_same_visits(result.way, way) and _of_same_changes(result.way, way)
        )
        if max(alike, default=best) >= best - HOPELESS:
            solutions.append(way.solved(effects))
    return solutions


def _of_same_changes(first: Way, second: Way) -> bool:
    """Whether joint offsets changed alike between sessions."""
    pairs = zip(first.sessions, second.sessions, strict=True)
    return all(a.case.homing_mm == b.case.homing_mm for a, b in pairs)


def _of_same_visits(first: Way, second: Way) -> bool:
    """Whether sessions came about by the same movements and zeros; machines may differ."""
    return all(
        np.array_equal(a.visits.movement, b.visits.movement)
        and np.array_equal(a.visits.mount, b.visits.mount)
        for a, b in zip(first.sessions, second.sessions, strict=True)
    )
