"""Effects of what is touched and read: indicators, stands, plates, contacts, a probe.

``"xy"`` measures y on leg x, ``"tz"`` the tool along z, or are contacts along z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib.arrays import LEG_NAMES, Conditions, FloatArray
from calib.tripod.effects.effect import (
    AT_MM,
    AT_TOOL,
    PER_THOUSAND,
    Acting,
    EffectParameter,
    Kind,
    Law,
    OfReading,
    OfTouch,
    Placed,
    kelvins,
    mounts,
    numbers,
    on_legs,
)
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Stage, commanded_tool, measuring_directions

PERCENT = 1e-2


@dataclass(frozen=True)
class GaugeGain(OfReading):
    """Every reading is scaled, whatever caused it; positive: the indicator shows too much."""

    id = "gauge_gain"
    title = "an indicator shows too much or too little in proportion"
    parameters = (EffectParameter("gain", "%", 0.5, 20.0),)
    controller = "nothing to enter: check the indicator at {place}, it is {gain} off"

    def off(self, at: Acting) -> NDArray[Any]:
        """A part of the reading."""
        return PERCENT * at.values[0] * at.stage_input


@dataclass(frozen=True)
class GaugeTilt(OfTouch):
    """An indicator on a leg is askew; positive: the third axis' positive way reads positive.

    In proportion to what the other indicator of the leg shows, until the stand is set up anew.
    """

    id = "gauge_tilt"
    title = "an indicator is tilted and also reads motion across its axis"
    kind = Kind.INDICATOR
    parameters = (EffectParameter("tilt", "mrad", 10.0, 150.0),)
    controller = "nothing to enter: mount the indicator at {place} again, tilted by {tilt}"

    def off(self, at: Acting) -> NDArray[Any]:
        """The touched point along a plunger that is turned by the value towards the third axis."""
        leg, axis = numbers(at.place)
        across = at.flow.geometry.read_along[leg]
        along_indicator = (at.stage_input * across[axis]).sum(axis=-1)
        third = (at.stage_input * across[3 - leg - axis]).sum(axis=-1)
        tilt_rad = PER_THOUSAND * at.values[0]
        return np.asarray(np.sin(tilt_rad) * third + (np.cos(tilt_rad) - 1.0) * along_indicator)


@dataclass(frozen=True)
class PlateTilt(OfTouch):
    """What the tool is read against is not square to its coordinate, two ways.

    Positive: the positive direction of the first (second) of the other two coordinates reads
    positive: a plate that falls that way. Another one after the plate was set up anew.
    """

    id = "gauge_tilt"
    title = "the plate, or the indicator at the tool, is tilted"
    kind = Kind.INDICATOR
    parameters = (
        EffectParameter("tilt_first", "mrad", 10.0, 150.0),
        EffectParameter("tilt_second", "mrad", 10.0, 150.0),
    )
    controller = "nothing to enter: level the plate, or mount the indicator again"

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """The tool along every coordinate that was measured."""
        return tuple(place for place in mounts(conditions) if place in AT_TOOL)

    def off(self, at: Acting) -> NDArray[Any]:
        """The way across the coordinate is read in proportion."""
        first, second = (k for k in range(3) if k != numbers(at.place)[1])
        way = at.values[0] * at.stage_input[..., first] + at.values[1] * at.stage_input[..., second]
        return PER_THOUSAND * way


@dataclass(frozen=True)
class TipOnRoundBar(OfTouch):
    """A plain tip on a round bar: where the bar moves across, the surface under the tip recedes.

    The reading falls by z²/2R with z the way along the third axis from where the indicator was set
    up and R the bar's radius. Beside the crest by e it also falls by e z/R: that is `gauge_tilt`.
    Positive: the tip touches the side that faces the positive axis.
    """

    id = "tip_on_round_bar"
    title = "the tip slides over the crest of a round bar"
    kind = Kind.INDICATOR
    parameters = (EffectParameter("curvature", "1/m", 10.0, 500.0),)
    controller = "nothing to enter: use a flat tip at {place}, or one wider than the motion across"

    def off(self, at: Acting) -> NDArray[Any]:
        """The touched point goes back by value z² / 2."""
        leg, axis = numbers(at.place)
        third = at.flow.geometry.read_along[leg, 3 - leg - axis]
        z_mm = at.flow.moved_along(at.stage_input, np.broadcast_to(third, (len(at.flow.taken), 3)))
        return -PER_THOUSAND * at.values[0] * z_mm**2 / 2.0


@dataclass(frozen=True)
class GaugeHysteresis(OfReading):
    """An indicator lags; positive: readings are lower after a movement to larger coordinates."""

    id = "gauge_hysteresis"
    title = "an indicator lags behind where its plunger reverses"
    parameters = (EffectParameter("lag", "µm", 3.0, 20.0),)
    controller = "nothing to enter: check the indicator at {place}, it lags by {lag}"

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every leg and measuring axis that was measured."""
        return on_legs(conditions)

    def off(self, at: Acting) -> NDArray[Any]:
        """Half of the value either way, by the carriage's last movement; 0 where nobody saw it."""
        return -PER_THOUSAND * at.values[0] * at.flow.taken.approach / 2.0


