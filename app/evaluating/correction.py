"""What to enter in the controller: one answer for whatever it holds, worked out once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Self

from calib.arrays import LEG_NAMES, FloatArray, Observations
from calib.errors import ImpossibleRequest, NotIdentifiable
from calib.noise.reading import IndicatorFigures, Noise
from calib.posterior.cells import FINEST_MM, HOMING_MM, Cells, SessionCase
from calib.posterior.correction import HOLDS, Correction, Holds, ToolOff, correction, doubt
from calib.posterior.entered import (
    nothing_entered,
    offset_uncertainties_mm,
    tower_values,
    values_of,
)
from calib.posterior.models import LikelyMistake, Posterior
from calib.posterior.posterior import posterior
from calib.quantity import INTERNAL
from calib.tripod.controller import left_by_tables_mm, table_of
from calib.tripod.effects.drives import Backlash
from calib.tripod.effects.effect import AdoptedLaws, EffectInstance
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model, Stage
from protocols.observations import indicator_figures, measured_distances, to_observations

if TYPE_CHECKING:
    from calib.tripod.effects.effect import Effect
    from calib.tripod.pipeline import StageEffect
    from calib.tripod.towers import EnteredTowers, TowerEntries
    from protocols.machine import Frame, Machine
    from protocols.session import Session

JOINT_OFFSETS = PARAMETER_NAMES[:3]

NO_PLAY = "the expected play is negative, and no joint has that"
NO_GAIN = "the readings show the travel of its carriage too poorly for an entry"
NO_ENTRY = "no value for the travel of a carriage is entered, and others follow it too poorly"

LIKELY = 0.02
"""From this probability on a mistake in the readings is named; sound sessions hardly have it."""

CLEARLY_BETTER = 0.9
"""Values that are worth entering leave less than this share of the bound as it is now."""


@dataclass(frozen=True)
class EnteredValue:
    """A number to enter, in its unit; d_rho and d_L are true less believed.

    Uncertainties are of joint offsets that are entered alone, over all models (95 %); else None.
    """

    value: float
    unit: str
    standard_uncertainty: float | None = None
    expanded_uncertainty: float | None = None


@dataclass(frozen=True)
class Gain:
    """What the tool is off by at most where the same controller holds something else.

    It is ``clear`` where that is clearly less than with the correction that is asked for.
    """

    holds: Holds
    bound_mm: float
    clear: bool = field(metadata=INTERNAL)


@dataclass(frozen=True, eq=False)
class SessionCorrection(Correction):
    """The best values that a controller can hold, and what the tool keeps with them.

    ``model`` is the machine as the controller then knows it; ``off_now`` and ``off`` are the tool
    without and with the values. ``uncertainties_mm`` of joint offsets that are entered alone are
    standard, and expanded for 95 %, ``(3,)`` each.
    """

    off_now: ToolOff
    uncertainties_mm: tuple[FloatArray, FloatArray] | None

    @property
    def values(self) -> dict[str, EnteredValue]:
        """Values to enter by name: d_rho of all joints, d_L and sizes of effects where they are not
        0.
        """
        parameters_mm = zip(PARAMETER_NAMES, self.model.parameters_mm, strict=True)
        uncertainties: dict[str, tuple[float, float]] = {}
        if self.uncertainties_mm is not None:
            columns = (column.tolist() for column in self.uncertainties_mm)
            uncertainties = dict(zip(JOINT_OFFSETS, zip(*columns, strict=True), strict=True))
        values = {
            name: EnteredValue(float(mm), "mm", *uncertainties.get(name, ()))
            for name, mm in parameters_mm
            if name in JOINT_OFFSETS or mm
        }
        for effect in self.model.effects:
            if isinstance(effect, EffectInstance):
                for parameter, value in zip(effect.effect.parameters, effect.values, strict=True):
                    name = f"{effect.id} {effect.place}: {parameter.name}"
                    values[name] = EnteredValue(float(value.real), parameter.unit)
        return values

    @property
    def joint_offsets_mm(self) -> tuple[float, float, float]:
        """d_rho of joints x, y, z."""
        x, y, z = self.model.parameters_mm[:3]
        return x, y, z

    @property
    def bound_mm(self) -> float:
        """What 95 of 100 such machines keep in the chosen frame."""
        return self.off.bound_in(self.frame)

    @property
    def now_mm(self) -> float:
        """Bound of the tool error with the present values of the controller."""
        return self.off_now.bound_in(self.frame)

    @property
    def helps(self) -> bool:
        """Whether the tool is bounded clearly more closely with these values than now."""
        return self.bound_mm < CLEARLY_BETTER * self.now_mm


@dataclass(frozen=True, eq=False)
class TowerCorrection(Correction):
    """The best ``values`` for firmware of printers, and the tool with them.

    They are fitted to the ``model``; ``left_out`` are parts that it does not have.
    """

    values: EnteredTowers


@dataclass(frozen=True)
class OffsetChange:
    """A joint offset that is another in a session, counted from 0, than in the one before, mm."""

    session: int
    joint: str
    change_mm: float


UNEXPECTED = 4.0
"""Standard deviations, and times what homing changes: of so much a person must know."""


@dataclass(frozen=True, eq=False)
class ControllerCorrections:
    """Sessions of one machine as they are corrected in a frame; each answer is worked out once.

    Joint offsets are those of the last session. ``effects`` are looked for; None: the catalogue.
    ``known_posterior`` is that where it was worked out already.
    """

    cases: tuple[SessionCase, ...]
    frame: Frame
    effects: tuple[Effect, ...] | None = None
    known_posterior: Posterior | None = None
    _corrections: dict[tuple[Holds, tuple[tuple[str, str], ...]], SessionCorrection] = field(
        default_factory=dict
    )
    _towers: dict[TowerEntries, TowerCorrection] = field(default_factory=dict)

    @classmethod
    def of_sessions(
        cls,
        sessions: Sequence[Session],
        model: Model,
        frame: Frame | None = None,
        effects: Sequence[Effect] | None = None,
        free: AdoptedLaws | None = None,
    ) -> Self:
        """``model`` has the effects of an adopted model; sizes of those that are ``free`` vary.

        Without a ``frame`` it is that of the machine as it was last.
        """
        nominal = Model(model.geometry).with_effects(model.effects)
        cases = tuple(case_of(session, nominal, free) for session in sessions)
        frame = frame or sessions[-1].opened.machine.frame
        return cls(cases, frame, None if effects is None else tuple(effects))

    @cached_property
    def posterior(self) -> Posterior:
        """What the sessions tell of the machine. Raises NotIdentifiable."""
        if self.known_posterior is not None:
            return self.known_posterior
        if not any(case.shows for case in self.cases):
            raise NotIdentifiable(
                "readings",
                "no two postures of one mounting",
                "readings of one indicator, or contacts, in two postures or more",
                "Move the machine and measure again.",
            )
        return posterior(self.cases, self.effects)

    def with_posterior(self, posterior: Posterior) -> Self:
        """These sessions, corrected by another posterior of them."""
        return replace(self, known_posterior=posterior, _corrections={}, _towers={})

    @cached_property
    def noise(self) -> Noise | None:
        """Noise of a single reading as the posterior has it; all figures of noise are from it.

        None where repeats and indicators tell nothing of one of the sessions.
        """
        noises = [noise for cells in self.posterior.sessions if (noise := _noise_of(cells))]
        return Noise.of_sessions(noises) if len(noises) == len(self.cases) else None

    @cached_property
    def mistakes(self) -> tuple[LikelyMistake, ...]:
        """Mistakes of labels and readings that are likely, the likeliest first."""
        return tuple(
            mistake for mistake in self.posterior.likely_mistakes if mistake.probability >= LIKELY
        )

    @cached_property
    def offset_changes(self) -> tuple[OffsetChange, ...]:
        """Joint offsets that changed between sessions of one state of the machine by more than
        homing does and what was entered tells.
        """
        changes = []
        for number, (earlier, later) in enumerate(pairwise(self.cases), start=1):
            if later.state is None or later.state != earlier.state:
                continue
            means, deviations = (part.tolist() for part in self.posterior.offset_change(number))
            entered = zip(later.entered_mm, earlier.entered_mm, strict=True)
            for joint, mean, deviation, (now, then) in zip(
                LEG_NAMES, means, deviations, entered, strict=True
            ):
                change_mm = mean + now - then
                if abs(change_mm) > UNEXPECTED * max(deviation, HOMING_MM):
                    changes.append(OffsetChange(number, joint, change_mm))
        return tuple(changes)

    @cached_property
    def off_now(self) -> ToolOff:
        """The tool with the present values of the controller."""
        return ToolOff(self.posterior, nothing_entered(self.posterior))

    @property
    def is_worked_out(self) -> bool:
        """Whether the answer for every controller is there."""
        corrections = [*self._corrections]  # a copy: another thread may be working them out
        return {holds for holds, absent in corrections if not absent} == set(HOLDS)

    def off(self, model: Model) -> ToolOff:
        """The tool where the controller holds this model. Raises ImpossibleRequest."""
        return ToolOff(self.posterior, values_of(self.posterior.field, model))

    def off_with_towers(self, entered: EnteredTowers, along: Sequence[StageEffect] = ()) -> ToolOff:
        """The tool with values for firmware of printers, effects ``along`` drives in the joints."""
        joints = Model(self.posterior.geometry).with_effects(tuple(along))
        values = tower_values(self.posterior, entered) + values_of(self.posterior.field, joints)
        return ToolOff(self.posterior, values)

    def of_towers(self, entries: TowerEntries) -> TowerCorrection:
        """The values for firmware of printers that has these entries; each is worked out once.

        What it has no entry for, such as towers that lean, other entries follow over the
        workspace. Travels are entered, or followed, where that passes the gate of any part of a
        correction. Raises ImpossibleRequest for a machine without upright towers.
        """
        if entries not in self._towers:
            from calib.tripod.towers import entered  # of printers only

            def best(absent: dict[str, str], entries: TowerEntries) -> TowerCorrection:
                projected = self._projected("kinematics", absent, tabled=False)
                values = entered(projected.model, entries)
                with_towers = replace(projected, off=self.off_with_towers(values))
                return TowerCorrection(**vars(with_towers), values=values)

            best_entries = best({}, entries)
            reason = NO_GAIN if entries.travels else NO_ENTRY
            plain = best({"table": reason}, replace(entries, travels=False))
            errors = self.posterior.likeliest_labels.tool_errors[self.frame]
            if doubt(errors, best_entries.off.values, plain.off.values):
                best_entries = plain
            self._towers[entries] = best_entries
        return self._towers[entries]

    def of(self, holds: Holds, absent: Mapping[str, str] | None = None) -> SessionCorrection:
        """The correction for a controller that holds this; ``absent`` as `correction` has them.

        Play that comes out negative and tables that the controller cannot follow are absent, too.
        """
        key = (holds, tuple(sorted((absent or {}).items())))
        if key in self._corrections:
            return self._corrections[key]
        projected = self._projected(holds, dict(absent or {}), tabled=True)
        if holds in ("tables", "kinematics"):
            left_mm = left_by_tables_mm(projected.model)
            off = ToolOff(projected.off.posterior, projected.off.values, left_mm)
            projected = replace(projected, off=off)
        uncertainties_mm = self.uncertainties_mm() if holds == "offsets" else None
        self._corrections[key] = SessionCorrection(
            **vars(projected), off_now=self.off_now, uncertainties_mm=uncertainties_mm
        )
        return self._corrections[key]

    def _projected(self, holds: Holds, absent: dict[str, str], *, tabled: bool) -> Correction:
        """What a controller holds, in tables of so many points where it is ``tabled``."""
        while True:
            projected = correction(self.posterior, holds, self.frame, absent, tabled=tabled)
            impossible = _impossible(projected.model, tabled=tabled)
            if not impossible.keys() - absent.keys():
                return projected
            absent = absent | impossible

    def uncertainties_mm(self, *, less_common: bool = False) -> tuple[FloatArray, FloatArray]:
        """Uncertainties of joint offsets entered alone: standard, and expanded for 95 %, ``(3,)``
        each.
        """
        return offset_uncertainties_mm(self.posterior, self.frame, less_common=less_common)

    def others(self, correction: SessionCorrection) -> tuple[Gain, ...]:
        """What the same controller would keep if it held something else, or all of the same."""
        corrections = {holds: self.of(holds) for holds in HOLDS}
        return tuple(
            Gain(holds, answer.bound_mm, answer.bound_mm < CLEARLY_BETTER * correction.bound_mm)
            for holds, answer in corrections.items()
            if answer is not correction
        )

    @property
    def more_helps(self) -> bool:
        """Whether more than joint offsets leaves clearly less than they do, and than now."""
        gains = self.others(self.of("offsets"))
        return any(gain.clear and self.of(gain.holds).helps for gain in gains)


def case_of(session: Session, model: Model, free: AdoptedLaws | None = None) -> SessionCase:
    """A session with the load that its tool carried; laws that are ``free`` as in its case.

    Joint offsets are those of sessions between which no part was moved, less what was entered.
    """
    readings = to_observations([session]), indicator_figures([session])
    case = case_of_machine(session.opened.machine, model, free, *readings)
    return replace(case, distances=measured_distances(session))


def case_of_machine(
    machine: Machine,
    model: Model,
    free: AdoptedLaws | None,
    observations: Observations,
    indicator: IndicatorFigures,
) -> SessionCase:
    """Readings of a machine with what is known of it beforehand; else as `case_of`."""
    return SessionCase(
        replace(model, geometry=replace(model.geometry, load=machine.load)),
        observations,
        indicator,
        machine.tolerances_mm(),
        free=free or {},
        geometry=machine.geometry_tolerances(),
        state=(machine.name, machine.adjusted),
        entered_mm=machine.entered_offsets_mm,
        length_correlation=machine.length_correlation,
        radius_mm=machine.radius_tolerance_mm,
    )


def _noise_of(cells: Cells) -> Noise | None:
    """Noise of a session. Errors that follow each other are larger than their repeats show."""
    if cells.noise is None or not cells.serial:
        return cells.noise
    shown_mm2 = cells.noise.repeatability_mm2(cells.visits).clip(FINEST_MM**2)
    return cells.noise.scattering(float(cells.scatter_mm2.sum() / shown_mm2.sum()))


def _impossible(model: Model, *, tabled: bool) -> dict[str, str]:
    """Parts of a correction that no joint takes, and why."""
    reasons = {
        f"play of {effect.place}": NO_PLAY
        for effect in model.effects
        if isinstance(effect, EffectInstance)
        and isinstance(effect.effect, Backlash)
        and effect.values[0].real < 0.0
    }
    for joint, leg in enumerate(LEG_NAMES if tabled else ()):
        along = [effect for effect in model.effects if effect.stage == Stage.ACTUATOR]
        if all(isinstance(effect, EffectInstance) and effect.place != leg for effect in along):
            continue
        try:
            table_of(model, joint)
        except ImpossibleRequest as problem:
            reasons[f"table of {leg}"] = problem.found
    return reasons
