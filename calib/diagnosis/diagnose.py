"""Compare, locate, name, verify: what a posterior says of one or more sessions in words."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from calib.arrays import (
    LEG_NAMES,
    TOUCHED_LETTERS,
    FloatArray,
    IntArray,
    descending,
    numbered,
    without,
    without_means,
)
from calib.diagnosis.claims import NAMES, WITHIN, Claims, NamedVerdict, name_of
from calib.diagnosis.gap import AGREEMENT, Leftover, locate, residuals, where_words
from calib.diagnosis.held_out import left_out_postures, on_other_sessions
from calib.diagnosis.pattern import repeats_words, shared_pattern
from calib.diagnosis.results import (
    CleanedReadings,
    Contender,
    Detectable,
    Diagnosis,
    EffectName,
    Finding,
    HeldOutGap,
    LikelyName,
    ModelDiscrepancy,
    Value,
    Verdict,
)
from calib.diagnosis.thresholds import EVEN, MISSING
from calib.errors import CalibrationError
from calib.noise.reading import still_rows
from calib.posterior.apart import Mistake
from calib.posterior.cells import Cells, SessionCase
from calib.posterior.models import Posterior
from calib.posterior.readings import LENGTHS, depends_on_time
from calib.posterior.selection import LOG_SCALES, SCALES, log_causes
from calib.stats import UNLIKELY, mixture_moments
from calib.tripod.effects.drives import ActuatorCyclic
from calib.tripod.effects.effect import EffectInstance, Kind
from calib.tripod.effects.empirical import EMPIRICAL

BARS_DIFFER = "the bars are not those of the first session: diagnose the sessions one at a time"
"""Of the component that is no law: bars of other lengths."""

FAR_OFF = 5.0
"""Tolerances beyond which a joint offset is more likely a mistake in what was entered."""

MOST_CONTENDERS = 20
MOST_RIVALS = 5
WITH_NAMES: tuple[Verdict, ...] = ("explained", "ambiguous", "partly-explained")
WITH_RESIDUALS: tuple[Verdict, ...] = ("ambiguous", "partly-explained", "unexplained")
NO_LAW = "no simple law of travel is likelier for the rest than an error of each posture's own"

SEEN_9_OF_10 = 1.28
"""Standard normal quantile of 90 %."""

NO_SIZE = 100.0
"""Unremarkable sizes: no machine has so much, nor more than the limit of a parameter. What would
show from there on only is not shown, as the gain of an indicator that hardly moves."""

AS_GOOD = 0.01
"""Weight beside the best from which another lead of a screw fits as well."""


def diagnosis_of(posterior: Posterior, held_out: Sequence[SessionCase] = ()) -> Diagnosis:
    """What a mechanic is to know of sessions that share their effects.

    Each has zeros of its own. ``held_out`` sessions are used for nothing but the gap after
    adopting. Raises NotIdentifiable where one of these cannot be fitted.
    """
    return _Report(posterior, Cells.of_all(held_out) if held_out else []).make()


def verdict_of(posterior: Posterior) -> Verdict:
    """The verdict of `diagnosis_of` alone, before names are adopted."""
    return _Report(posterior, ()).answer.verdict


class _Report:
    """The way from the weights of models to the answer."""

    def __init__(self, posterior: Posterior, held_out_sessions: Sequence[Cells]) -> None:
        self.posterior, self.others = posterior, held_out_sessions
        self.components = posterior.components
        self.claims = Claims.of(posterior)
        laws = (share.effect for component in self.components for share in component.shares)
        self.timed = tuple(filter(depends_on_time, dict.fromkeys(laws)))
        self.sessions = [cells.with_free_lines for cells in posterior.sessions]
        self.before = Leftover.of(self.sessions, (), self.timed)
        self.answer = self._checked(self.claims.answer())

    def _checked(self, answer: NamedVerdict) -> NamedVerdict:
        """What is left has a say where it is beyond chance, or nothing.

        Where nothing is free or no noise is known all is a guess; so are names that take all.
        """
        if not self.before.freedom or self.before.noise_freedom <= 0.0:
            return replace(answer, verdict="cannot-tell")
        if answer.verdict == "agrees" and self.before.gap().p_value < UNLIKELY:
            return replace(answer, verdict="unexplained")
        all_names = {name_of(component) for component in self.components}
        names = [name for name in answer.rivals if name in all_names]
        columns = [self._columns(self._acting(name)) for name in names]
        if not names:
            return answer
        directions = self.before.explained_by(np.hstack(columns)).shape[1]
        return (
            answer if directions < self.before.freedom else replace(answer, verdict="cannot-tell")
        )

    def make(self) -> Diagnosis:
        """The whole answer."""
        findings = self._findings()
        adopted = tuple(effect for finding in findings for effect in finding.effects)
        leftover = self._with(adopted) if adopted else None
        if leftover and leftover.gap().p_value < UNLIKELY and self.answer.verdict == "explained":
            self.answer = replace(self.answer, verdict="partly-explained")
        pattern = shared_pattern([*self.posterior.sessions, *self.others])
        left_over, where = self._left_over(adopted, leftover), ""
        gap = self.before.gap()
        parts = locate(self.before)
        verdict, detectable = self.answer.verdict, self._smallest_detectable()
        if verdict in ("partly-explained", "unexplained"):
            where = where_words(locate(leftover) if leftover else parts)
        repeats = pattern is not None and verdict not in ("explained", "agrees")
        mistakes = self.posterior.models[0].mistakes
        return Diagnosis(
            verdict=verdict,
            sentence=sentence(verdict, findings, where)
            + (repeats_words(pattern) if pattern and repeats else ""),
            missing=self.claims.missing,
            something_else=self.claims.unnamed,
            names=tuple(LikelyName(*entry) for entry in self.claims.ids.items()),
            gap_before=gap,
            gap_after=leftover.gap() if leftover else gap,
            held_out=self._held_out(adopted, leftover),
            where=parts[:MOST_CONTENDERS],
            effects=tuple(
                f for f in findings if f.kind == Kind.GROSS_ERROR or verdict in WITH_NAMES
            ),
            candidates=tuple(self._contenders()),
            smallest_detectable=tuple(filter(None, detectable.values())),
            not_shown=tuple(name for name, smallest in detectable.items() if smallest is None),
            residuals=residuals(self.before, leftover),
            remarks=tuple(self._remarks(left_over)),
            left_over=left_over,
            pattern=pattern,
            cleaned=tuple(
                _put_right(cells.case, [m for m in mistakes if m.session == k])
                for k, cells in enumerate(self.posterior.sessions)
            ),
        )

    def _findings(self) -> list[Finding]:
        """What is named, mistakes of the readings first, each adopted beside those before it."""
        mistakes = {
            EffectName(m.id, m.where): m for model in self.posterior.models for m in model.mistakes
        }
        before_mm = self.before.rms_mm(self.before.left)
        findings: list[Finding] = []
        adopted: tuple[EffectInstance, ...] = ()
        for name in sorted(self.answer.rivals, key=lambda name: name not in mistakes):
            likely, rivals = self.claims.places[name], self.answer.rivals[name]
            if name in mistakes:
                heading = name.id, str(Kind.GROSS_ERROR), mistakes[name].title, name.where
                gaps_mm = self._gap_as_read_mm, before_mm
                finding = Finding(*heading, (), likely, *gaps_mm, rivals)
            else:
                finding = self._finding(self._acting(name), likely, adopted, before_mm, rivals)
            findings.append(finding)
            adopted, before_mm = (*adopted, *finding.effects), finding.gap_rms_after_mm
        return findings

    @cached_property
    def _gap_as_read_mm(self) -> float:
        """The gap of the sessions as written; all that they read where they fit no machine."""
        cells_of_sessions = [Cells.of(cells.case) for cells in self.posterior.sessions]
        try:
            leftover = Leftover.of(cells_of_sessions, (), self.timed)
        except CalibrationError:
            means = [cells.means for cells in cells_of_sessions]
            off = [without_means(m.mount, m.averaged, m.value_mm) for m in means]
            return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
        return leftover.rms_mm(leftover.left)

    def _finding(
        self,
        numbers: tuple[int, ...],
        probability: float,
        adopted: tuple[EffectInstance, ...],
        before_mm: float,
        rivals: tuple[EffectName, ...] = (),
    ) -> Finding:
        """Components of one name beside what is adopted."""
        component = self.components[numbers[0]]
        parameters, effects = self._values(numbers)
        leftover = self._with((*adopted, *effects))
        after_mm = leftover.rms_mm(leftover.left) if leftover else before_mm
        kind, title = str(Kind.GROSS_ERROR), BARS_DIFFER
        if component.candidate:
            kind, title = str(component.candidate.kind), component.candidate.title
        heading = component.id, kind, title, component.where
        return Finding(*heading, parameters, probability, before_mm, after_mm, rivals, effects)

    def _with(self, effects: tuple[EffectInstance, ...]) -> Leftover | None:
        """What is left with these adopted; None where they put the machine out of its own reach."""
        try:
            return Leftover.of(self.sessions, effects, self.timed)
        except CalibrationError:
            return None

    def _acting(self, name: EffectName) -> tuple[int, ...]:
        """The components of a name at a place; of several, such as screws of two leads, the best.

        Two leads of one screw may act together: they are terms of a series. Of those that fit as
        well one that machines may have goes first: where a screw grows, a bar would have to shrink.
        """
        weights = self._weights(name)
        best, *other_models = descending(sorted(weights), weights.__getitem__)
        as_good = [
            numbers for numbers in other_models if weights[numbers] > AS_GOOD * weights[best]
        ]
        return next(filter(self._may_be, (best, *as_good)), best)

    def _may_be(self, numbers: tuple[int, ...]) -> bool:
        """Whether no value of these components is less than any machine has."""
        return all(
            value.real >= parameter.least
            for placed_laws in self._values(numbers)[1]
            for value, parameter in zip(
                placed_laws.values, placed_laws.effect.parameters, strict=True
            )
        )

    def _weights(self, name: EffectName) -> dict[tuple[int, ...], float]:
        """Weights of the models that have each set of components with a name at a place.

        Other components of this name are in none of these models.
        """
        own_numbers = {
            k for k, component in enumerate(self.components) if name_of(component) == name
        }
        weights: dict[tuple[int, ...], float] = {}
        for model in self.posterior.models:
            numbers = tuple(k for k in model.members if k in own_numbers)
            if numbers:
                weights[numbers] = weights.get(numbers, 0.0) + model.weight
        return weights

    def _values(
        self, numbers: tuple[int, ...]
    ) -> tuple[tuple[Value, ...], tuple[EffectInstance, ...]]:
        """Parameters of components, given that they act together, and effects of their values."""
        parameters: list[Value] = []
        effects: list[EffectInstance] = []
        models = [m for m in self.posterior.models if {*numbers} <= {*m.members}]
        share = np.array([model.weight for model in models])
        share /= math.fsum(share)
        for number in numbers:
            candidate = self.components[number].candidate
            if candidate is None:
                continue
            means, variances = [], []
            for model in models:
                places = model.places(self.components)[number]
                means.append(model.mean[places])
                variances.append(model.variance_at(places))
            mean, deviation = mixture_moments(share, np.array(means), np.array(variances))
            columns = zip(candidate.parameters, mean.tolist(), deviation.tolist(), strict=True)
            parameters += [Value(p.name, value, u, p.unit) for p, value, u in columns]
            effects += candidate.effects(mean, deviation)
        return tuple(parameters), tuple(effects)

    def _left_over(
        self,
        adopted: tuple[EffectInstance, ...],
        leftover: Leftover | None,
    ) -> ModelDiscrepancy | None:
        """The likeliest law without a name, where it is likely that one acts."""
        models = self.posterior.models
        likely = {
            k: math.fsum(model.weight for model in models if k in model.members)
            for k, component in enumerate(self.components)
            if component.kind == "nameless"
        }
        lawful = math.fsum(model.weight for model in models if likely.keys() & {*model.members})
        if self.answer.verdict not in WITH_RESIDUALS or lawful <= EVEN * self.claims.missing:
            return None
        law = descending([*likely], likely.__getitem__)[0]
        # guessed names may already do what it does: then by itself
        for names, start in ((adopted, leftover or self.before), ((), self.before)):
            finding = self._finding((law,), likely[law], names, start.rms_mm(start.left))
            if finding.lowers_the_gap:
                break
        else:
            return None
        together = (*names, *finding.effects)
        if self.others:
            return ModelDiscrepancy(**vars(finding), held_out_gap=self._elsewhere(together))
        with_law, kinds = self._with(together), (*NAMES, "nameless")
        gap = with_law and left_out_postures(self.posterior, self.before, with_law, together, kinds)
        return ModelDiscrepancy(**vars(finding), held_out_gap=gap or None)

    def _elsewhere(self, effects: tuple[EffectInstance, ...]) -> HeldOutGap | None:
        return on_other_sessions(self.before, self.others, effects, self.timed)

    def _held_out(
        self, adopted: tuple[EffectInstance, ...], leftover: Leftover | None
    ) -> HeldOutGap | None:
        if self.others:
            return self._elsewhere(adopted)
        if not leftover or self.answer.verdict == "cannot-tell":  # a guess would predict itself
            return None
        return left_out_postures(self.posterior, self.before, leftover, adopted)

    def _contenders(self) -> Iterator[Contender]:
        """Places that may act and are not named, the likeliest first."""
        rivals = {name for rival_names in self.answer.rivals.values() for name in rival_names}
        all_names = {name_of(component) for component in self.components}
        before_mm = self.before.rms_mm(self.before.left)
        names = [name for name in self.claims.places if name in all_names]
        for name in names[:MOST_CONTENDERS]:
            numbers = self._acting(name)
            parameters, effects = self._values(numbers)
            basis = self.before.explained_by(self._columns(numbers))
            remainder = without(basis, self.before.left)
            after_mm = self.before.rms_mm(remainder)
            elsewhere = self._elsewhere(effects) if self.others and effects else None
            freedom = self.before.freedom - basis.shape[1]
            fits = self.before.p_value(float(remainder @ remainder), freedom) >= AGREEMENT
            if name in self.answer.rivals and (alone := self._with(effects)):
                after_mm = alone.rms_mm(alone.left)  # at its stated size, as where it is named
            if name in self.answer.rivals:
                reason = "" if self.answer.verdict in WITH_NAMES else "best guess"
            elif name in rivals:
                reason = "fits as well" if fits else "with others"
            elif self.answer.rivals:
                reason = "fits worse"
            elif self.answer.verdict == "agrees":
                reason = "as by chance"
            else:
                reason = "may act" if fits else "leaves a gap"
            yield Contender(
                name.id,
                name.where,
                parameters,
                self.claims.places[name],
                after_mm,
                explained_share(before_mm, after_mm),
                elsewhere.after_rms_mm if elsewhere else None,
                reason,
                effects,
            )

    def _columns(self, numbers: Sequence[int]) -> FloatArray:
        """Derivatives ``(n, r)`` of rows by components of the likeliest labels."""
        linear, names = self.posterior.linear, self._likeliest_names
        blocks = [np.zeros((len(linear.columns), 0))]
        for number in numbers:
            if number >= len(names):  # of labels put right in another way
                name = name_of(self.components[number])
                number = names.index(name) if name in names else number
            if number < len(names):
                blocks.append(linear.columns[:, linear.index[number]])
        return np.hstack(blocks)

    @cached_property
    def _likeliest_names(self) -> list[EffectName]:
        """Names of the components of the likeliest labels."""
        return [
            name_of(component) for component in self.components[: len(self.posterior.linear.index)]
        ]

    def _remarks(self, left_over: ModelDiscrepancy | None) -> Iterator[str]:
        """What else a person must know."""
        if not self.before.freedom:
            yield "offsets and zeros can explain all that these postures show: measure others too"
        elif self.before.noise_freedom <= 0.0:
            yield "no scatter of repeats and no stated noise: nothing can be judged against chance"
        yield from self._still()
        if self.answer.verdict == "unexplained":
            yield "either the effect is not in the catalogue, or the repeats are not independent"
        if self.answer.verdict in ("partly-explained", "unexplained") and not left_over:
            yield NO_LAW
        for name in self.answer.rivals:
            if name in {name_of(component) for component in self.components}:
                yield from self._half_seen(self._acting(name))
                yield from self._leads(name)
        yield from self._far_offsets()

    def _still(self) -> Iterator[str]:
        """Indicators that read the same wherever the machine was."""
        for cells in self.posterior.sessions:
            observations = cells.case.observations
            places = {
                TOUCHED_LETTERS[observations.leg[k]] + LEG_NAMES[observations.axis[k]]
                for k, *_ in still_rows(observations)
            }
            if places:
                set_ups = ", ".join(sorted(places))
                yield (
                    f"all readings of {set_ups} are the same, wherever the machine was: does the"
                    " plunger touch the leg, and is the display not on hold?"
                )

    def _half_seen(self, numbers: tuple[int, ...]) -> Iterator[str]:
        """An effect of whose values the readings see combinations only."""
        component = self.components[numbers[0]]
        rank = self.before.explained_by(self._columns(numbers)).shape[1]
        count = sum(len(self.components[number].unit) for number in numbers)
        if rank < count:
            yield (
                f"{component.id} ({component.where}): the readings see {rank} combination(s) of its"
                f" {count} values; how the values share that is not known"
            )

    def _leads(self, name: EffectName) -> Iterator[str]:
        """Screws of which the readings do not tell the lead."""
        weights: dict[tuple[float, ...], float] = {}
        for numbers, weight in self._weights(name).items():
            laws = {share.effect for k in numbers for share in self.components[k].shares}
            leads = sorted(law.lead_mm for law in laws if isinstance(law, ActuatorCyclic))
            weights[(*leads,)] = weights.get((*leads,), 0.0) + weight
        best = max(weights, key=weights.__getitem__)
        as_good = [leads for leads, weight in weights.items() if weight > AS_GOOD * weights[best]]
        if rivals := {lead for leads in as_good for lead in leads if lead not in best}:
            leads_mm = ", ".join(f"{lead:g}" for lead in sorted(rivals))
            yield (
                f"{name.id} ({name.where}): leads of {leads_mm} mm fit as well; write the screw's"
                " lead into the machine file"
            )

    def _far_offsets(self) -> Iterator[str]:
        """Joint offsets that nobody would have left: they count, but a person should look."""
        count = self.posterior.parameter_count
        models = self.posterior.models
        expected_mm = np.sum([model.weight * model.mean[:count] for model in models], axis=0)
        for number, cells in enumerate(self.posterior.sessions):
            first = LENGTHS + 3 * number
            entered_mm = cells.case.model.parameters_mm[:3]
            off_mm = expected_mm[first : first + 3] - entered_mm
            for leg, off, tolerance in zip(
                LEG_NAMES, off_mm, cells.case.tolerance_mm[:3], strict=True
            ):
                if abs(off) > FAR_OFF * tolerance:
                    yield (
                        f"the joint offset of {leg} comes out {off:+.1f} mm off, the machine file"
                        f" allows {tolerance:g} mm: look how it was entered"
                    )

    def _smallest_detectable(self) -> dict[str, Detectable | None]:
        """Size of each single-parameter effect that would be seen nine times of ten.

        None where that is more than any machine has. Lines of drives are as stated, and have a name
        beyond their tolerances.
        """
        smallest: dict[str, Detectable | None] = {}
        linear, beyond = self.posterior.linear, self.sessions[-1].case.named_beyond
        causes = log_causes(self.sessions[-1].case.acting)
        about = self.before.about
        if self.sessions != [*self.posterior.sessions]:
            about = Leftover.of(self.posterior.sessions, (), self.timed).about
        for k, component in enumerate(self.components[: len(linear.index)]):
            if component.kind not in NAMES or len(component.unit) != 1 or not component.candidate:
                continue
            length = float(np.linalg.norm(about.left_by(self._columns([k]))))
            if not length or self.before.noise_freedom <= 0.0:
                continue
            (parameter,), unit = component.candidate.parameters, float(component.unit[0])
            size = unit * (_needed(length, component.log_prior, causes) + SEEN_9_OF_10) / length
            size = max(size, WITHIN * beyond.get(component.shares[0].effect, 0.0))
            size_before = smallest.setdefault(component.id, None)
            if size <= min(NO_SIZE * unit, parameter.limit) and (
                not size_before or size < size_before.size
            ):
                smallest[component.id] = Detectable(component.id, size, parameter.unit)
        return smallest


def _needed(length: float, log_prior: float, causes: FloatArray) -> float:
    """Standard deviations that a column of this length per unit needs, so that it is missed.

    Noise being known, for each scale s of its size with w = 1 + s²l² the log weight over that of
    nothing is z²(1 - 1/w)/2 - log(w)/2 and the priors, those of ``causes`` ``(4,)`` among them; the
    scale that needs least counts.
    """
    odds = math.log(MISSING / (1.0 - MISSING)) + causes[0] - causes[1] - log_prior
    gain = (np.array(SCALES) * length) ** 2
    square = 2.0 * (odds - LOG_SCALES + 0.5 * np.log1p(gain)) * (1.0 + gain) / gain
    return float(np.sqrt(square.min()))


APART = ("first_take", "wild_reading", "label_error", "posture_off")
"""Mistakes of which the readings are left out."""


def _put_right(case: SessionCase, mistakes: Sequence[Mistake]) -> CleanedReadings:
    """Readings with these mistakes corrected, one after the other, or left out."""
    observations, visit = case.observations, case.visit
    count = int(visit.max()) + 1
    first = np.unique(visit, return_index=True)[1]
    place: IntArray = np.arange(count, dtype=np.intp)  # the visit whose labels each one has
    factor, out, slips = np.ones(count), np.zeros(count, dtype=bool), np.zeros(count, dtype=np.intp)
    for mistake in mistakes:
        touched = np.isin(place, mistake.rows)
        if mistake.id in APART:
            out |= touched
        elif mistake.id == "stand_slip":
            slips += touched
        factor = np.where(touched, mistake.factor * factor, factor)
        place = np.argsort(mistake.source)[place]
    rows = np.flatnonzero(~out[visit])
    labels = first[place[visit]]
    names = ["leg", "axis", "station", "displacement_mm", "approach", "cycle"]
    names += ["position_mm", "movement", "along_mm"]
    moved = replace(
        observations,
        **{name: getattr(observations, name)[labels] for name in names},
        value_mm=observations.value_mm * factor[visit],
        mount=numbered(observations.mount[labels], slips[visit]),
    )
    return CleanedReadings(moved.take(rows), rows, slips[visit][rows])


def explained_share(before_rms_mm: float, after_rms_mm: float) -> float:
    """The part of the gap's square that is gone, between 0 and 1."""
    if before_rms_mm <= 0.0:
        return 0.0
    return min(max(1.0 - (after_rms_mm / before_rms_mm) ** 2, 0.0), 1.0)


