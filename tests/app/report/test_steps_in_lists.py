"""A step that was measured, as the list of corrections names it."""

from __future__ import annotations

from app.report.text.session import point_text
from protocols.session import Event, Reading, Superseded, fold
from tests.recorded import at, opened


def test_one_indicator_taken_twice_and_back_shows_its_last_reading() -> None:
    begun = opened()
    begun = begun.model_copy(update={"instruments": begun.instruments[:1]})
    (step, *_) = fold([begun]).steps()
    (axis,) = step.axes
    first = Reading(
        at=at(1.0),
        reading=1,
        step=step.number,
        leg=step.leg,
        axis=axis,
        displacement_mm=step.displacement_mm,
        value_mm=0.1,
        text="0.1",
        cycle=step.cycle,
        mount="1",
        station=step.station,
    )
    again = first.model_copy(update={"reading": 2, "value_mm": 0.2})
    events: list[Event] = [begun, first, Superseded(readings=(1,), reason="again"), again]
    session = fold([*events, Superseded(readings=(2,), reason="taken back")])
    text = point_text(step, session)
    assert text.endswith(f"cycle 1   {axis.upper()} +0.2000   superseded: taken back")
