"""Compare, locate, name, verify, propose: the whole diagnosis of one or more sessions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.diagnosis.blunders import Blunder, belongs_elsewhere, find_blunder, set_wild_aside
from calib.diagnosis.following import ENOUGH, Rival, best_addition
from calib.diagnosis.locate import each_mounting, left_over_words, locate
from calib.diagnosis.problem import Problem, Sitting
from calib.diagnosis.race import LEVEL, Outcome, Race
from calib.diagnosis.results import (
    Contender,
    Detectable,
    Diagnosis,
    Finding,
    Gap,
    HeldOutGap,
    Named,
    NextMeasurement,
    Value,
    Verdict,
)
from calib.diagnosis.selection import Weighed, contained, union
from calib.diagnosis.slips import find_slip
from calib.diagnosis.verify import left_out_postures, on_other_sessions, structure_rms_mm
from calib.errors import NotIdentifiable
from calib.noise import IndicatorFigures
from calib.observations import LEG_NAMES, Conditions, FloatArray, Observations
from calib.orthoglide.effects.candidates import Candidate, candidates
from calib.orthoglide.effects.law import Law, Placed
from calib.orthoglide.model import Model

SEED = 20081
MOST_CONTENDERS = 20
MOST_BLUNDERS = 3
LEAST_EVIDENCE = 25.0
"""No single name below this non-centrality (explained squares less their freedom)."""

CORRECTIONS = 2
LEAST_FREEDOM = 10
ROOM = 4
"""Degrees of freedom that the whole catalogue must leave, or an unknown effect could not show."""

ALIKE = 0.98
FAR = 30.0
MOST_LOSS = 200.0
LEAST_ROWS_BEYOND = 8
"""Readings beyond zeros and base parameters that a mistake must be seen against."""

MOST_ALTERNATIVES = 5


@dataclass(frozen=True, eq=False)
class Case:
    """One session to diagnose: the model it was measured against and what is known of it."""

    model: Model
    observed: Observations
    indicator: IndicatorFigures
    tolerance_mm: FloatArray


@dataclass(frozen=True, eq=False)
class Entry:
    """A runner in the race: a candidate of the catalogue or a slip of a stand."""

    id: str
    kind: str
    title: str
    where: str
    columns: FloatArray
    candidate: Candidate | None
    names: tuple[tuple[str, str], ...]
    tolerance: FloatArray


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
    cleaned, blunders = _clean(cases)
    problem = Problem.of([_sit(case) for case in cleaned])
    entries = _entries(problem, laws)
    blocks = [problem.block(entry.columns) for entry in entries]
    seen = [k for k, block in enumerate(blocks) if block.shape[1]]
    entries = [entries[k] for k in seen]
    implausible = np.array([_implausible(problem, entry) for entry in entries])
    race = Race(problem, tuple(blocks[k] for k in seen), implausible, seed)
    outcome = race.run()
    return _Report(problem, entries, race, outcome, tuple(blunders), cleaned, held_out).make()


def _sit(case: Case) -> Sitting:
    return Sitting.of(case.model, case.observed, case.indicator, case.tolerance_mm)


def cleaned(cases: Sequence[Case]) -> list[Case]:
    """The sessions as they are diagnosed: mistakes corrected or set aside."""
    return _clean(cases)[0]


def _clean(cases: Sequence[Case]) -> tuple[list[Case], list[tuple[Blunder, float, float]]]:
    """Sessions without the mistakes found in them, each with the gap before and after it."""
    cleaned, found = [], []
    for case in cases:
        observed = case.observed
        slips, observed = _put_slips_back(observed)
        found += slips
        spare = len(observed) - observed.mount_count - len(case.tolerance_mm)
        for _ in range(MOST_BLUNDERS if spare >= LEAST_ROWS_BEYOND else 0):
            blunder = find_blunder(case.model, observed, case.tolerance_mm)
            if blunder is None:
                break
            found.append((blunder, observed, blunder.corrected))
            observed = blunder.corrected
        rest, wild = set_wild_aside(observed)
        found += [(one, observed, one.corrected) for one in wild]
        cleaned.append(Case(case.model, rest, case.indicator, case.tolerance_mm))
    judged = [
        (blunder, _gap_rms(cases[0], before), _gap_rms(cases[0], after))
        for blunder, before, after in found
    ]
    return cleaned, judged


def _put_slips_back(
    observed: Observations,
) -> tuple[list[tuple[Blunder, Observations, Observations]], Observations]:
    """Slips of stands that the repeats show clearly, one after the other."""
    found = []
    for _ in range(MOST_BLUNDERS):
        slip = find_slip(observed)
        if slip is None:
            break
        first = slip.rows[0]
        where = LEG_NAMES[observed.leg[first]] + LEG_NAMES[observed.axis[first]]
        title = (
            f"the stand moved by {slip.shift_mm:+.4f} mm before the reading at "
            f"{observed.displacement_mm[first]:+g} mm, cycle {observed.cycle[first]}"
        )
        blunder = Blunder("stand_slip", where, title, slip.rows, slip.corrected)
        found.append((blunder, observed, slip.corrected))
        observed = slip.corrected
    return found, observed


def _gap_rms(case: Case, observed: Observations) -> float:
    sitting = Sitting.of(case.model, observed, case.indicator, case.tolerance_mm)
    return structure_rms_mm(Problem.of([sitting]))


def _entries(problem: Problem, laws: Sequence[Law]) -> list[Entry]:
    """Every candidate that the sessions can show, stacked over them, and lone wild readings."""
    found: dict[tuple[str, str, str], Entry] = {}
    row, total = 0, len(problem.y)
    for one in problem.sittings:
        for candidate in candidates(one.model, one.observed, laws):
            key = candidate.id, candidate.where, candidate.arrangement + str(candidate.parameters)
            entry = found.get(key)
            if entry is None:
                columns = np.zeros((total, candidate.columns.shape[1]))
                names = tuple((p.name, p.unit) for p in candidate.parameters)
                entry = Entry(
                    candidate.id,
                    str(candidate.kind),
                    candidate.title,
                    candidate.where,
                    columns,
                    candidate,
                    names,
                    np.array([p.tolerance for p in candidate.parameters]),
                )
                found[key] = entry
            entry.columns[row : row + len(one.observed)] = candidate.columns
        row += len(one.observed)
    return [*found.values(), *(_lone_readings(problem) if problem.has_repeats() else ())]


def _implausible(problem: Problem, entry: Entry) -> float:
    """What a candidate loses for the size that it would need alone, in log weight.

    A normal prior on each parameter, thirty times the unremarkable size wide: a fit that needs more
    pays, and directions that hardly show are not blown up.
    """
    white = problem.root_weight[:, None] * entry.columns * (FAR * entry.tolerance)
    white = white - problem.nuisance @ (problem.nuisance.T @ white)
    free = problem.y - white @ np.linalg.lstsq(white, problem.y, rcond=1e-6)[0]
    value = _held(white, problem.y)[0]
    left = problem.y - white @ value
    loss = 0.5 * (float(left @ left) - float(free @ free) + float(value @ value))
    return float(min(max(loss, 0.0), MOST_LOSS))


def _held(white: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares with a unit normal prior: values ``(k,)`` and what each reading adds."""
    inverse = np.linalg.solve(white.T @ white + np.eye(white.shape[1]), white.T)
    return np.asarray(inverse @ y), np.asarray(inverse)


