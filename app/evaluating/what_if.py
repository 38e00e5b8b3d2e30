"""What an effect of a stated size would explain; nothing is looked for, its size is not fitted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from app.evaluating.correction import case_of
from app.evaluating.own_effects import known_effects
from app.evaluating.solution import SessionSolution, solve_sessions
from calib.errors import NotIdentifiable, UnreachablePosture, UsageError, check_number
from calib.identify.identify import IdentificationCase, identify
from calib.identify.solution import FittedSize, Solution, Subset
from calib.posterior.library import STATED_ONLY
from calib.posterior.tool import FREE_IN, Frame
from calib.quantity import Sizes, round_step
from calib.tripod.controller import commanded_with, tool_error_free_of_mm
from calib.tripod.effects import BESIDE_CATALOGUE
from calib.tripod.effects.candidates import (
    Candidate,
    axes_together,
    candidates,
    single_places,
)
from calib.tripod.effects.effect import Effect, EffectInstance, EffectParameter, Kind
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from protocols.effect_entries import LARGEST_SIZE, EffectEntry, ParameterEntry
from protocols.model_file import (
    ModelFile,
    effect_entry,
    entries_of_laws,
    placed_effects,
    sizes_of,
    to_model,
)
from protocols.observations import indicator_figures, to_observations
from protocols.session import Session

if TYPE_CHECKING:  # heavy, and only where there is one
    from app.evaluating.diagnosis import SessionDiagnosis
    from calib.diagnosis.results import Contender, Diagnosis, Finding

FAR = 100.0
"""Sizes that nobody would remark on, or four times what was fitted: so far a size can be moved."""


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect, ``entry``, whose sizes are moved beside a model that does not have it.

    Everything else is worked out once. ``subset`` None: at every size the usual one.
    """

    sessions: tuple[Session, ...]
    beside: ModelFile
    entry: EffectEntry
    subset: Subset | None = None

    @property
    def values(self) -> tuple[float, ...]:
        """The sizes of the entry, in its units."""
        return tuple(parameter.value for parameter in self.entry.parameters.values())

    def at(self, values: Sequence[float]) -> WhatIf:
        """What happens with sizes held at these values, one for each, in its unit."""
        return WhatIf(self, tuple(map(float, values)))

    @cached_property
    def without(self) -> WhatIf:
        """What happens with size 0."""
        return self.at([0.0] * len(self.values))

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """All that are known."""
        return known_effects()

    def placed(self, entry: EffectEntry) -> tuple[EffectInstance, ...]:
        """The entry for the simulation."""
        geometry = self.beside.machine.geometry()
        return tuple(
            instance
            for law_entry in entries_of_laws(entry)
            for instance in placed_effects(law_entry, self.effects, geometry, "effect")
        )

    @cached_property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """What the effect says of each size."""
        laws = [instance.effect for instance in self.placed(self.entry)]
        parameter_of_name = {p.name: p for law in laws for p in law.parameters}
        return tuple(
            parameter_of_name[parameter.of or name]
            for name, parameter in self.entry.parameters.items()
        )

    @cached_property
    def fitted(self) -> tuple[FittedSize, ...]:
        """The sizes as they come out beside the parameters. Raises NotIdentifiable."""
        solution = self.solution(self.entry.freed())
        return solution.sizes[len(solution.sizes) - len(self.entry.parameters) :]

    def begin(self) -> Trial:
        """The trial with the set of parameters that the readings determine beside the sizes.

        All that is worked out once is. Raises NotIdentifiable where nothing can be solved.
        """
        trial = self
        if self.subset is None:
            try:
                result = self.result(self.entry.freed())
            except NotIdentifiable:
                result = self.without.result
            trial = replace(self, subset=result.solution.subset)
        _ = trial.without.solution, trial.sizes
        return trial

    @cached_property
    def sizes(self) -> Sizes:
        """How they can be moved: by steps no larger than the standard uncertainty of each.

        Where readings do not tell them, by a tenth of what nobody would remark on.
        """
        fitted: tuple[FittedSize, ...] = ()
        why_not, kinds = "", self.parameters
        try:
            fitted = self.fitted
        except NotIdentifiable as problem:
            why_not = str(problem)
        best = tuple(size.value for size in fitted)
        deviations = tuple(size.standard_uncertainty for size in fitted)
        steps = [0.1 * kind.tolerance for kind in kinds]
        steps = [round_step(u or step) for u, step in zip(deviations or steps, steps, strict=True)]
        far = [
            min(max(FAR * kind.tolerance, 4.0 * abs(value)), kind.limit)
            for kind, value in zip(kinds, self.values, strict=True)
        ]
        return Sizes(
            names=tuple(self.entry.parameters),
            units=tuple(parameter.unit for parameter in self.entry.parameters.values()),
            first=best or self.values,
            steps=tuple(steps),
            least=tuple(max(-limit, kind.least) for limit, kind in zip(far, kinds, strict=True)),
            largest=tuple(far),
            best=best,
            deviations=deviations,
            why_not=why_not,
        )

    @property
    def frame(self) -> Frame:
        """How workpieces are set on this machine."""
        return self.sessions[-1].opened.machine.frame

    @cached_property
    def _case(self) -> IdentificationCase:
        """What readings tell, whatever the sizes are."""
        observations = to_observations(self.sessions)
        model = to_model(self._with(self.entry), "model", self.effects)
        return IdentificationCase.of(model, observations, indicator_figures(self.sessions))

    def _with(self, entry: EffectEntry) -> ModelFile:
        return self.beside.model_copy(
            update={"effects": (*self.beside.effects, *entries_of_laws(entry))}
        )

    def solution(self, entry: EffectEntry) -> Solution:
        """The solution with the effect as the entry has it. Raises NotIdentifiable."""
        if self.subset is None:
            return self.result(entry).solution
        model_file, effects = self._with(entry), self.effects
        case = replace(
            self._case,
            model=to_model(model_file, "model", effects),
            sizes=sizes_of(model_file, effects),
        )
        tolerance_mm = self.sessions[0].opened.machine.tolerances_mm()
        return identify(case, self.subset, tolerance_mm=tolerance_mm)

    def result(self, entry: EffectEntry) -> SessionSolution:
        """The result with the effect as the entry has it. Raises NotIdentifiable."""
        model_file = self._with(entry)
        return solve_sessions(self.sessions, subset=self.subset, model=model_file)


