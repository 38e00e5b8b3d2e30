"""From the outcome of the race to the answer: findings, verdict, gaps, remarks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.diagnosis.attribution import Attribution
from calib.diagnosis.cleaning import Case, Mistake
from calib.diagnosis.discrepancy import left_over
from calib.diagnosis.fitting import Fitting
from calib.diagnosis.hypotheses import Hypothesis
from calib.diagnosis.locate import left_over_words, locate
from calib.diagnosis.model_selection import LEVEL, ModelSelection, Outcome
from calib.diagnosis.next_measurement import propose
from calib.diagnosis.outliers import belongs_elsewhere
from calib.diagnosis.problem import FittedSession, Problem
from calib.diagnosis.residuals import residuals
from calib.diagnosis.results import (
    Contender,
    Detectable,
    Diagnosis,
    Finding,
    Gap,
    HeldOutGap,
    ModelDiscrepancy,
    Verdict,
)
from calib.diagnosis.selection import WeighedModel, heaviest_first
from calib.diagnosis.verify import left_out_postures, on_other_sessions, structure_rms_mm
from calib.errors import NotIdentifiable
from calib.observations import FloatArray
from calib.tripod.effects.effect import EffectInstance

MOST_CONTENDERS = 20
WITH_NAMES: tuple[Verdict, ...] = ("explained", "ambiguous", "partly-explained")
LEAST_LOG = -690.0


@dataclass(eq=False)
class Report:
    """From the outcome of the race to the answer; ``first`` is the problem as it was measured."""

    first: Problem
    fitting: Fitting
    naming: Attribution
    outcome: Outcome
    mistakes: Sequence[Mistake]
    held_out: Sequence[Case]
    doubts: tuple[str, ...]
    _others: list[FittedSession] = field(default_factory=list)

    @property
    def problem(self) -> Problem:
        """What was diagnosed."""
        return self.fitting.problem

    def make(self) -> Diagnosis:
        """The whole answer."""
        kept = self.outcome.kept
        findings = [_of_mistake(one) for one in self.mistakes]
        if kept is not None:
            findings += self._findings(kept)
        verdict = self._verdict
        shares = locate(self.problem)
        told = bool(self.held_out) or verdict != "cannot-tell"
        noise = self.problem.fitted_sessions[0].noise
        named = [f for f in findings if f.kind == "blunder" or verdict in WITH_NAMES]
        left = self._left_over(verdict, findings)
        return Diagnosis(
            verdict=verdict,
            sentence=sentence(verdict, findings, self._left_where(kept), self.naming.doubt),
            noise_mm=float(np.sqrt(np.mean(self.problem.root_weight**-2.0))),
            noise_df=self.problem.noise_df,
            noise_source=noise.source if noise else "residuals",
            gap_before=self._gap(()),
            gap_after=self._gap(kept.members if kept else ()),
            held_out=self._held_out(findings) if told else None,
            where=shares[:MOST_CONTENDERS],
            effects=tuple(named),
            candidates=self._contenders(kept),
            next_measurement=propose(verdict, kept, self.naming, self.fitting),
            smallest_detectable=smallest_detectable(
                self.problem, self.fitting.entries, self.fitting.race
            ),
            residuals=residuals(self.first, self._after(named)),
            remarks=(
                *remarks(self.problem, verdict, left),
                *self.doubts,
                *(self._half_seen(kept) if kept else ()),
            ),
            left_over=left,
        )

    def _after(self, named: Sequence[Finding]) -> FloatArray | None:
        """Whitened residual ``(n,)`` with what was named adopted; None where nothing can be."""
        placed = tuple(effect for finding in named for effect in finding.effects)
        try:
            return self.fitting.left_with(placed) if placed else None
        except NotIdentifiable:
            return None

    def _half_seen(self, kept: WeighedModel) -> tuple[str, ...]:
        """Effects of whose values the readings see combinations only."""
        seen = [(self.fitting.entries[k], self.fitting.race.blocks[k]) for k in kept.members]
        return tuple(
            f"{entry.id} ({entry.where}): the readings see {block.shape[1]} combination(s) of its"
            f" {entry.columns.shape[1]} values; how the values share that is not known"
            for entry, block in seen
            if block.shape[1] < entry.columns.shape[1]
        )

    def _left_where(self, kept: WeighedModel | None) -> str:
        """Where what is left shows, in words."""
        members = kept.members if kept else ()
        left = replace(self.problem, y=self.fitting.race.left(members))
        return left_over_words(locate(left), LEVEL)

    def _left_over(self, verdict: Verdict, findings: Sequence[Finding]) -> ModelDiscrepancy | None:
        """The unnamed law of what is left, where something is."""
        if verdict not in ("partly-explained", "unexplained"):
            return None
        members = self.outcome.kept.members if self.outcome.kept else ()
        placed = tuple(effect for finding in findings for effect in finding.effects)
        return left_over(self.fitting, members, placed, self.others())

    @cached_property
    def _verdict(self) -> Verdict:
        """A mistake that something else imitates does not explain alone."""
        verdict = self.naming.verdict(bool(self.mistakes))
        doubtful = any(one.blunder.or_else for one in self.mistakes)
        return "ambiguous" if doubtful and verdict == "explained" else verdict

    def _gap(self, members: tuple[int, ...]) -> Gap:
        race = self.fitting.race
        return Gap(structure_rms_mm(self.problem, race.left(members)), *race.gap(members))

    def _findings(self, kept: WeighedModel) -> list[Finding]:
        values = self.fitting.refined(kept.members)
        rivals = self.naming.names(kept)
        before = self._gap(()).rms_mm
        found = []
        for place, member in enumerate(self.naming.by_evidence(kept)):
            entry = self.fitting.entries[member]
            after = self._gap(self.naming.by_evidence(kept)[: place + 1]).rms_mm
            p = self.outcome.step_p[min(place, len(self.outcome.step_p) - 1)]
            name, title = self._label(entry)
            found.append(
                Finding(
                    name,
                    entry.kind,
                    title,
                    entry.where,
                    values[member][0],
                    p,
                    before,
                    after,
                    rivals[member],
                    values[member][1],
                )
            )
            before = after
        return found

    def _label(self, entry: Hypothesis) -> tuple[str, str]:
        """A lone wild reading may be one under a wrong label."""
        if entry.id != "wild_reading":
            return entry.id, entry.title
        single = int(entry.columns[:, 0].argmax())
        observed = self.problem.fitted_sessions[0].observed
        belongs = belongs_elsewhere(observed, single) if single < len(observed) else None
        if belongs is None:
            return entry.id, entry.title
        return "label_error", f"{entry.title}: it belongs to {belongs}"

    def _contenders(self, kept: WeighedModel | None) -> tuple[Contender, ...]:
        found: dict[tuple[str, str], Contender] = {}
        before = self._gap(()).rms_mm
        for model in heaviest_first(self.outcome.singles):
            member = model.members[0]
            entry = self.fitting.entries[member]
            if (entry.id, entry.where) in found:
                continue
            parameters, placed = self.fitting.values((member,))[member]
            after = self._gap((member,)).rms_mm
            found[entry.id, entry.where] = Contender(
                entry.id,
                entry.where,
                parameters,
                math.exp(max(float(self.outcome.local_log_p[member]), LEAST_LOG)),
                after,
                explained_share(before, after),
                self._held_out_of(placed),
                self._reason(kept, member),
                placed,
            )
            if len(found) == MOST_CONTENDERS:
                break
        return tuple(found.values())

    def _held_out_of(self, placed: tuple[EffectInstance, ...]) -> float | None:
        if not self.held_out or not placed:
            return None
        found = on_other_sessions(self.others(), placed, self.held_out[0].tolerance_mm)
        return found.after_rms_mm if found else None

    def others(self) -> list[FittedSession]:
        """The held-out sessions, fitted once."""
        if not self._others:
            self._others = [case.sit() for case in self.held_out]
        return self._others

    def _reason(self, kept: WeighedModel | None, member: int) -> str:
        if kept is None:
            return "no better than chance among so many candidates"
        if member in kept.members:
            return "" if self._verdict in WITH_NAMES else "best guess"
        if any(member in model.members for model in self.outcome.models):
            return "fits about as well"
        if self.fitting.race.gap((member,))[2] <= LEVEL:
            return "leaves a gap"
        return "another one explains it with more weight"

    def _held_out(self, findings: Sequence[Finding]) -> HeldOutGap | None:
        placed = tuple(effect for finding in findings for effect in finding.effects)
        if self.held_out:
            return on_other_sessions(self.others(), placed, self.held_out[0].tolerance_mm)
        if self.outcome.kept is None:
            return None
        return left_out_postures(
            self.problem,
            self._columns_of_as_many_causes(self.outcome.kept),
            len(self.outcome.kept.members),
            self.fitting.cases[0].tolerance_mm,
        )

    def _columns_of_as_many_causes(self, kept: WeighedModel) -> list[FloatArray]:
        """Columns of what could have been kept in place of one of its members."""
        most = max(self.fitting.entries[k].causes for k in kept.members)
        return [e.columns for e in self.fitting.entries if e.kind != "blunder" and e.causes <= most]


def _of_mistake(mistake: Mistake) -> Finding:
    blunder = mistake.blunder
    before, after = mistake.before_rms_mm, mistake.after_rms_mm
    return Finding(
        blunder.id,
        "blunder",
        blunder.title,
        blunder.where,
        (),
        0.0,
        before,
        after,
        blunder.or_else,
    )


def explained_share(before_rms_mm: float, after_rms_mm: float) -> float:
    """The part of the gap's square that is gone, between 0 and 1."""
    if before_rms_mm <= 0.0:
        return 0.0
    return min(max(1.0 - (after_rms_mm / before_rms_mm) ** 2, 0.0), 1.0)


