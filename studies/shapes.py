"""The picture of each effect, for docs/read-your-machine.md: python -m studies.shapes.

Every machine is simulated and measured finely: steps of 10 mm both ways, three cycles. Its pictures
are the legs of which offsets and lengths leave most.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from app.evaluating.solution import solve_sessions
from app.measuring.simulated import simulated_session
from app.report.charts.legs import LegFigure, leg_figures
from app.report.pages.figures import legs_svg
from calib.tripod.effects.bars import (
    BarGrowth,
    GravitySag,
    JointClearance,
    LegBow,
    LegLength,
    LegTaper,
)
from calib.tripod.effects.drives import (
    ActuatorCyclic,
    ActuatorScale,
    AxisDistance,
    AxisSquareness,
    Backlash,
    Straightness,
    StraightnessOfThirdOrder,
)
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.gauges import (
    DriftOfStand,
    DriftWithTime,
    GaugeGain,
    GaugeHysteresis,
    GaugeTilt,
    TipOnRoundBar,
)
from calib.tripod.pipeline import Model, measure
from calib.tripod.simulation import hidden_machine
from protocols.machine import load_machine
from protocols.observations import to_observations
from protocols.procedure import Procedure, load_procedure
from protocols.session import Reading, Session, fold

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
STEP_MM, CYCLES = 10, 3
SEED, SCATTER_MM, RESOLUTION_MM = 3, 0.001, 0.001
WARMED_K = 3.0
"""So much the room grows warmer from the first reading to the last."""

FINER_THAN_SEEN = re.compile(r"(\d\.\d\d)\d+")
"""Digits of places, in points of a page, from the third decimal on."""

NEXT_LEG = str.maketrans("xyz", "yzx")

Mistake = Callable[[Reading, int, int], bool]
"""Whether a reading of that leg and axis is wrong, by its number among so many of them."""


@dataclass(frozen=True)
class Shape:
    """What a machine or a stand has, of ``values`` in the units of a law at ``places``.

    Without a ``law`` it is a mistake: readings of the place that are off by the value, in mm.
    """

    id: str
    values: tuple[float, ...]
    law: Effect | None
    places: tuple[str, ...]
    mistake: Mistake = lambda _reading, _number, _count: False

    def turned(self) -> Shape:
        """The same on the next leg: x to y, y to z, z to x."""
        places = tuple(place.translate(NEXT_LEG) for place in self.places)
        return replace(self, places=places)

    def effects(self, factor: float) -> tuple[EffectInstance, ...]:
        """The law at its places, so many times its values; play has one sign only."""
        if self.law is None:
            return ()
        if self.law.parameters[0].least == 0.0:
            factor = abs(factor)
        values = tuple(factor * value for value in self.values)
        return tuple(EffectInstance(self.law, place, values) for place in self.places)


SHAPES = (
    Shape("backlash", (0.03,), Backlash(), ("x",)),
    Shape("gauge_hysteresis", (20.0,), GaugeHysteresis(), ("xy",)),
    Shape("actuator_cyclic", (60.0, 30.0), ActuatorCyclic(40.0), ("x",)),
    Shape("actuator_scale", (4.0,), ActuatorScale(), ("x",)),
    Shape("straightness", (0.08,), Straightness(), ("xy",)),
    Shape("straightness_cubic", (0.08,), StraightnessOfThirdOrder(), ("xy",)),
    Shape("axis_squareness", (2.0,), AxisSquareness(), ("xy",)),
    Shape("axis_offset", (0.5,), AxisDistance(), ("xy",)),
    Shape("leg_length", (0.5,), LegLength(), ("x",)),
    Shape("gravity_sag", (1.0,), GravitySag(), ("x",)),
    Shape("joint_clearance", (0.3,), JointClearance(), ("x",)),
    Shape("leg_bow", (0.2,), LegBow(), ("xy",)),
    Shape("leg_taper", (2.0,), LegTaper(), ("xy",)),
    Shape("tip_on_round_bar", (200.0,), TipOnRoundBar(), ("xy",)),
    Shape("gauge_gain", (15.0,), GaugeGain(), ("xy",)),
    Shape("gauge_tilt", (150.0,), GaugeTilt(), ("xy",)),
    Shape("thermal_drift", (40.0,), DriftWithTime(), ("x", "y", "z")),
    Shape("stand_drift", (40.0,), DriftOfStand(), ("xy",)),
    Shape("thermal_growth", (40.0,), BarGrowth(), ("x",)),
    Shape("first_take", (0.03,), None, ("xy",), lambda _reading, number, _count: number == 0),
    Shape(
        "stand_slip", (0.03,), None, ("xy",), lambda _reading, number, count: number > 0.6 * count
    ),
    Shape(
        "posture_off",
        (0.03,),
        None,
        ("xy",),
        lambda reading, _number, _count: reading.displacement_mm == -50.0,
    ),
)


def fine_procedure() -> Procedure:
    """Each leg from Zero to Max, to Min and back, in steps."""
    sweep = load_procedure("sweep", load_machine(None).geometry())
    up, down = range(STEP_MM, 60, STEP_MM), range(60, -100, -STEP_MM)
    way = (*up, *down, *range(-100, 0, STEP_MM))
    return sweep.model_copy(update={"levels": ("zero", *map(float, way)), "cycles": CYCLES})


def measured(shape: Shape, factor: float, seed: int, scatter_mm: float) -> Session:
    """A session of a machine with this shape, so many times its size; offsets by the seed."""
    machine = load_machine(None)
    geometry = machine.geometry()
    nominal = simulated_session(
        fine_procedure(), machine, Model(geometry), seed=seed, scatter_mm=0.0, resolution_mm=0.0
    )
    per_reading = WARMED_K / len(nominal.readings)
    readings = [
        reading.model_copy(update={"temperature_c": round(20.0 + number * per_reading, 2)})
        for number, reading in enumerate(nominal.readings)
    ]
    truth = replace(hidden_machine(geometry, seed), effects=shape.effects(factor))
    observations = to_observations([fold([nominal.opened, *readings])])
    values = measure(
        truth, observations, scatter_mm=scatter_mm, resolution_mm=RESOLUTION_MM, generator=seed
    ).tolist()
    touched = [
        k for k, reading in enumerate(readings) if f"{reading.leg}{reading.axis}" in shape.places
    ]
    for number, row in enumerate(touched):
        if shape.mistake(readings[row], number, len(touched)):
            values[row] += factor * shape.values[0]
    indicated = [
        reading.model_copy(update={"value_mm": round(mm, 3), "text": f"{mm:.3f}"})
        for reading, mm in zip(readings, values, strict=True)
    ]
    return fold([nominal.opened, *indicated])


def pictures_of(
    shape: Shape, factor: float = 1.0, seed: int = SEED, scatter_mm: float = SCATTER_MM
) -> list[LegFigure]:
    """The pictures of such a session; that with most left comes first."""
    figures = leg_figures(solve_sessions([measured(shape, factor, seed, scatter_mm)]))
    return sorted(figures, key=_left_um, reverse=True)


def _left_um(figure: LegFigure) -> float:
    """Mean square of what is left."""
    residuals = [y for series in figure.left.series for y in series.y]
    return sum(y * y for y in residuals) / len(residuals)


if __name__ == "__main__":
    for shape in SHAPES:
        svg = FINER_THAN_SEEN.sub(r"\1", legs_svg(pictures_of(shape)[:2]))
        (PICTURES / f"shape_{shape.id}.svg").write_text(svg, encoding="utf-8", newline="\n")