def _lone_readings(problem: Problem) -> list[Entry]:
    """The first and the last reading of each mounting, which repeats alone cannot judge."""
    found = []
    leg = np.concatenate([one.observed.leg for one in problem.sittings])
    axis = np.concatenate([one.observed.axis for one in problem.sittings])
    for mount in range(int(problem.mount.max()) + 1):
        rows = np.flatnonzero(problem.mount == mount)
        where = LEG_NAMES[leg[rows[0]]] + LEG_NAMES[axis[rows[0]]]
        for row, word in ((rows[0], "first"), (rows[-1], "last")):
            columns = np.zeros((len(problem.y), 1))
            columns[row, 0] = 1.0
            title = f"the {word} reading of this mounting is wild"
            shift = (("shift", "mm"),)
            found.append(
                Entry("wild_reading", "blunder", title, where, columns, None, shift, np.ones(1))
            )
    return found


@dataclass(eq=False)
class _Report:
    """From the outcome of the race to words and numbers."""

    problem: Problem
    entries: list[Entry]
    race: Race
    outcome: Outcome
    blunders: tuple[tuple[Blunder, float, float], ...]
    cases: Sequence[Case]
    held_out: Sequence[Case]
    _others: list[Sitting] = field(default_factory=list)

    def make(self) -> Diagnosis:
        kept = self.outcome.kept
        findings = [self._of_blunder(*one) for one in self.blunders]
        if kept is not None:
            findings += self._findings(kept)
        verdict = self._verdict(kept)
        shares = locate(self.problem)
        told = bool(self.held_out) or verdict != "cannot-tell"
        held = self._held_out(findings) if told else None
        return Diagnosis(
            verdict=verdict,
            sentence=_sentence(verdict, findings, left_over_words(shares, LEVEL)),
            noise_mm=float(np.sqrt(np.mean(self.problem.root_weight**-2.0))),
            noise_df=self.problem.noise_df,
            noise_source=self._noise_source(),
            gap_before=self._gap(()),
            gap_after=self._gap(kept.members if kept else ()),
            held_out=held,
            where=shares[:MOST_CONTENDERS],
            effects=tuple(
                one
                for one in findings
                if one.kind == "blunder"
                or verdict in ("explained", "ambiguous", "partly-explained")
            ),
            candidates=self._contenders(kept),
            next_measurement=self._next(verdict, kept),
            smallest_detectable=self._detectable(),
            remarks=self._remarks(verdict),
        )

    def _noise_source(self) -> str:
        noise = self.problem.sittings[0].noise
        return noise.source if noise else "residuals"

    def _gap(self, members: tuple[int, ...]) -> Gap:
        square, df, p = self.race.gap(members)
        residual = self.problem.y
        if members:
            basis = union([self.race.blocks[k] for k in members])
            residual = residual - basis @ (basis.T @ residual)
        return Gap(structure_rms_mm(self.problem, residual), square, df, p)

    def _verdict(self, kept: Weighed | None) -> Verdict:
        if kept is None:
            return self._verdict_without_names()
        if self.problem.noise_df <= 0.0 or self.problem.structure_df < LEAST_FREEDOM:
            return "cannot-tell"
        if not self.outcome.adequate:
            return "partly-explained"
        weak = any(self._evidence(kept, k) < LEAST_EVIDENCE for k in kept.members)
        if weak or any(self._names(kept).values()) or not self._room():
            return "ambiguous"
        return "explained"

    def _verdict_without_names(self) -> Verdict:
        if self.problem.structure_df <= 0 or self.problem.noise_df <= 0.0:
            return "cannot-tell"
        closed = self.outcome.gap_before[2] > LEVEL
        if self.blunders:
            return "explained" if closed else "partly-explained"
        return "agrees" if closed else "unexplained"

    def _evidence(self, kept: Weighed, member: int) -> float:
        """Non-centrality of one member beside the others."""
        others = tuple(k for k in kept.members if k != member)
        blocks, y = self.race.beside(others)
        block = blocks[member]
        explained: float = ((block.T @ y) ** 2).sum()
        return float(explained) - float(block.shape[1])

    def _room(self) -> bool:
        """Whether the catalogue leaves room for an effect that is not in it to show."""
        inside = [
            self.problem.structure.T @ b
            for e, b in zip(self.entries, self.race.blocks, strict=True)
            if e.kind != "blunder"
        ]
        rank = int((np.linalg.svd(np.hstack(inside), compute_uv=False) > 1e-3).sum())
        return self.problem.structure_df - rank >= ROOM

    def _names(self, kept: Weighed) -> dict[int, tuple[Named, ...]]:
        """For each member of the best model the other names that fit as well in its place."""
        return {member: self._rivals(kept, member) for member in kept.members}

    def _rivals(self, kept: Weighed, member: int) -> tuple[Named, ...]:
        own = self.entries[member]
        found: dict[Named, None] = {}
        for model in self.outcome.models:
            taken = [k for k in model.members if k not in kept.members]
            if member in model.members or len(model.members) != len(kept.members):
                continue
            for k in taken:
                if not self._same_in_a_larger_place(member, k):
                    found[Named(self.entries[k].id, self.entries[k].where)] = None
        for k in self._look_alikes(member):
            found[Named(self.entries[k].id, self.entries[k].where)] = None
        found.pop(Named(own.id, own.where), None)
        return tuple(found)

    def _same_in_a_larger_place(self, member: int, other: int) -> bool:
        """The same effect on more places holds the smaller one: no rival, the smaller is meant."""
        same = self.entries[member].id == self.entries[other].id
        inside = contained(self.race.blocks[member], self.race.blocks[other]) > ALIKE
        return same and (inside or self.entries[member].where == self.entries[other].where)

    def _look_alikes(self, member: int) -> list[int]:
        """Candidates of no higher rank that imitate this one exactly."""
        own = self.race.blocks[member]
        return [
            k
            for k, block in enumerate(self.race.blocks)
            if k != member
            and block.shape[1] <= own.shape[1]
            and contained(own, block) > ALIKE
            and not self._same_in_a_larger_place(member, k)
        ]

    def _findings(self, kept: Weighed) -> list[Finding]:
        values = self._refined(kept.members)
        rivals = self._names(kept)
        before = self._gap(()).rms_mm
        found = []
        for place, member in enumerate(self._by_evidence(kept)):
            entry = self.entries[member]
            after = self._gap(self._by_evidence(kept)[: place + 1]).rms_mm
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

    def _label(self, entry: Entry) -> tuple[str, str]:
        """A lone wild reading may be one under a wrong label."""
        if entry.id != "wild_reading":
            return entry.id, entry.title
        single = int(entry.columns[:, 0].argmax())
        observed = self.problem.sittings[0].observed
        belongs = belongs_elsewhere(observed, single) if single < len(observed) else None
        if belongs is None:
            return entry.id, entry.title
        return "label_error", f"{entry.title}: it belongs to {belongs}"

    def _by_evidence(self, kept: Weighed) -> tuple[int, ...]:
        return tuple(sorted(kept.members, key=lambda k: -self._evidence(kept, k)))

    def _refined(
        self, members: tuple[int, ...]
    ) -> dict[int, tuple[tuple[Value, ...], tuple[Placed, ...]]]:
        """The same through the nonlinear simulation: effects in, base fitted anew, corrected."""
        found = self._values(members, self.problem.y)
        for _ in range(CORRECTIONS):
            placed = tuple(effect for _, effects in found.values() for effect in effects)
            try:
                left = self._left_with(placed)
            except NotIdentifiable:
                return found
            basis = union([self.race.blocks[k] for k in members])
            explained = self.problem.y - self._linear_share(found, members)
            correction = basis @ (basis.T @ (left - explained))
            found = self._values(members, self.problem.y + correction)
        return found

    def _left_with(self, placed: tuple[Placed, ...]) -> FloatArray:
        """Whitened residual ``(n,)`` with these effects in the model, nuisance projected out."""
        adopted = []
        for case, one in zip(self.cases, self.problem.sittings, strict=True):
            model = case.model.with_effects((*case.model.effects, *placed))
            adopted.append(one.again(model, case.tolerance_mm))
        return Problem.of(adopted).y

    def _linear_share(
        self,
        found: dict[int, tuple[tuple[Value, ...], tuple[Placed, ...]]],
        members: tuple[int, ...],
    ) -> FloatArray:
        """What the columns of the members with these values explain ``(n,)``, whitened."""
        total = np.zeros_like(self.problem.y)
        for k in members:
            value = np.array([v.value for v in found[k][0]])
            if found[k][1]:
                total += self.problem.root_weight * (self.entries[k].columns @ value)
        return total - self.problem.nuisance @ (self.problem.nuisance.T @ total)

    def _values(
        self, members: tuple[int, ...], y: FloatArray | None = None
    ) -> dict[int, tuple[tuple[Value, ...], tuple[Placed, ...]]]:
        """Parameters of these entries fitted together, base parameters and zeros free."""
        y = self.problem.y if y is None else y
        root = self.problem.root_weight[:, None]
        design = np.hstack([root * self.entries[k].columns for k in members])
        size = FAR * np.concatenate([self.entries[k].tolerance for k in members])
        free = design * size
        free = free - self.problem.nuisance @ (self.problem.nuisance.T @ free)
        held, _ = _held(free, y)
        value = held * size
        spread = np.sqrt(np.linalg.inv(free.T @ free + np.eye(len(size))).diagonal()) * size
        found, start = {}, 0
        for k in members:
            entry = self.entries[k]
            rows = slice(start, start + len(entry.names))
            start += len(entry.names)
            parameters = tuple(
                Value(name, float(v), float(u), unit)
                for (name, unit), v, u in zip(entry.names, value[rows], spread[rows], strict=True)
            )
            placed = entry.candidate.effects(value[rows]) if entry.candidate else ()
            found[k] = parameters, placed
        return found

    def _of_blunder(self, blunder: Blunder, before: float, after: float) -> Finding:
        return Finding(blunder.id, "blunder", blunder.title, blunder.where, (), 0.0, before, after)

    def _contenders(self, kept: Weighed | None) -> tuple[Contender, ...]:
        ordered = sorted(self.outcome.singles, key=lambda m: -m.log_weight)
        found: dict[tuple[str, str], Contender] = {}
        for model in ordered:
            member = model.members[0]
            entry = self.entries[member]
            if (entry.id, entry.where) in found:
                continue
            parameters, placed = self._values((member,))[member]
            found[entry.id, entry.where] = Contender(
                entry.id,
                entry.where,
                parameters,
                math.exp(max(float(self.outcome.local_log_p[member]), -690.0)),
                self._gap((member,)).rms_mm,
                self._held_out_of(placed),
                self._reason(kept, member),
                placed,
            )
            if len(found) == MOST_CONTENDERS:
                break
        return tuple(found.values())

    def _held_out_of(self, placed: tuple[Placed, ...]) -> float | None:
        if not self.held_out or not placed:
            return None
        found = on_other_sessions(self.others(), placed, self.held_out[0].tolerance_mm)
        return found.after_rms_mm if found else None

    def others(self) -> list[Sitting]:
        """The held-out sessions, fitted once."""
        if not self._others:
            self._others = [_sit(case) for case in self.held_out]
        return self._others

    def _reason(self, kept: Weighed | None, member: int) -> str:
        if kept is None:
            return "no better than chance among so many candidates"
        if member in kept.members:
            return ""
        if any(member in model.members for model in self.outcome.models):
            return "fits about as well"
        if self.race.gap((member,))[2] <= LEVEL:
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
            [entry.columns for entry in self.entries if entry.kind != "blunder"],
            len(self.outcome.kept.members),
            self.cases[0].tolerance_mm,
        )

    def _next(self, verdict: Verdict, kept: Weighed | None) -> NextMeasurement | None:
        if verdict == "cannot-tell" and self.problem.noise_df <= 0.0:
            return NextMeasurement(
                "without repeats and without a stated noise nothing can be judged: measure "
                "every posture at least twice, leaving it in between",
                "zero-max-min",
                0.0,
            )
        if kept is None or verdict not in ("ambiguous", "cannot-tell"):
            return None
        for member in kept.members:
            for rival in self._rivals(kept, member):
                other = next(k for k, e in enumerate(self.entries) if Named(e.id, e.where) == rival)
                proposed = self._separate(member, other)
                if proposed is not None:
                    return proposed
        return None

    def _separate(self, member: int, other: int) -> NextMeasurement | None:
        first, second = self.entries[member], self.entries[other]
        if first.candidate is None or second.candidate is None:
            return None
        geometry = self.problem.sittings[0].model.geometry
        added, separation = best_addition(
            self.problem, geometry, self._rival(member), self._rival(other)
        )
        enough = "settles it" if separation >= ENOUGH else "helps"
        return NextMeasurement(
            f"{added.words}; it {enough} between {first.id} ({first.where}) and "
            f"{second.id} ({second.where})",
            _procedure_text(added.leg, added.station, added.levels_mm),
            separation,
        )

    def _rival(self, member: int) -> Rival:
        entry = self.entries[member]
        candidate = entry.candidate
        assert candidate is not None
        model = self.problem.sittings[0].model
        value = np.array([v.value for v in self._values((member,))[member][0]])

        def columns(taken: Conditions) -> FloatArray:
            found = np.zeros((len(taken), len(value)))
            for other in candidates(model, taken, [p.law for p in candidate.effects(value)][:1]):
                if (other.where, other.arrangement, other.parameters) == (
                    candidate.where,
                    candidate.arrangement,
                    candidate.parameters,
                ):
                    found = other.columns
            return found

        return Rival(columns, value)

    def _detectable(self) -> tuple[Detectable, ...]:
        """Size of each single-parameter effect that would have been found nine times of ten."""
        found: dict[str, Detectable] = {}
        threshold = math.sqrt(2.0 * math.log(max(len(self.entries), 2) / LEVEL)) + 1.28
        for entry, block in zip(self.entries, self.race.blocks, strict=True):
            if entry.columns.shape[1] != 1 or entry.kind == "blunder":
                continue
            white = self.problem.root_weight * entry.columns[:, 0]
            slope = float(np.linalg.norm(block.T @ white))
            size = threshold / slope if slope else math.inf
            unit = entry.names[0][1]
            if math.isfinite(size) and (entry.id not in found or size < found[entry.id].size):
                found[entry.id] = Detectable(entry.id, size, unit)
        return tuple(found.values())

    def _remarks(self, verdict: Verdict) -> tuple[str, ...]:
        said = []
        if self.problem.noise_df <= 0.0:
            said.append("no repeats and no stated noise: nothing can be judged against chance")
        if verdict == "unexplained":
            said.append(
                "either the effect is not in the catalogue, or the repeats are not independent"
            )
            said.append(self._law_in_words())
        return tuple(said)

    def _law_in_words(self) -> str:
        """What the left-over depends on, without a physical name."""
        displacement = np.concatenate(
            [one.observed.displacement_mm for one in self.problem.sittings]
        )
        relative = displacement / 100.0
        best, name = 0.0, ""
        for power, words in (
            (1, "in proportion to"),
            (2, "with the square of"),
            (3, "with the cube of"),
        ):
            for each, where in ((False, ""), (True, ", differently on each mounting")):
                column = relative[:, None] ** power
                columns = each_mounting(self.problem, column) if each else column
                block = self.problem.block(columns)
                inside = float(((block.T @ self.problem.y) ** 2).sum()) - block.shape[1]
                if inside > best * 1.2:
                    best, name = inside, f"the left-over grows {words} the displacement{where}"
        return name or "the left-over follows no simple power of the displacement"


