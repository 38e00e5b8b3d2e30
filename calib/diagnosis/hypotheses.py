"""Who runs in the race: the catalogue at every place, and lone readings that may be wild."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.problem import Problem
from calib.linalg import BLIND
from calib.observations import LEG_NAMES, TOUCHED_LETTERS, FloatArray, rows_of
from calib.tripod.effects.candidates import Candidate, candidates_together
from calib.tripod.effects.effect import Kind, Law

FAR = 30.0
"""A parameter so many times its unremarkable size costs as much as one standard deviation."""

MOST_LOSS = 200.0
"""What a candidate's own size may cost; a model's sizes together cost without limit."""

ALL = "all"


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A runner in the race: a candidate of the catalogue or a lone wild reading."""

    id: str
    kind: str
    title: str
    where: str
    columns: FloatArray
    candidate: Candidate | None
    names: tuple[tuple[str, str], ...]
    tolerance: FloatArray

    @property
    def way(self) -> tuple[str, str, str]:
        """Name, place and arrangement."""
        return self.id, self.where, self.candidate.arrangement if self.candidate else "one"

    @property
    def causes(self) -> int:
        """How many things are wrong at once: axes, bars, indicators with values of their own."""
        if self.candidate is None or self.candidate.arrangement != "each":
            return 1
        if self.kind == Kind.ENVIRONMENT:
            return 1
        if self.kind == Kind.INDICATOR:
            return len(self.candidate.shares)
        return 1 + self.where.count(",")


def entries_of(problem: Problem, laws: Sequence[Law]) -> list[Hypothesis]:
    """Every candidate that the sessions can show, stacked over them, and lone wild readings."""
    sessions = [(one.model, one.observed) for one in problem.fitted_sessions]
    found = [
        Hypothesis(
            candidate.id,
            str(candidate.kind),
            candidate.title,
            candidate.where,
            candidate.columns,
            candidate,
            tuple((p.name, p.unit) for p in candidate.parameters),
            np.array([p.tolerance for p in candidate.parameters]),
        )
        for candidate in candidates_together(sessions, laws)
    ]
    return [*found, *(_lone_readings(problem) if problem.has_repeats() else ())]


def log_priors(problem: Problem, entries: Sequence[Hypothesis]) -> FloatArray:
    """What each candidate costs in log weight ``(J,)``: to be chosen, and for its size."""
    sizes = [min(implausible(problem, [entry]), MOST_LOSS) for entry in entries]
    return np.asarray(chosen(entries) + np.array(sizes))


def chosen(entries: Sequence[Hypothesis]) -> FloatArray:
    """What it costs to choose each ``(J,)``, every cause of it anew, before any reading.

    All effects are equally likely; then whether one part errs or identical parts err alike; then
    which, and in which arrangement. Variants, such as screws of other leads, count as one.
    """
    simple = {entry.way for entry in entries if entry.causes == 1}
    ways = Counter((name, where == ALL) for name, where, _ in simple)
    kinds = Counter(name for name, _ in ways)
    effects = len({entry.id for entry in entries})
    choices = [
        effects * max(kinds[entry.id], 1) * max(ways[entry.id, entry.where == ALL], 1)
        for entry in entries
    ]
    causes = [entry.causes for entry in entries]
    return np.asarray(np.array(causes) * np.log(np.array(choices, dtype=np.float64)))


def implausible(problem: Problem, entries: Sequence[Hypothesis]) -> float:
    """What candidates lose for the sizes that they would need together, in log weight.

    A normal prior on each parameter, thirty times the unremarkable size wide: a fit that needs more
    pays, and directions that hardly show are not blown up.
    """
    columns = np.hstack([entry.columns * (FAR * entry.tolerance) for entry in entries])
    white = problem.free(columns)
    free = problem.y - white @ np.linalg.lstsq(white, problem.y, rcond=BLIND)[0]
    value = held(white, problem.y)[0]
    left = problem.y - white @ value
    loss = 0.5 * (float(left @ left) - float(free @ free) + float(value @ value))
    return float(max(loss, 0.0))


def held(white: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares with a unit normal prior: values ``(k,)`` and what each reading adds."""
    inverse = np.linalg.solve(white.T @ white + np.eye(white.shape[1]), white.T)
    return np.asarray(inverse @ y), np.asarray(inverse)


def _lone_readings(problem: Problem) -> list[Hypothesis]:
    """The first and the last reading of each mounting, which repeats alone cannot judge."""
    found = []
    leg, axis = problem.conditions("leg"), problem.conditions("axis")
    for rows in rows_of(problem.mount):
        where = TOUCHED_LETTERS[leg[rows[0]]] + LEG_NAMES[axis[rows[0]]]
        for row, word in ((rows[0], "first"), (rows[-1], "last")):
            columns = np.zeros((len(problem.y), 1))
            columns[row, 0] = 1.0
            title = f"the {word} reading of this mounting is wild"
            shift = (("shift", "mm"),)
            found.append(
                Hypothesis(
                    "wild_reading", "blunder", title, where, columns, None, shift, np.ones(1)
                )
            )
    return found