NO_LAW = "what is left follows no simple law of displacement, approach, time or temperature"
MOST_RIVALS = 5
FOUND_9_OF_10 = 1.28
"""Standard normal quantile of 90 %."""


def sentence(verdict: Verdict, findings: Sequence[Finding], where: str, doubt: str) -> str:
    """The verdict in one sentence that a machinist understands.

    ``where`` tells where something is left, ``doubt`` why names without rivals are not claimed.
    """
    names = " and ".join(f"{f.title} ({f.where})" for f in findings)
    rivals = sorted({r.id for f in findings for r in f.indistinguishable_from})
    if len(rivals) > MOST_RIVALS:
        rivals = [*rivals[: MOST_RIVALS - 1], f"{len(rivals) - MOST_RIVALS + 1} others"]
    return {
        "agrees": "The model explains the readings within their noise; nothing is missing.",
        "explained": f"What was missing is: {names}.",
        "ambiguous": f"Something is missing: {names}"
        + (f", or else {', '.join(rivals)}; these data cannot tell." if rivals else f"; {doubt}."),
        "partly-explained": f"Part of what is missing is {names}; more is left, {where}.",
        "unexplained": f"Something real is missing, {where}, and no known effect explains it.",
        "cannot-tell": "The readings are too few to tell what is missing"
        + (f"; the best guess is {names}." if names else "."),
    }[verdict]


