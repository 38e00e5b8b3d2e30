"""Effects of screws and carriages: errors along an actuator's own axis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.observations import LEG_NAMES, Conditions
from calib.tripod.effects.effect import (
    PER_THOUSAND,
    Effect,
    EffectParameter,
    Kind,
    moved_carriage,
    travel,
)
from calib.tripod.geometry import Geometry
from calib.tripod.movements import last_movement
from calib.tripod.pipeline import Flow, Stage

STANDARD_LEADS_MM = (4.0, 5.0, 10.0, 20.0)
"""Leads that are tried where the machine file does not name the screw's."""


@dataclass(frozen=True)
class ActuatorScale:
    """Travel is wrong in proportion; positive: the carriage travels further than commanded."""

    id: str = "actuator_scale"
    title: str = "a carriage travels too far or too short in proportion to its travel"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.ACTUATOR
    parameters: tuple[EffectParameter, ...] = (EffectParameter("scale", "mm/m", 0.1),)
    invariances: tuple[str, ...] = (
        "same for both directions of approach",
        "constant in time",
        "changes sign with travel",
    )
    controller: str = (
        "joint {place}: multiply SCALE by 1 − ({scale}), or COMP_FILE of export --format linuxcnc"
    )

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every carriage."""
        return LEG_NAMES if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The carriage is off by a part of its commanded travel."""
        leg = LEG_NAMES.index(place)
        return moved_carriage(stage_input, leg, PER_THOUSAND * values[0] * travel(flow, leg))


@dataclass(frozen=True)
class ActuatorCyclic:
    """Travel is wrong with the screw's turn: a sine and a cosine, zero at Zero."""

    lead_mm: float
    id: str = "actuator_cyclic"
    title: str = "a screw's error repeats with every turn"
    kind: Kind = Kind.MACHINE
    stage: Stage = Stage.ACTUATOR
    invariances: tuple[str, ...] = (
        "same for both directions of approach",
        "constant in time",
        "repeats after one lead of travel",
    )
    controller: str = "joint {place}: COMP_FILE of export --format linuxcnc"

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Two amplitudes; their names tell the lead."""
        ending = f"{self.lead_mm:g}mm"
        return (
            EffectParameter(f"sine_{ending}", "µm", 5.0),
            EffectParameter(f"cosine_{ending}", "µm", 5.0),
        )

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every carriage."""
        return LEG_NAMES if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The carriage is off by a sin t + b (cos t - 1), t one turn for each lead of travel."""
        leg = LEG_NAMES.index(place)
        turn = 2 * np.pi * travel(flow, leg) / self.lead_mm
        error = values[0] * np.sin(turn) + values[1] * (np.cos(turn) - 1.0)
        return moved_carriage(stage_input, leg, PER_THOUSAND * error)


@dataclass(frozen=True)
class Backlash:
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

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Every carriage."""
        return LEG_NAMES if len(taken) else ()

    def change(
        self, stage_input: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """The carriage is off by the play after a movement to smaller coordinates."""
        leg = LEG_NAMES.index(place)
        stays_back = last_movement(flow.taken)[:, leg] < 0
        return moved_carriage(stage_input, leg, values[0] * stays_back)


def with_machine_lead(effects: Iterable[Effect], geometry: Geometry) -> tuple[Effect, ...]:
    """The laws; where the machine's lead is known, cyclic errors with that lead only."""
    known = tuple(effects)
    others = tuple(effect for effect in known if not isinstance(effect, ActuatorCyclic))
    if geometry.screw_lead_mm is None or len(others) == len(known):
        return known
    return (*others, ActuatorCyclic(geometry.screw_lead_mm))
