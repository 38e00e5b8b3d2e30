"""What a law must keep to, tried on a machine that is a little off: see `Effect`."""

from __future__ import annotations

import re
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Conditions, conditions
from calib.tripod.effects.effect import Effect, EffectInstance, EffectParameter, Kind
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Stage, simulate

ID = re.compile(r"[a-z][a-z0-9_]{1,39}")
WORDS = ("id", "title", "controller")

TRIED_MM = (1.0, -0.7, 0.5, 0.1, -0.1, 0.05)
"""Offsets and lengths of the machine on which a law is tried: its indicators show something."""

LEAST_TOLERANCE, MOST_TOLERANCE = 1e-9, 1e9


@np.errstate(all="ignore")  # what is not finite is told below
def fault_of(candidate: object) -> str:
    """Why it is no law that can be used, tried at every place; empty if nothing.

    Raises whatever the code of the law raises.
    """
    if fault := _fault_of_form(candidate):
        return fault
    effect = cast(Effect, candidate)
    legs, axes = [0, 0, 1, 1, 2, 2] * 3, [1, 2, 0, 2, 0, 1] * 3
    conditions_tried = conditions(legs, axes, [0.0] * 6 + [60.0] * 6 + [-100.0] * 6)
    places = effect.places(conditions_tried)
    if not places or not all(isinstance(place, str) for place in places):
        return f"{effect.id}: places that are not texts, or no place"
    faults = (_fault_at(effect, place, conditions_tried) for place in places)
    return next((f"{effect.id}: {fault}" for fault in faults if fault), "")


def _fault_of_form(candidate: object) -> str:
    """What it lacks to be a law; empty if nothing."""
    if not all(isinstance(getattr(candidate, name, None), str) for name in WORDS):
        return f"{candidate!r:.80}, which lacks one of the texts {', '.join(WORDS)}"
    effect = cast(Effect, candidate)
    if not ID.fullmatch(effect.id):
        return f"the id {effect.id!r}, not of small letters, digits and _"
    if not isinstance(effect.kind, Kind) or not isinstance(effect.stage, Stage):
        return f"{effect.id}: kind or stage that is not a Kind or a Stage"
    parameters = effect.parameters
    if not parameters or not all(isinstance(p, EffectParameter) for p in parameters):
        return f"{effect.id}: parameters that are not EffectParameter"
    if not all(LEAST_TOLERANCE <= p.tolerance <= MOST_TOLERANCE for p in parameters):
        return f"{effect.id}: a tolerance outside {LEAST_TOLERANCE:g} … {MOST_TOLERANCE:g}"
    return ""


def _fault_at(effect: Effect, place: str, conditions: Conditions) -> str:
    def readings(step: complex, size: float = 1.0) -> NDArray[Any]:
        """Readings of a machine that is a little off, with every value, and the machine, a step
        further.
        """
        values = tuple(size * p.tolerance * (1 + step) for p in effect.parameters)
        parameters = np.array(TRIED_MM) * (1 + step)
        return simulate(
            Geometry(), parameters, conditions, (EffectInstance(effect, place, values),)
        )

    plain, with_effect = simulate(Geometry(), TRIED_MM, conditions), readings(0.0)
    if with_effect.shape != plain.shape or not np.all(np.isfinite(with_effect)):
        return f"readings of shape {with_effect.shape} or not finite at {place}"
    if np.abs(readings(0.0, size=0.0) - plain).max() > 1e-12:
        return f"a value of 0 changes readings at {place}"
    exact = readings(1e-20j).imag / 1e-20
    central = (readings(1e-5) - readings(-1e-5)) / 2e-5
    # central differences are good to some 1e-9 here; what drops the imaginary part is off by all
    if np.abs(exact - central).max() > 1e-6:
        return f"complex values do not pass at {place}"
    return ""