@dataclass(frozen=True, eq=False)
class WhatIf:
    """Parameters fitted beside an effect of these ``values``, which are held."""

    trial: Trial
    values: tuple[float, ...]

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the values."""
        return tuple(parameter.unit for parameter in self.trial.entry.parameters.values())

    @cached_property
    def solution(self) -> Solution:
        """The solution of `result`, which need not be worked out for it. Raises NotIdentifiable."""
        as_fitted = self.trial.subset is None or "result" in vars(self)
        return self.result.solution if as_fitted else self.trial.solution(self._entry)

    @cached_property
    def result(self) -> SessionSolution:
        """Everything else, too: other sets, what the tool is off by at most."""
        return self.trial.result(self._entry)

    @cached_property
    def tool_mm(self) -> float:
        """What the effect by itself does at the tool if nobody compensates it, r.m.s. over the
        workspace in the frame of the machine file.
        """
        machine = Model(self._geometry, effects=self.trial.placed(self._entry))
        return tool_error_free_of_mm(machine, FREE_IN[self.trial.frame])

    @cached_property
    def misled_mm(self) -> float:
        """What the tool is off by if the effect is there and parameters found without it are
        entered, r.m.s. over the workspace in the frame of the machine file.
        """
        model, former = self.solution.model, self.trial.without.solution.model
        machine = Model(self._geometry, model.parameters_mm, self.trial.placed(self._entry))
        commanded = commanded_with(self._geometry, former.parameters_mm)
        return tool_error_free_of_mm(machine, FREE_IN[self.trial.frame], commanded)

    def work_out(self) -> WhatIf:
        """`tool_mm` and `misled_mm`; later they and `solution` take no time.

        Raises NotIdentifiable.
        """
        _ = self.tool_mm, self.misled_mm
        return self

    @property
    def _geometry(self) -> Geometry:
        return self.trial.sessions[0].opened.machine.geometry()

    @property
    def _entry(self) -> EffectEntry:
        return self.trial.entry.held_at(self.values)


def what_if(
    sessions: Sequence[Session],
    effect: str,
    values: Sequence[float],
    subset: Subset | None = None,
    model: ModelFile | None = None,
) -> WhatIf:
    """Solve with an effect (``id:where``) of these values, each in its own unit, held.

    One of the ``model`` is held in place of being fitted. Raises UsageError for an effect or place
    that these readings cannot show, and for another number of values than it has; NotIdentifiable
    as `solve_sessions`.
    """
    if not sessions:
        raise NotIdentifiable("sessions", "none", "at least one session")
    model_file = model or ModelFile(machine=sessions[0].opened.machine)
    entries = [*model_file.effects, *_of_the_catalogue(sessions)]
    effect_id, _, where = f"{effect}".partition(":")
    of_it = [entry for entry in entries if entry.id == effect_id]
    fitting = [entry for entry in of_it if entry.where == where]
    if not fitting:
        allowed = [f"{entry.id}:{entry.where}" for entry in of_it] or [e.id for e in entries]
        raise UsageError("effect", repr(effect), ", ".join(dict.fromkeys(allowed)))
    model_entry = next((entry for entry in fitting if len(entry.parameters) == len(values)), None)
    if model_entry is None:
        numbers = " or ".join(sorted({str(len(entry.parameters)) for entry in fitting}))
        raise UsageError(f"values of {effect}", f"{len(values)}", numbers)
    trial = trial_of(Choice(model_entry, "undiagnosed"), sessions, model_file, subset)
    for parameter, value in zip(trial.parameters, values, strict=True):
        limit = min(parameter.limit, LARGEST_SIZE)
        least = max(-limit, parameter.least)
        check_number(f"size of {effect}, {parameter.name}", value, least, limit, parameter.unit)
    outcome = trial.at(values)
    try:
        _ = outcome.result, outcome.work_out()  # what cannot be worked out is said here
    except UnreachablePosture as problem:
        pairs = zip(values, outcome.units, strict=True)
        sizes = ", ".join(f"{value:g} {unit}" for value, unit in pairs)
        allowed_words = "a size with which the legs of this machine still meet"
        raise UsageError(f"size of {effect}", sizes, allowed_words) from problem
    return outcome


def _of_the_catalogue(sessions: Sequence[Session]) -> Iterator[EffectEntry]:
    """What these readings could show, parameters of the machine's geometry too, of size 0."""
    effects = known_effects()
    ids = {effect.id for effect in effects}
    model = _as_measured(sessions)
    law_of_id = {law.id: law for law in case_of(sessions[0], model).named_beyond}
    rare_laws = (law for law in BESIDE_CATALOGUE if law.id not in STATED_ONLY | law_of_id.keys())
    other_laws = (law for law in (*rare_laws, *law_of_id.values()) if law.id not in ids)
    conditions, laws = to_observations(sessions), (*effects, *other_laws)
    arrangements = candidates(model, conditions, laws)
    names = {(candidate.id, candidate.where) for candidate in arrangements}
    singles = (c for c in single_places(model, conditions, laws) if (c.id, c.where) not in names)
    place_of_id = {law.id: k for k, law in enumerate(laws)}
    together = axes_together(arrangements)
    unions = together[:1] if together else ()
    for candidate in sorted((*arrangements, *unions, *singles), key=lambda c: place_of_id[c.id]):
        yield _of_size_zero(candidate)