@dataclass(frozen=True)
class DriftOfStand(OfReading):
    """One stand wanders steadily, whatever the posture; hours count from the session's start."""

    id = "stand_drift"
    title = "the stand of an indicator drifts steadily with time"
    kind = Kind.ENVIRONMENT
    parameters = (EffectParameter("rate", "µm/h", 10.0),)
    controller = "nothing to enter: clamp the stand at {place}, let it come to rest"

    def off(self, at: Acting) -> NDArray[Any]:
        """The value for each unit of what it wanders with.

        Where one reading of a mounting has none, by nothing in all of it: so nothing jumps.
        """
        conditions = at.flow.taken
        figure = self.wanders_with(conditions)
        unknown = np.isin(conditions.mount, conditions.mount[np.isnan(figure)])
        return PER_THOUSAND * at.values[0] * np.where(unknown, 0.0, figure)

    def wanders_with(self, conditions: Conditions) -> FloatArray:
        """Hours ``(n,)`` from the start of the session; NaN where not known."""
        return np.asarray(conditions.time_s / 3600.0)


@dataclass(frozen=True)
class DriftWithTime(DriftOfStand):
    """All readings along an axis wander steadily with time; the place is the measuring axis."""

    id = "thermal_drift"
    title = "readings drift steadily with time"
    controller = "nothing to enter: wait until the temperatures of machine and stand are steady"

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every measuring axis."""
        return tuple(name for k, name in enumerate(LEG_NAMES) if k in conditions.axis)

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Readings ``(..., n)``."""
        return np.asarray(off_mm * (at.flow.taken.axis == LEG_NAMES.index(at.place)))


@dataclass(frozen=True)
class DriftWithTemperature(DriftWithTime):
    """All readings along an axis wander with the temperature; kelvins count from 20 °C."""

    title = "readings drift with the temperature"
    parameters = (EffectParameter("per_kelvin", "µm/K", 5.0),)

    def wanders_with(self, conditions: Conditions) -> FloatArray:
        """Kelvins ``(n,)``."""
        return kelvins(conditions)


