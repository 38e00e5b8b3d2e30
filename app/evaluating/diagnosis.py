"""From session files to a diagnosis: what the command, the screen and other programs share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Annotated

from app.evaluating.correction import ControllerCorrections, case_of
from app.evaluating.loading import load_sessions
from app.evaluating.own_effects import known_effects
from app.evaluating.printer import printer_change
from app.evaluating.solution import refuse_leaning_planes
from calib.arrays import LEG_NAMES
from calib.diagnosis.claims import conditional
from calib.diagnosis.diagnose import diagnosis_of
from calib.diagnosis.results import Contender, Diagnosis, EffectName, Finding
from calib.errors import NotIdentifiable, RecordError, UsageError
from calib.noise.reading import Noise
from calib.posterior.cells import Cells
from calib.posterior.correction import HOLDS, Holds, correction
from calib.posterior.measurements import USUAL_PACE, FurtherMeasurement, Pace, candidates
from calib.posterior.planning import Planner, Reach, Separation
from calib.posterior.tool import Frame
from calib.quantity import Quantity
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import AdoptedLaws, Effect, Kind
from calib.tripod.effects.empirical import EMPIRICAL
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model
from protocols.data_table import DataTable, Tabled
from protocols.effect_entries import (
    EffectEntry,
    Provenance,
    with_effect,
    with_sizes,
    without_effect,
)
from protocols.files import write_files
from protocols.journal import write_whole
from protocols.machine import Machine
from protocols.model_file import (
    ModelFile,
    ambiguity,
    ambiguous_effects,
    effect_entry,
    entries_of_laws,
    free_effects,
    model_file,
    read_model_file,
    to_model,
    with_expected,
)
from protocols.motion import seconds_per_step
from protocols.observations import changed_between, corrected_readings
from protocols.record import read_record
from protocols.session import Closed, Line, Opened, Reading, Session, Superseded


@dataclass(frozen=True)
class RankedSize:
    """The size of a named effect or of a candidate, and why it is one."""

    effect: Annotated[str, Quantity("effect", words="id of the effect")]
    where: Annotated[str, Quantity("where", words="leg, axis or place where it acts")]
    parameter: Annotated[str, Quantity("parameter", words="which of its parameters")]
    value: Annotated[
        float, Quantity("value", kind="measured", words="size of the parameter, in its unit")
    ]
    standard_uncertainty: Annotated[
        float, Quantity("u", kind="uncertainty", words="standard uncertainty of the size")
    ]
    unit: Annotated[str, Quantity("unit", words="unit of both")]
    probability: Annotated[
        float, Quantity("likely", kind="probability", words="probability that it acts there")
    ]
    gap_rms_after_mm: Annotated[
        float, Quantity("gap after", "mm", "plain", 4, "r.m.s. of the gap that it leaves")
    ]
    standing: Annotated[str, Quantity("why", words="named, or the reason why it is not")]


@dataclass(frozen=True, eq=False)
class SessionDiagnosis(Tabled):
    """A diagnosis with the sessions it was made from, ``others`` for the gap alone."""

    sessions: tuple[Session, ...]
    others: tuple[Session, ...]
    corrections: ControllerCorrections
    model: Model
    diagnosis: Diagnosis
    warnings: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sessions that were diagnosed."""
        return tuple(session.name for session in self.sessions)

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names of the others."""
        return tuple(session.name for session in self.others)

    @property
    def noise(self) -> Noise | None:
        """Noise of a single reading; None where repeats and indicators tell nothing."""
        return self.corrections.noise

    @property
    def names_geometry(self) -> bool:
        """Whether a parameter of the machine is named, which the fit has within its tolerance."""
        case = self.corrections.posterior.sessions[-1].with_free_lines.case
        ids = {law.id for law in case.named_beyond}
        return any(effect.id in ids for effect in self.diagnosis.effects)

    def table(self) -> DataTable:
        """A row for each size of what was named, then of the other candidates, best first."""
        names = {(effect.id, effect.where) for effect in self.diagnosis.effects}
        candidates = (c for c in self.diagnosis.candidates if (c.id, c.where) not in names)
        ranked: list[tuple[Finding | Contender, str]] = [
            *((effect, "named") for effect in self.diagnosis.effects),
            *((candidate, candidate.reason_rejected) for candidate in candidates),
        ]
        return DataTable.of(
            RankedSize,
            (
                RankedSize(
                    *(effect.id, effect.where, size.name, size.value, size.standard_uncertainty),
                    *(size.unit, effect.probability, effect.gap_rms_after_mm, standing),
                )
                for effect, standing in ranked
                for size in effect.parameters
            ),
        )

    @cached_property
    def tool(self) -> DiagnosedTool:
        """What the tool is off by, now and with values entered."""
        return self._tool(self.corrections)

    def _tool(self, corrections: ControllerCorrections) -> DiagnosedTool:
        return DiagnosedTool.of(corrections, self.sessions[-1].opened.machine)

    def adopted_tool(self, candidate: str | None = None) -> AdoptedTool | None:
        """What the tool is off by if the names are true that `adopt` takes with this candidate.

        None where no model has all of them. Raises UsageError where there is nothing to adopt.
        """
        names = tuple(EffectName(effect.id, effect.where) for effect in _chosen(self, candidate))
        posterior = conditional(self.corrections.posterior, names)
        if posterior is None:
            return None
        return AdoptedTool(names, self._tool(self.corrections.with_posterior(posterior)))

    @cached_property
    def separation(self) -> Separation | None:
        """The measurement that separates the names that stay open; None where none does."""
        if self.diagnosis.verdict in ("agrees", "explained"):
            return None
        return self._planner(self._set_ups()).separation

    def work_out(self) -> SessionDiagnosis:
        """Work out the tool error and the next measurement: later they take no time."""
        _ = self.tool, self.separation
        return self

    def reach(self) -> Reach | None:
        """The bound at the tool after further set-ups; None where no set-up of a leg is known."""
        opened, pace = self.sessions[-1].opened, USUAL_PACE
        if opened.machine.motion is not None and opened.procedure is not None:
            step_s = seconds_per_step(opened.machine, opened.procedure)
            pace = Pace(seconds_per_step=step_s)
        ways = tuple(way for way in self._set_ups(pace) if way.is_way)
        return self._planner(ways).reach if ways else None

    def _set_ups(self, pace: Pace = USUAL_PACE) -> tuple[FurtherMeasurement, ...]:
        """Further set-ups of indicators on legs; none for contacts: a printer has no stand."""
        if all(session.of_contacts for session in self.sessions):
            return ()
        return tuple(candidates(self.corrections.posterior, pace))

    def _planner(self, measurements: tuple[FurtherMeasurement, ...]) -> Planner:
        weighted = self.corrections.posterior
        entered = correction(weighted, "offsets", self.corrections.frame)
        return Planner(weighted, entered, measurements)


@dataclass(frozen=True)
class DiagnosedTool:
    """Bounds of the tool error in a frame, r.m.s. over the workspace, mm: now, and with values
    entered, by what a controller holds.

    ``firmware_mm`` is with all that the firmware of a printer holds; None for another machine.
    """

    frame: Frame
    now_mm: float
    entered_mm: dict[Holds, float]
    firmware_mm: float | None

    @classmethod
    def of(cls, corrections: ControllerCorrections, machine: Machine) -> DiagnosedTool:
        """The tool with each correction of these sessions."""
        entered_mm: dict[Holds, float] = {holds: corrections.of(holds).bound_mm for holds in HOLDS}
        change = printer_change(machine, corrections)
        now_mm = corrections.off_now.bound_in(corrections.frame)
        return cls(corrections.frame, now_mm, entered_mm, change.bound_mm if change else None)


@dataclass(frozen=True, eq=False)
class AdoptedTool:
    """The error of the ``tool`` if the adopted ``names`` are true."""

    names: tuple[EffectName, ...]
    tool: DiagnosedTool


def diagnose_files(
    paths: Sequence[Path],
    *,
    model: Path | None = None,
    held_out: Sequence[Path] = (),
    effects: Sequence[Effect] | None = None,
) -> SessionDiagnosis:
    """Diagnose files as `diagnose_sessions` does, with their warnings. Raises RecordError, too."""
    sessions, warnings = load_sessions(paths)
    held_out_sessions, more_warnings = load_sessions(held_out)
    diagnosed = diagnose_sessions(
        sessions, model=model, held_out=held_out_sessions, effects=effects
    )
    return replace(diagnosed, warnings=(*warnings, *more_warnings, *diagnosed.warnings))


def diagnose_sessions(
    sessions: Sequence[Session],
    *,
    model: Path | None = None,
    held_out: Sequence[Session] = (),
    effects: Sequence[Effect] | None = None,
    catalogue_corrections: ControllerCorrections | None = None,
) -> SessionDiagnosis:
    """Diagnose sessions against their nominal machine, or against a model with effects.

    ``held_out`` are sessions for the gap alone, ``effects`` are looked for in place of
    all that are known. Sessions may have different joint offsets entered; their geometry must be
    one. ``catalogue_corrections`` are those of the same sessions by the catalogue alone: their
    posterior is taken where it is that of the diagnosis. Raises UsageError and NotIdentifiable.
    """
    if not sessions:
        raise NotIdentifiable("sessions", "none", "at least one session")
    _check(sessions, held_out)
    effects = known_effects() if effects is None else effects
    nominal = Model(sessions[0].opened.machine.geometry())
    warnings: list[str] = []
    free: AdoptedLaws = {}
    if model:
        model_file = read_model_file(model)
        nominal = to_model(model_file, f"model {model}", effects)
        free = free_effects(model_file, effects)
        warnings += [doubt] if (doubt := ambiguity(ambiguous_effects(model_file))) else []
    corrections = ControllerCorrections.of_sessions(sessions, nominal, effects=effects, free=free)
    if catalogue_corrections is not None and model is None and tuple(effects) == tuple(CATALOGUE):
        corrections = corrections.with_posterior(catalogue_corrections.posterior)
    for session, case in zip(sessions, corrections.cases, strict=True):
        if case.observations.over_plane.any():
            refuse_leaning_planes([session], Cells.of(case).model, case.observations)
    return SessionDiagnosis(
        sessions=tuple(sessions),
        others=tuple(held_out),
        corrections=corrections,
        model=nominal,
        diagnosis=diagnosis_of(
            corrections.posterior, [case_of(session, nominal) for session in held_out]
        ),
        warnings=tuple(warnings),
    )


def _check(sessions: Sequence[Session], held_out: Sequence[Session]) -> None:
    """One geometry for all, and no session on both sides."""
    # a copy has another path, but it began at the same moment
    if {each_session.opened.at for each_session in sessions} & {
        each_session.opened.at for each_session in held_out
    }:
        raise UsageError(
            "--held-out",
            "a session that is also diagnosed",
            "sessions that the choice does not use",
            "Leave it out on one side.",
        )
    if len({session.adjusted for session in (*sessions, *held_out)}) > 1:
        raise changed_between("sessions diagnosed together", "diagnose")
    geometries = {
        replace(session.opened.machine.geometry(), load=1.0) for session in (*sessions, *held_out)
    }
    if len(geometries) > 1:
        raise UsageError(
            "sessions of different machines",
            f"{len(geometries)} geometries",
            "sessions of one machine; entered offsets and load may differ",
            "Diagnose them one at a time.",
        )


MOST_OFFERED = 8


def left_behind(diagnosed: SessionDiagnosis, candidate: str | None) -> bool:
    """Whether adopting this leaves an unnamed effect that could be adopted, too."""
    diagnosis = diagnosed.diagnosis
    has_effects = any(finding.effects for finding in diagnosis.effects)
    return candidate is None and has_effects and diagnosis.left_over is not None


def adopt(
    diagnosed: SessionDiagnosis,
    target: Path,
    *,
    known_model: Path | None = None,
    candidate: str | None = None,
    held: EffectEntry | None = None,
    replace: bool = False,
) -> ModelFile:
    """Write a model with the named effects added, or with one candidate (``id`` or ``id:where``).

    ``empirical`` as candidate adds what was named and the unnamed effect of the residuals; where
    nothing was named it is added without asking for it. Gross errors are mistakes of the data and
    are never adopted. One of what is adopted may be ``held`` as a person has it, the others are
    fitted. The known model itself goes on with its history, another file is kept unless
    ``replace``. Raises UsageError where there is nothing to adopt, FilesThere, and RecordError
    where the file cannot be written.
    """
    items = _chosen(diagnosed, candidate)
    machine = diagnosed.sessions[-1].opened.machine
    model = read_model_file(known_model) if known_model else model_file(diagnosed.model, machine)
    source = Provenance(
        sessions=diagnosed.names,
        digests=tuple(session.digest for session in diagnosed.sessions),
        measured=max(item.opened.at for item in diagnosed.sessions),
        found=datetime.now(UTC),
        verdict=diagnosed.diagnosis.verdict,
    )
    doubted = [item for item in items if isinstance(item, Finding) and item.indistinguishable_from]
    for item in items:
        sure = source.verdict == "ambiguous" and doubted and item not in doubted
        verdict_source = source.model_copy(update={"verdict": "explained"}) if sure else source
        why = diagnosed.diagnosis.sentence
        if isinstance(item, Finding) and item.id == EMPIRICAL:
            why = f"an unnamed effect: {item.title}"
        values = {v.name: (v.value, v.standard_uncertainty) for v in item.parameters}
        entry = effect_entry(item.where, item.effects, values, verdict_source)
        if held and (held.id, held.where) == (item.id, item.where):
            entry = entry.model_copy(update={"parameters": held.parameters})
            why = f"{why} {HELD}"
        for law_entry in entries_of_laws(entry):
            model = with_effect(model, law_entry, why)
    model = _expected(model, diagnosed.sessions)
    write_files(target, {"": model.text()}, replace=replace or target == known_model)
    return model


HELD, FREED = "Its size is held at the stated value.", "Its size is fitted again."


def resize(sessions: Sequence[Session], target: Path, entry: EffectEntry) -> ModelFile:
    """Write the model of ``target`` with an effect that it has as ``entry`` has it.

    Everything that is not held is fitted again to the sessions. Raises RecordError.
    """
    is_held = any(parameter.held for parameter in entry.parameters.values())
    model = with_sizes(read_model_file(target), entry, HELD if is_held else FREED)
    model = _expected(model, sessions)
    write_files(target, {"": model.text()}, replace=True)
    return model


def _expected(model: ModelFile, sessions: Sequence[Session]) -> ModelFile:
    """The model with parameters and sizes as the posterior of the sessions expects them given it.

    Where sessions had different offsets entered there are none to state: what nobody fitted is not
    0.
    """
    effects = known_effects()
    corrections = ControllerCorrections.of_sessions(
        sessions, to_model(model, "model", effects), free=free_effects(model, effects)
    )
    posterior = corrections.posterior
    model = with_expected(model, posterior.size_of, effects)
    if len({session.opened.machine.entered_offsets_mm for session in sessions}) > 1:
        parameters_mm = {name: mm for name, mm in model.parameters_mm.items() if mm}
        return model.model_copy(update={"parameters_mm": parameters_mm})
    values = zip(PARAMETER_NAMES, posterior.mean.tolist(), strict=False)  # the first of the field
    return model.model_copy(update={"parameters_mm": dict(values)})


def mistakes_of(diagnosed: SessionDiagnosis) -> list[Finding]:
    """The gross errors that were named, in the order found."""
    return [effect for effect in diagnosed.diagnosis.effects if effect.kind == Kind.GROSS_ERROR]


def correct(diagnosed: SessionDiagnosis, source: Path, target: Path) -> None:
    """Write the record ``source`` once more with what was named put right, and say why in it.

    A stand that moved gives a new mounting from there on; a reading that belongs nowhere is
    superseded. Raises UsageError where there is nothing to correct, or not one session, and
    RecordError where the session is not finished or the file exists.
    """
    mistakes = mistakes_of(diagnosed)
    if len(diagnosed.sessions) != 1:
        count_words = f"{len(diagnosed.sessions)} sessions"
        raise UsageError("--correct", count_words, "one session", "Correct them one at a time.")
    if not mistakes:
        verdict = (
            f"no mistake in the readings was named; the verdict is '{diagnosed.diagnosis.verdict}'"
        )
        raise UsageError("--correct", verdict, "a diagnosis that names one")
    record = read_record(source)
    if record.end != "closed":
        raise RecordError(
            f"session {source}",
            "not finished",
            "a closed record",
            "Finish it first: glidecal run --continue.",
        )
    session, cleaned = diagnosed.sessions[0], diagnosed.diagnosis.cleaned[0]
    why = "; ".join(f"{item.title} ({item.where})" for item in mistakes)
    origin = f"Corrected from {source.name}, digest {record.digest}: {why}."
    changed = {item.reading: item for item in corrected_readings(session, cleaned)}
    events: list[Line] = [
        changed.get(item.reading, item) if isinstance(item, Reading) else item
        for item in record.events
        if not isinstance(item, Opened | Closed)
    ]
    kept_rows = set(cleaned.rows.tolist())
    readings_left_out = tuple(
        item.reading for row, item in enumerate(session.readings) if row not in kept_rows
    )
    if readings_left_out:
        events.append(Superseded(readings=readings_left_out, reason=why))
    opened = record.opened
    remarks = (*opened.remarks, origin)
    write_whole(target, opened.model_copy(update={"remarks": remarks}), events)


def remove(path: Path, effect: str, why: str) -> ModelFile:
    """Take an effect (``id`` or ``id:where``) out of a model; the history keeps it."""
    name, _, where = effect.partition(":")
    model = without_effect(read_model_file(path), name, where or None, why)
    write_files(path, {"": model.text()}, replace=True)
    return model


def _chosen(diagnosed: SessionDiagnosis, candidate: str | None) -> list[Finding | Contender]:
    diagnosis = diagnosed.diagnosis
    effects: list[Finding | Contender] = [e for e in diagnosis.effects if e.effects]
    unnamed: list[Finding | Contender] = [diagnosis.left_over] if diagnosis.left_over else []
    if candidate is None:
        if not effects and not unnamed:
            raise UsageError(
                "--adopt",
                f"the verdict '{diagnosis.verdict}' names no effect",
                "a named effect, or one of the candidates by --candidate ID:WHERE",
            )
        return effects or unnamed
    name, _, where = candidate.partition(":")
    if name == EMPIRICAL and unnamed and where in ("", unnamed[0].where):
        return [*effects, *unnamed]
    fitting = [
        choice
        for choice in diagnosis.candidates
        if choice.id == name and where in ("", choice.where) and choice.effects
    ]
    if not fitting:
        contenders = [*unnamed, *diagnosis.candidates[:MOST_OFFERED]]
        offered_words = ", ".join(f"{choice.id}:{choice.where}" for choice in contenders)
        raise UsageError("--candidate", repr(candidate), offered_words or "no candidate at all")
    return [fitting[0]]


def write_procedure(diagnosed: SessionDiagnosis, path: Path, *, replace: bool = False) -> None:
    """The proposed measurement as a procedure file. Raises UsageError where there is none."""
    separation = diagnosed.separation
    if separation is None:
        legs = all(r.leg in LEG_NAMES for session in diagnosed.sessions for r in session.readings)
        raise UsageError(
            "--next",
            "no two effects that a measurement would decide between",
            "a diagnosis that proposes a measurement",
            "To lower the bound at the tool nevertheless: glidecal plan SESSION." if legs else "",
        )
    text = separation.candidate.text
    if not text.startswith("schema"):
        raise UsageError(
            "--next",
            f"'{text}', a procedure that comes with the program",
            "a proposal that needs a file",
            f"Measure it with: glidecal run --protocol {text}",
        )
    write_files(path, {"": text}, replace=replace)