def _as_measured(sessions: Sequence[Session]) -> Model:
    """The machine with the parameters that the readings tell, else as it is stated.

    On a machine without errors readings stay the same, and a wrong gain does nothing.
    """
    try:
        return solve_sessions(sessions).solution.model
    except NotIdentifiable:
        return Model(sessions[0].opened.machine.geometry())


def _of_size_zero(candidate: Candidate) -> EffectEntry:
    shares = [(s, k, number) for s in candidate.shares for k, number in enumerate(s.values)]
    parameters = {}
    for number, parameter in enumerate(candidate.parameters):
        acting = [(share, k) for share, k, at in shares if at == number]
        parameters[parameter.name] = ParameterEntry(
            value=0.0,
            unit=parameter.unit,
            of=acting[0][0].effect.parameters[acting[0][1]].name,
            places=tuple(share.place for share, _ in acting),
        )
    return EffectEntry(
        id=candidate.id, where=candidate.where, title=candidate.title, parameters=parameters
    )


Standing = Literal["model", "named", "unnamed", "candidate", "undiagnosed"]


@dataclass(frozen=True, eq=False)
class Choice:
    """An effect that can be tried, and whether it is of the model, named, or a candidate.

    ``alike`` are those that these readings cannot tell from it; ``beside`` are named ones that are
    fitted beside it.
    """

    entry: EffectEntry
    standing: Standing
    alike: tuple[str, ...] = ()
    beside: tuple[EffectEntry, ...] = ()

    @property
    def key(self) -> tuple[str, str]:
        """Name and place."""
        return self.entry.id, self.entry.where