def _procedure_text(leg: str, station: float, levels_mm: Sequence[float]) -> str:
    levels = ", ".join(['"zero"', *(f"{level:.1f}" for level in levels_mm)])
    return (
        'schema = "glidecal.procedure/1"\n'
        f'name = "next-{leg}"\n'
        'title = "The measurement that separates what stayed ambiguous"\n'
        f'legs = ["{leg}"]\n'
        f"stations = [{station}]\n"
        "cycles = 3\n"
        f"levels = [{levels}]\n"
    )


def _sentence(verdict: Verdict, findings: Sequence[Finding], where: str) -> str:
    """The verdict in one sentence that a machinist understands."""
    names = " and ".join(f"{f.title} ({f.where})" for f in findings)
    rivals = sorted({r.id for f in findings for r in f.indistinguishable_from})
    return {
        "agrees": "The model explains the readings within their noise; nothing is missing.",
        "explained": f"What was missing is: {names}.",
        "ambiguous": f"Something is missing: {names}"
        + (f", or else {', '.join(rivals)}; these data cannot tell." if rivals else "; weak."),
        "partly-explained": f"Part of what is missing is {names}; more is left, {where}.",
        "unexplained": f"Something real is missing, {where}, and no known effect explains it.",
        "cannot-tell": "The readings are too few to tell what is missing"
        + (f"; the best guess is {names}." if names else "."),
    }[verdict]