def remarks(
    problem: Problem, verdict: Verdict, left_over: ModelDiscrepancy | None
) -> tuple[str, ...]:
    """What else a person must know."""
    said = []
    if problem.noise_df <= 0.0:
        said.append("no repeats and no stated noise: nothing can be judged against chance")
    if verdict == "unexplained":
        said.append("either the effect is not in the catalogue, or the repeats are not independent")
    if verdict in ("unexplained", "partly-explained"):
        said += [] if left_over else [NO_LAW]
    return tuple(said)


def smallest_detectable(
    problem: Problem, entries: Sequence[Hypothesis], race: ModelSelection
) -> tuple[Detectable, ...]:
    """Size of each single-parameter effect that would have been found nine times of ten."""
    found: dict[str, Detectable] = {}
    threshold = math.sqrt(2.0 * math.log(max(len(entries), 2) / LEVEL)) + FOUND_9_OF_10
    for entry, block in zip(entries, race.blocks, strict=True):
        if entry.columns.shape[1] != 1 or entry.kind == "blunder":
            continue
        slope = float(np.linalg.norm(block.T @ (problem.root_weight * entry.columns[:, 0])))
        size = threshold / slope if slope else math.inf
        if math.isfinite(size) and (entry.id not in found or size < found[entry.id].size):
            found[entry.id] = Detectable(entry.id, size, entry.names[0][1])
    return tuple(found.values())
