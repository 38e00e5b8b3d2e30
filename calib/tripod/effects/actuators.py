"""Effects of screws and carriages: errors along an actuator's own axis."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.tripod.effects.effect import (
    BOTH_WAYS,
    PER_THOUSAND,
    REPEATABLE,
    Acting,
    Effect,
    EffectParameter,
    Kind,
    OfCarriageOrBar,
    travel,
)
from calib.tripod.effects.environment import kelvins
from calib.tripod.geometry import Geometry
from calib.tripod.movements import last_movement
from calib.tripod.pipeline import Stage

STANDARD_LEADS_MM = (4.0, 5.0, 10.0, 20.0)
"""Leads that are tried first where the machine file does not name the screw's."""

ISO_LEADS_MM = (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0)
"""Leads of ball screws, ISO 3408-2: one of them goes before another that fits as well."""


LEAD = re.compile(r"(?:sine|cosine)_([0-9]{1,4}(?:\.[0-9]{1,4})?)mm")


@dataclass(frozen=True)
class ActuatorScale(OfCarriageOrBar):
    """Travel is wrong in proportion; positive: the carriage travels further than commanded."""

    id: str = "actuator_scale"
    title: str = "a carriage travels too far or too short in proportion to its travel"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.ACTUATOR
    parameters: tuple[EffectParameter, ...] = (EffectParameter("scale", "mm/m", 0.1),)
    invariances: tuple[str, ...] = (*REPEATABLE, "changes sign with travel")
    controller: str = (
        "joint {place}: multiply SCALE by 1 − ({scale}), or COMP_FILE of export --format linuxcnc"
    )

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The carriage is off by a part of its commanded travel."""
        return np.asarray(PER_THOUSAND * at.values[0] * travel(at.flow, at.leg))


@dataclass(frozen=True)
class ActuatorCyclic(OfCarriageOrBar):
    """Travel is wrong with the screw's turn: a sine and a cosine, zero at Zero."""

    lead_mm: float
    id: str = "actuator_cyclic"
    title: str = "a screw's error repeats with every turn"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.ACTUATOR
    invariances: tuple[str, ...] = (*REPEATABLE, "repeats after one lead of travel")
    controller: str = "joint {place}: COMP_FILE of export --format linuxcnc"

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Two amplitudes; their names tell the lead."""
        ending = f"{self.lead_mm:g}mm"
        return (
            EffectParameter(f"sine_{ending}", "µm", 5.0, 100.0),
            EffectParameter(f"cosine_{ending}", "µm", 5.0, 100.0),
        )

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The carriage is off by a sin t + b (cos t - 1), t one turn for each lead of travel."""
        turn = 2 * np.pi * travel(at.flow, at.leg) / self.lead_mm
        error = at.values[0] * np.sin(turn) + at.values[1] * (np.cos(turn) - 1.0)
        return np.asarray(PER_THOUSAND * error)


@dataclass(frozen=True)
class ScrewGrowth(OfCarriageOrBar):
    """A screw grows from its fixed bearing, where the coordinate is 0, with the temperature.

    Steel: 11.5 µm/m K. Kelvins count from 20 °C.
    """

    id: str = "thermal_growth"
    title: str = "a screw grows with the temperature"
    kind: Kind = Kind.ENVIRONMENT
    stage: Stage = Stage.ACTUATOR
    parameters: tuple[EffectParameter, ...] = (EffectParameter("screw_per_kelvin", "µm/m K", 5.0),)
    invariances: tuple[str, ...] = (BOTH_WAYS, "0 at 20 °C")
    controller: str = "nothing to enter: keep the machine at the temperature of its calibration"

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The carriage is further by value · coordinate · (temperature - 20 °C)."""
        strain = PER_THOUSAND**2 * at.values[0] * kelvins(at.flow.taken)
        return np.asarray(strain * at.flow.command_mm[:, at.leg])


@dataclass(frozen=True)
class Backlash(OfCarriageOrBar):
    """A carriage stays back, at the larger coordinate, when it last moved to smaller ones."""

    id: str = "backlash"
    title: str = "a carriage has play: it stays back when it comes from the other side"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.ACTUATOR
    parameters: tuple[EffectParameter, ...] = (EffectParameter("play", "mm", 0.01, least=0.0),)
    invariances: tuple[str, ...] = (
        "constant in time",
        "depends on the direction of approach only, not on travel",
    )
    controller: str = "joint {place}: BACKLASH = {play}"

    def off_mm(self, at: Acting) -> NDArray[Any]:
        """The carriage is off by the play after a movement to smaller coordinates."""
        stays_back = last_movement(at.flow.taken)[:, at.leg] < 0
        return np.asarray(at.values[0] * stays_back)


def cyclic_of(names: Iterable[str]) -> ActuatorCyclic | None:
    """The law of any lead whose parameters have these names; None where there is none."""
    wanted = set(names)
    leads = {found[1] for found in map(LEAD.fullmatch, wanted) if found}
    if len(leads) != 1 or not float(next(iter(leads))) > 0.0:
        return None
    law = ActuatorCyclic(float(leads.pop()))
    return law if wanted == {parameter.name for parameter in law.parameters} else None


def with_machine_lead(effects: Iterable[Effect], geometry: Geometry) -> tuple[Effect, ...]:
    """The laws; where the machine's lead is known, cyclic errors with that lead only."""
    known = tuple(effects)
    others = tuple(effect for effect in known if not isinstance(effect, ActuatorCyclic))
    if geometry.screw_lead_mm is None or len(others) == len(known):
        return known
    return (*others, ActuatorCyclic(geometry.screw_lead_mm))