def _rival_words(rival: EffectName, ids: Collection[str]) -> str:
    """The rival's id; where a finding shares it, with the place that tells them apart."""
    if rival.id == EMPIRICAL:
        return "an unnamed effect"
    return f"{rival.id} ({rival.where})" if rival.id in ids else rival.id


def sentence(verdict: Verdict, findings: Sequence[Finding], where: str) -> str:
    """The verdict in one sentence that a machinist understands; ``where`` something is left."""
    names = " and ".join(f"{finding.title} ({finding.where})" for finding in findings)
    ids = {finding.id for finding in findings}
    all_rivals = {rival for finding in findings for rival in finding.indistinguishable_from}
    sorted_rivals = sorted(all_rivals, key=lambda rival: (rival.id, rival.where))
    rivals = [*dict.fromkeys(_rival_words(rival, ids) for rival in sorted_rivals)]
    if len(rivals) > MOST_RIVALS:
        rivals = [*rivals[: MOST_RIVALS - 1], f"{len(rivals) - MOST_RIVALS + 1} others"]
    instead = (
        f", or instead {', '.join(rivals)}. These readings cannot decide."
        if rivals
        else ". More may be missing beside it; these readings cannot decide."
    )
    return {
        "agrees": "The model explains the readings within their noise; nothing is missing.",
        "explained": f"What was missing is: {names}.",
        "ambiguous": f"Something is missing: {names}{instead}",
        "partly-explained": f"Part of what is missing: {names}. The rest: {where}.",
        "unexplained": f"Something is missing, {where}. No known effect explains it.",
        "cannot-tell": f"The readings are too few to say what is missing; best guess: {names}."
        if names
        else "These readings cannot tell whether anything is missing.",
    }[verdict]