def choices(
    sessions: Sequence[Session],
    model: ModelFile | None = None,
    diagnosed: SessionDiagnosis | None = None,
) -> list[Choice]:
    """Effects to try: those of the model, then what was diagnosed, else all that could show."""
    every_choice: list[Choice] = []
    for entry in model.effects if model else ():
        unsure = entry.provenance is not None and entry.provenance.verdict == "ambiguous"
        alike = ("others that fitted as well",) if unsure else ()
        every_choice.append(Choice(entry, "model", alike))
    if diagnosed is not None:
        every_choice += _of_the_diagnosis(diagnosed.diagnosis)
    else:
        every_choice += [Choice(entry, "undiagnosed") for entry in _of_the_catalogue(sessions)]
    first: dict[tuple[str, str], Choice] = {}
    for choice in every_choice:
        first.setdefault(choice.key, choice)
    return list(first.values())


def trial_of(
    choice: Choice,
    sessions: Sequence[Session],
    model: ModelFile | None = None,
    subset: Subset | None = None,
) -> Trial:
    """The effect of this choice, to be moved beside the other effects of the model."""
    model_file = model or ModelFile(machine=sessions[0].opened.machine)
    other_effects = [entry for entry in model_file.effects if (entry.id, entry.where) != choice.key]
    trial_model = model_file.model_copy(update={"effects": (*other_effects, *choice.beside)})
    return Trial(tuple(sessions), trial_model, choice.entry, subset)


def _of_the_diagnosis(diagnosis: Diagnosis) -> Iterator[Choice]:
    """What was named, each beside the others; what it left; candidates in the place of all that."""
    findings = [(finding, _entry_of(finding)) for finding in diagnosis.effects if finding.effects]
    alike: dict[tuple[str, str], tuple[str, ...]] = {}
    for finding, entry in findings:
        other_entries = tuple(
            entry_of_other for _, entry_of_other in findings if entry_of_other is not entry
        )
        rivals = finding.indistinguishable_from
        yield Choice(entry, "named", tuple(f"{r.id} ({r.where})" for r in rivals), other_entries)
        alike |= {(r.id, r.where): (f"{finding.id} ({finding.where})",) for r in rivals}
    if diagnosis.left_over:
        other_entries = tuple(entry for _, entry in findings)
        yield Choice(_entry_of(diagnosis.left_over), "unnamed", (), other_entries)
    for rival in diagnosis.candidates:
        if rival.effects and rival.effects[0].effect.kind != Kind.GROSS_ERROR:
            yield Choice(_entry_of(rival), "candidate", alike.get((rival.id, rival.where), ()))


def _entry_of(finding: Finding | Contender) -> EffectEntry:
    values = {v.name: (v.value, v.standard_uncertainty) for v in finding.parameters}
    return effect_entry(finding.where, finding.effects, values)