@dataclass(frozen=True)
class TiltOfTouchedPlate(PlateTilt):
    """A plate that falls one way, as the tool meets it in contacts: nothing of an indicator."""

    id = "plate_tilt"
    title = "the plate that the tool touches is tilted"
    kind = Kind.MACHINE
    controller = "nothing to enter: level the plate"

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """The tool along every coordinate that it met a plate along."""
        return tuple(
            f"t{LEG_NAMES[axis]}" for axis in np.unique(conditions.axis[conditions.contact])
        )

    def moved(self, at: Acting, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Touched points ``(..., n, 3)``."""
        conditions = at.flow.taken
        in_contact = conditions.contact & (conditions.axis == numbers(at.place)[1])
        along = measuring_directions(at.flow.geometry, conditions)
        return np.asarray((off_mm * in_contact)[..., None] * along)


Shape = Literal["first", "second", "twist", "round"]


@dataclass(frozen=True)
class BowOfTouchedPlate(TiltOfTouchedPlate):
    """The plate is no plane but bowed about its middle; positive: it falls from there outwards.

    Along the first (second) of the other two coordinates, along their diagonal, x = y, while it
    rises along x = -y, or every way alike: a dome, and a dish where it is negative.
    """

    shape: Shape = "first"
    id = "plate_bow"
    title = "the plate that the tool touches is not flat"
    controller = "nothing to enter: lay a flat plate, or probe one"

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:  # type: ignore[override]
        """How much lower it is 100 mm from the middle."""
        return (EffectParameter(f"bow_{self.shape}_at_100mm", "mm", 0.05, 5.0),)

    def off(self, at: Acting) -> NDArray[Any]:
        """The value times the square of the way from Zero / 100 mm."""
        first, second = (k for k in range(3) if k != numbers(at.place)[1])
        x, y = (at.stage_input[..., k] / AT_MM for k in (first, second))
        first_square, second_square = x * x, y * y
        squares = {
            "first": first_square,
            "second": second_square,
            "twist": 2.0 * x * y,
            "round": first_square + second_square,
        }
        return np.asarray(at.values[0] * squares[self.shape])


SHAPES: tuple[BowOfTouchedPlate, ...] = (
    BowOfTouchedPlate("first"),
    BowOfTouchedPlate("second"),
    BowOfTouchedPlate("twist"),
)
"""They add up to any bow."""

ROUND = BowOfTouchedPlate("round")
"""The commonest one, a name of its own: as two bows it would be two causes."""


@dataclass(frozen=True)
class PlatformTilt(Law):
    """The two bars of a leg are unequal: the platform tilts, and a probe beside the tool with it.

    Otherwise in every posture. The tool itself, where the bars meet, stays. Positive: the bar on
    the anticlockwise side of the tower is longer; in parts of the distance between both.
    """

    id = "platform_tilt"
    title = "the platform tilts as it moves, and the probe beside the tool with it"
    stage = Stage.TOUCH
    parameters = (EffectParameter("unequal", "mrad", 1.0, 50.0),)
    controller = (
        "nothing to enter: make both bars of {place} equal, they differ by {unequal} of the "
        "distance between them; or probe with the nozzle"
    )

    def places(self, conditions: Conditions) -> tuple[str, ...]:
        """Every leg, where a probe beside the tool met a plate."""
        return LEG_NAMES if conditions.beside_mm.any() else ()

    def off(self, at: Acting) -> NDArray[Any]:
        """The probe's tip ``(n, 3)`` is turned about the tool."""
        conditions = at.flow.taken
        turns = _turns(at.flow.geometry, conditions)[:, at.leg]
        return PER_THOUSAND * at.values[0] * np.cross(turns, conditions.beside_mm)


def _turns(geometry: Geometry, conditions: Conditions) -> FloatArray:
    """How each leg turns the platform ``(n, 3 legs, 3)``, rad for a part of one.

    Both bars of a leg run along ``b``; their ends on the platform are apart along ``t``, across the
    bar and the drive at Zero. A turn w makes one longer than the other by ``w (t x b)`` of their
    distance. All 0 on machines whose bars lie along their drives at Zero.
    """
    turns = np.zeros((len(conditions), 3, 3))
    if geometry.common_zero:
        return turns
    apart = np.cross(geometry.bars(np.zeros(3)), geometry.directions)
    apart /= np.linalg.norm(apart, axis=1)[:, None]
    off_centre = conditions.beside_mm.any(axis=1)
    longer = np.cross(apart, geometry.bars(commanded_tool(geometry, conditions)[off_centre]))
    turns[off_centre] = np.swapaxes(np.linalg.inv(longer), -1, -2)
    return turns


def contact_tolerances(bow_mm: float, unequal_mrad: float) -> dict[Placed, float]:
    """Laws of a plate that is met along z and of the platform, with the size that is usual of each.

    A bow of any direction is as likely: its twist is the smaller by a root of two. 0: none.
    """
    first, second, twist = SHAPES
    tolerances: dict[Placed, float] = {
        (first, "tz"): bow_mm,
        (second, "tz"): bow_mm,
        (twist, "tz"): bow_mm / math.sqrt(2.0),
        **{(PlatformTilt(), leg): unequal_mrad for leg in LEG_NAMES},
    }
    return {law: size for law, size in tolerances.items() if size}
