"""Compare, locate, name, verify, propose: the whole diagnosis of one or more sessions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calib.diagnosis.attribution import DOUBT, Attribution, repeats_explain_as_much
from calib.diagnosis.cleaning import Case, clean
from calib.diagnosis.fitting import Fitting
from calib.diagnosis.hypotheses import Hypothesis, entries_of, implausible, log_priors
from calib.diagnosis.model_selection import ModelSelection, Outcome
from calib.diagnosis.outliers import WILD_DISTANCE
from calib.diagnosis.problem import Problem
from calib.diagnosis.report import Report
from calib.diagnosis.results import Diagnosis
from calib.linalg import squares_in
from calib.observations import FloatArray
from calib.tripod.effects.effect import Law

SEED = 20081
MOST_RACES = 3
WORTH_ANOTHER_RACE = 9.0
"""Noise variances that effects do beyond their derivatives before they are looked at again."""


def diagnose(
    cases: Sequence[Case],
    laws: Sequence[Law],
    held_out: Sequence[Case] = (),
    seed: int = SEED,
) -> Diagnosis:
    """Diagnose sessions that share their effects; each has base parameters and zeros of its own.

    ``held_out`` sessions are used for nothing but the gap after adopting. Raises NotIdentifiable
    where a session cannot be fitted at all.
    """
    ready, mistakes = clean(cases, laws)
    problem = first = Problem.of([case.sit() for case in ready])
    every = entries_of(problem, laws)
    blocks = [problem.block(entry.columns) for entry in every]
    seen = [k for k, block in enumerate(blocks) if _may_run(problem, every[k], block)]
    entries = [every[k] for k in seen]
    race = _race(problem, entries, tuple(blocks[k] for k in seen), seed)
    race, outcome = _followed_far_enough(race, entries, ready)
    problem = race.problem
    fitting = Fitting(problem, entries, race, ready)
    naming = Attribution(problem, entries, race, outcome)
    doubts = (DOUBT,) if repeats_explain_as_much(naming) else ()
    if doubts:
        outcome = replace(outcome, kept=None)
        naming = replace(naming, outcome=outcome)
    return Report(first, fitting, naming, outcome, mistakes, held_out, doubts).make()


def _race(
    problem: Problem, entries: Sequence[Hypothesis], blocks: tuple[FloatArray, ...], seed: int
) -> ModelSelection:
    causes = tuple(entry.causes for entry in entries)

    def loss(members: tuple[int, ...]) -> float:
        return implausible(problem, [entries[k] for k in members])

    return ModelSelection(problem, blocks, log_priors(problem, entries), causes, seed, loss)


def _followed_far_enough(
    race: ModelSelection, entries: Sequence[Hypothesis], ready: Sequence[Case]
) -> tuple[ModelSelection, Outcome]:
    """The race once more where large effects do more than their derivatives say.

    What they do beyond would be named as something else.
    """
    outcome = race.run()
    for _ in range(MOST_RACES - 1):
        if outcome.kept is None:
            break
        fitting = Fitting(race.problem, entries, race, ready)
        straight = fitting.as_if_linear(outcome.kept.members)
        if float(((straight.y - race.problem.y) ** 2).sum()) < WORTH_ANOTHER_RACE:
            break
        again = _race(straight, entries, race.blocks, race.seed)
        found = again.run()
        if found.kept is None or not found.adequate:  # followed the wrong way
            break
        race, outcome = again, found
    return race, outcome


def _may_run(problem: Problem, entry: Hypothesis, block: FloatArray) -> bool:
    """What shows at all; a lone reading only where no repeat has judged it, and if it is far off.

    Far off is beyond what heavy tails reach.
    """
    if not block.shape[1] or entry.id != "wild_reading":
        return bool(block.shape[1])
    far = squares_in(block, problem.y) > WILD_DISTANCE**2
    return far and not _repeated(problem, int(entry.columns[:, 0].argmax()))


def _repeated(problem: Problem, row: int) -> bool:
    """Whether the posture of this row was read in the same mounting again."""
    levels = problem.conditions("level")
    alike = (problem.mount == problem.mount[row]) & (levels == levels[row])
    return int(alike.sum()) > 1
