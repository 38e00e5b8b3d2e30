"""The indicators of a step at their machine: which bar, where on it, on which side."""

from __future__ import annotations

from collections.abc import Sequence

from app.report.charts.charts import Caption, Drawing, Series, Stroke, StrokeStyle, points_of
from calib.arrays import LEG_NAMES
from calib.tripod.drawing import set_up_lines, view
from protocols.machine import Instrument
from protocols.procedure import Step, leg_number
from protocols.session import Session


def side_of(instrument: Instrument | None) -> float:
    """On which side of a bar an indicator stands so that its reading grows along its axis.

    Most read larger where they are pushed in: on the side towards which the bar then moves.
    """
    return -1.0 if instrument and instrument.pushed_in == "smaller" else 1.0


def drawn_set_up(
    session: Session, step: Step, instruments: Sequence[Instrument | None]
) -> Drawing | None:
    """The machine in the posture of a step, its touched bar thick; None for a reading of the tool.

    Each indicator has its number at its body and the name of its axis where readings grow.
    """
    leg, geometry = leg_number(step.leg), session.opened.machine.geometry()
    if leg not in range(3) or not geometry.reads_legs:
        return None
    axes = [leg_number(axis) for axis in step.axes]
    numbers = list(step.indicators)
    instruments_or_none = [*instruments, None, None]
    sides = [side_of(instruments_or_none[number]) for number in numbers]
    station = step.station
    if step.over_plane:  # in the posture itself; the picture is told the station at Zero
        station += step.displacement_mm / float(geometry.covered_mm[leg])
    lines = set_up_lines(geometry, leg, axes, sides, station, step.displacement_mm)
    lines = lines.seen(view(geometry))
    strokes = [Stroke(StrokeStyle.DOTTED, points_of(rail)) for rail in lines.rails]
    thin = [*lines.platform, *(bar for k, bar in enumerate(lines.bars) if k != leg)]
    strokes += [Stroke(StrokeStyle.THIN, points_of(line)) for line in thin]
    strokes.append(Stroke(StrokeStyle.THICK, points_of(lines.bars[leg])))
    strokes += [Stroke(StrokeStyle.BEADED, points_of(spindle)) for spindle in lines.spindles]
    names = zip(LEG_NAMES, lines.bars, strict=True)
    labels = [Caption(name.upper(), points_of(bar)[1]) for name, bar in names]
    for k, side in enumerate(sides):
        axis = f"+{step.axes[k].upper()}"
        together = side > 0.0
        body = f"{numbers[k] + 1} {axis}" if together else f"{numbers[k] + 1}"
        labels.append(Caption(body, points_of(lines.spindles[k])[1]))
        labels += [Caption(axis, points_of(lines.ahead[k])[1])] * (not together)
    (touched,) = points_of(lines.touched[None])
    return Drawing(
        title=f"Leg {step.leg.upper()} at {step.posture(geometry)}",
        x_words="",
        y_words="+ larger readings",
        series=(Series("touched", (touched[0],), (touched[1],)),),
        strokes=tuple(strokes),
        labels=tuple(labels),
        even=True,
        scaled=False,
    )
