"""Compare, locate, name, verify, propose: the whole diagnosis of one or more sessions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import LEG_NAMES, FloatArray
from calib.diagnosis.attribution import Attribution
from calib.diagnosis.cleaning import clean
from calib.diagnosis.discrepancy import discrepancy
from calib.diagnosis.gap import left_out_postures, locate, on_other_sessions, residuals, where_words
from calib.diagnosis.hypotheses import (
    causes_of,
    hypotheses_of,
    is_known,
    log_priors,
    other_leads_mm,
)
from calib.diagnosis.model_selection import ModelSelection, Outcome
from calib.diagnosis.next_measurement import propose
from calib.diagnosis.pattern import repeats_words, shared_pattern
from calib.diagnosis.policy import POLICY
from calib.diagnosis.problem import Case, FittedSession, Problem
from calib.diagnosis.results import (
    Contender,
    Detectable,
    Diagnosis,
    Finding,
    HeldOutGap,
    ModelDiscrepancy,
    Verdict,
)
from calib.diagnosis.selection import LEAST_LOG, heaviest_first
from calib.errors import NotIdentifiable
from calib.tripod.effects.effect import Effect, EffectInstance, Kind

FAR_OFF = 5.0
"""Tolerances beyond which a joint offset is more likely a mistake in what was entered."""

MOST_CONTENDERS = 20
WITH_NAMES: tuple[Verdict, ...] = ("explained", "ambiguous", "partly-explained")
WITH_RESIDUALS: tuple[Verdict, ...] = ("partly-explained", "unexplained")
NO_LAW = "the rest follows no simple pattern of displacement, approach, time or temperature"
DOUBT = (
    "repeats that did not leave their posture would explain as much as any effect: leave the "
    "posture before each repeat, or measure more"
)
MOST_RIVALS = 5
FOUND_9_OF_10 = 1.28
"""Standard normal quantile of 90 %."""


def diagnose(
    cases: Sequence[Case], effects: Sequence[Effect], held_out: Sequence[Case] = ()
) -> Diagnosis:
    """Diagnose sessions that share their effects; each has base parameters and zeros of its own.

    ``held_out`` sessions are used for nothing but the gap after adopting. Raises NotIdentifiable
    where a session cannot be fitted at all.
    """
    cleaned, mistakes = clean(cases, effects)
    usable = [case.with_readings(one.observed) for case, one in zip(cases, cleaned, strict=True)]
    first = Problem.of([case.fitted() for case in usable])
    selection = ModelSelection.of(first, hypotheses_of(first, effects))
    attribution = Attribution(*_followed_far_enough(selection)).without_nameless()
    found = _Report(first, attribution, mistakes, held_out).make()
    return replace(found, cleaned=tuple(cleaned))


def _followed_far_enough(selection: ModelSelection) -> tuple[ModelSelection, Outcome]:
    """The selection once more where large effects do more than their derivatives say.

    What they do beyond would be named as something else.
    """
    outcome = selection.run()
    for _ in range(POLICY.most_causes - 1):
        if outcome.kept is None:
            break
        problem = selection.problem
        y = selection.refined(outcome.members)[1]
        if float(((y - problem.y) ** 2).sum()) < POLICY.told_apart:
            break
        straight = problem.as_if_linear(y)
        priors = log_priors(straight, selection.candidates)
        again = replace(selection, problem=straight, log_priors=priors)
        found = again.run()
        if found.kept is None or not found.adequate:  # followed the wrong way
            break
        selection, outcome = again, found
    return selection, outcome


@dataclass(eq=False)
class _Report:
    """From the outcome to the answer; ``first`` is the problem as it was measured."""

    first: Problem
    attribution: Attribution
    mistakes: Sequence[Finding]
    held_out: Sequence[Case]

    def __post_init__(self) -> None:
        self.selection = self.attribution.selection
        self.problem = self.selection.problem
        self.candidates = self.selection.candidates
        self.outcome = self.attribution.outcome
        self.members = self.outcome.members

    def make(self) -> Diagnosis:
        """The whole answer."""
        findings = [*self.mistakes, *(self._findings() if self.members else ())]
        verdict, noise = self.verdict, self.problem.fitted_sessions[0].noise
        told = bool(self.held_out) or verdict != "cannot-tell"
        named = [f for f in findings if f.kind == Kind.GROSS_ERROR or verdict in WITH_NAMES]
        placed = tuple(one for finding in findings for one in finding.effects)
        pattern = shared_pattern([*self.first.fitted_sessions, *self.others])
        effect, where = None, ""
        if verdict in WITH_RESIDUALS:
            effect = discrepancy(self.selection, self.members, placed, self.others)
            left = replace(self.problem, y=self.selection.residual(self.members))
            where = where_words(locate(left), POLICY.agreement_level)
        return Diagnosis(
            verdict=verdict,
            sentence=sentence(verdict, findings, where, self.attribution.doubt)
            + (
                repeats_words(pattern) if pattern and verdict not in ("explained", "agrees") else ""
            ),
            noise_mm=self.problem.noise_mm,
            noise_df=self.problem.noise_df,
            noise_source=noise.source if noise else "residuals",
            gap_before=self.selection.gap(()),
            gap_after=self.selection.gap(self.members),
            held_out=self._held_out(placed) if told else None,
            where=locate(self.problem)[:MOST_CONTENDERS],
            effects=tuple(named),
            candidates=self._contenders(),
            next_measurement=propose(verdict, self.attribution),
            smallest_detectable=self._smallest_detectable(),
            residuals=residuals(self.first, self._after(named)),
            remarks=(
                *self._remarks(effect),
                *self._half_seen(),
                *self._leads(),
                *self._far_offsets(),
            ),
            left_over=effect,
            pattern=pattern,
        )

    @cached_property
    def verdict(self) -> Verdict:
        """A mistake that something else imitates does not explain alone."""
        verdict = self.attribution.verdict(mistakes_found=bool(self.mistakes))
        doubtful = any(one.indistinguishable_from for one in self.mistakes)
        return "ambiguous" if doubtful and verdict == "explained" else verdict

    @cached_property
    def others(self) -> list[FittedSession]:
        """The held-out sessions, fitted."""
        return [case.fitted() for case in self.held_out]

    def _after(self, named: Sequence[Finding]) -> FloatArray | None:
        """Whitened residual ``(n,)`` with what was named adopted; None where nothing can be."""
        placed = tuple(effect for finding in named for effect in finding.effects)
        try:
            return self.problem.adopting(placed).y if placed else None
        except NotIdentifiable:
            return None

    def _findings(self) -> list[Finding]:
        """What was kept, the strongest first, each adopted beside those before it."""
        values, _ = self.selection.refined(self.members)
        ordered = self.attribution.by_evidence()
        gaps = [self.selection.gap(ordered[:k]).rms_mm for k in range(len(ordered) + 1)]
        step_p = self.outcome.step_p
        found = []
        for k, member in enumerate(ordered):
            one = self.candidates[member]
            parameters, effects = values[member]
            p = step_p[min(k, len(step_p) - 1)]
            rivals = self.attribution.rivals[member]
            what = one.id, str(one.kind), one.title, one.where
            found.append(Finding(*what, parameters, p, gaps[k], gaps[k + 1], rivals, effects))
        return found

    def _contenders(self) -> tuple[Contender, ...]:
        found: dict[tuple[str, str], Contender] = {}
        before = self.selection.gap(()).rms_mm
        for model in heaviest_first(self.outcome.singles):
            (member,) = model.members
            one = self.candidates[member]
            if (one.id, one.where) in found or one.kind == Kind.EMPIRICAL:
                continue
            parameters, effects = self.selection.values((member,))[member]
            after = self.selection.gap((member,)).rms_mm
            other = (
                on_other_sessions(self.problem, self.others, effects)
                if self.others and effects
                else None
            )
            found[one.id, one.where] = Contender(
                one.id,
                one.where,
                parameters,
                math.exp(max(float(self.outcome.local_log_p[member]), LEAST_LOG)),
                after,
                explained_share(before, after),
                other.after_rms_mm if other else None,
                self._reason(member),
                effects,
            )
            if len(found) == MOST_CONTENDERS:
                break
        return tuple(found.values())

    def _reason(self, member: int) -> str:
        if not self.members:
            return "no better than chance among so many candidates"
        if member in self.members:
            return "" if self.verdict in WITH_NAMES else "best guess"
        if any(member in model.members for model in self.outcome.models):
            return "fits about as well"
        if not self.selection.leaves_no_gap((member,)):
            return "leaves a gap"
        return "another effect explains it better"

    def _held_out(self, placed: tuple[EffectInstance, ...]) -> HeldOutGap | None:
        if self.held_out:
            return on_other_sessions(self.problem, self.others, placed)
        if not self.members:
            return None
        # among what could have been kept in place of one of the members
        most = max(causes_of(self.candidates[k]) for k in self.members)
        effects = [one for one in self.candidates if is_known(one)]
        columns = [one.columns for one in effects if causes_of(one) <= most]
        return left_out_postures(self.problem, columns, len(self.members))

    def _remarks(self, effect: ModelDiscrepancy | None) -> list[str]:
        """What else a person must know."""
        said = []
        if not self.problem.structure_df:
            said.append(
                "offsets and zeros can explain all that these postures show: measure others too"
            )
        elif self.problem.noise_df <= 0.0:
            said.append("no repeats and no stated noise: nothing can be judged against chance")
        if self.verdict == "unexplained":
            said.append(
                "either the effect is not in the catalogue, or the repeats are not independent"
            )
        if self.verdict in WITH_RESIDUALS and not effect:
            said.append(NO_LAW)
        if self.outcome.doubted:
            said.append(DOUBT)
        return said

    def _half_seen(self) -> list[str]:
        """Effects of whose values the readings see combinations only."""
        seen = [(self.candidates[k], self.selection.blocks[k].shape[1]) for k in self.members]
        return [
            f"{one.id} ({one.where}): the readings see {rank} combination(s) of its"
            f" {len(one.parameters)} values; how the values share that is not known"
            for one, rank in seen
            if rank < len(one.parameters)
        ]

    def _leads(self) -> Iterator[str]:
        """Screws of which the readings do not tell the lead."""
        values = self.selection.refined(self.members)[0] if self.members else {}
        for member in self.members:
            others = self.selection.search.basis(tuple(k for k in self.members if k != member))
            leads = other_leads_mm(self.problem, others, values[member][1])
            if leads:
                said = ", ".join(f"{lead:g}" for lead in leads)
                yield (
                    f"{self.candidates[member].id} ({self.candidates[member].where}): leads of"
                    f" {said} mm fit as well; write the screw's lead into the machine file"
                )

    def _far_offsets(self) -> Iterator[str]:
        """Joint offsets that nobody would have left: they count as found, but are told."""
        for one in self.first.fitted_sessions:
            off_mm = np.subtract(one.model.parameters_mm, one.case.model.parameters_mm)
            for leg, off, allowed in zip(LEG_NAMES, off_mm, one.case.tolerance_mm, strict=False):
                if abs(off) > FAR_OFF * allowed:
                    yield (
                        f"the joint offset of {leg} comes out {off:+.1f} mm off, the machine file"
                        f" allows {allowed:g} mm: look how it was entered"
                    )

    def _smallest_detectable(self) -> tuple[Detectable, ...]:
        """Size of each single-parameter effect that would have been found nine times of ten."""
        found: dict[str, Detectable] = {}
        count = max(len(self.candidates), 2)
        threshold = math.sqrt(2.0 * math.log(count / POLICY.agreement_level)) + FOUND_9_OF_10
        for one, block in zip(self.candidates, self.selection.blocks, strict=True):
            if len(one.parameters) != 1 or not is_known(one):
                continue
            column = self.problem.root_weight * one.columns[:, 0]
            slope = float(np.linalg.norm(block.T @ column))
            size = threshold / slope if slope else math.inf
            if math.isfinite(size) and (one.id not in found or size < found[one.id].size):
                found[one.id] = Detectable(one.id, size, one.parameters[0].unit)
        return tuple(found.values())


def explained_share(before_rms_mm: float, after_rms_mm: float) -> float:
    """The part of the gap's square that is gone, between 0 and 1."""
    if before_rms_mm <= 0.0:
        return 0.0
    return min(max(1.0 - (after_rms_mm / before_rms_mm) ** 2, 0.0), 1.0)


def sentence(verdict: Verdict, findings: Sequence[Finding], where: str, doubt: str) -> str:
    """The verdict in one sentence that a machinist understands.

    ``where`` tells where something is left, ``doubt`` why names without rivals are not claimed.
    """
    names = " and ".join(f"{f.title} ({f.where})" for f in findings)
    others = {r.id for f in findings for r in f.indistinguishable_from}
    rivals = sorted("an unnamed effect" if o == Kind.EMPIRICAL else o for o in others)
    if len(rivals) > MOST_RIVALS:
        rivals = [*rivals[: MOST_RIVALS - 1], f"{len(rivals) - MOST_RIVALS + 1} others"]
    return {
        "agrees": "The model explains the readings within their noise; nothing is missing.",
        "explained": f"What was missing is: {names}.",
        "ambiguous": f"Something is missing: {names}"
        + (
            f", or instead {', '.join(rivals)}. These readings cannot decide."
            if rivals
            else f"; {doubt}."
        ),
        "partly-explained": f"Part of what is missing: {names}. The rest: {where}.",
        "unexplained": f"Something is missing, {where}. No known effect explains it.",
        "cannot-tell": "The readings are too few to say what is missing"
        + (f"; best guess: {names}." if names else "."),
    }[verdict]
