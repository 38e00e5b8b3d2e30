"""The picture of a set-up as points and strokes, and as cells of a terminal."""

from __future__ import annotations

import re

import numpy as np
import pytest
from textual.app import App, ComposeResult

from app.report.charts.charts import Drawing, StrokeStyle
from app.report.charts.tripod import drawn_set_up
from app.report.text.session import set_up_text
from app.screens.plot import ChartPlot
from protocols.machine import Instrument, Machine
from protocols.procedure import Step, load_procedure
from protocols.session import Opened, Session, fold
from tests.screens.driving import rows

FIRST = Instrument(profile="sylvac", port="/dev/ttyUSB1", axes="yx", pushed_in="larger")
SECOND = Instrument(profile="mitutoyo-01a", port="COM5", axes="zy", pushed_in="smaller")
BOTH = (FIRST, SECOND)


def session(protocol: str = "two-station") -> Session:
    machine = Machine()
    procedure = load_procedure(protocol, machine.geometry())
    opened = Opened(
        program="test", origin="measured", machine=machine, procedure=procedure, instruments=BOTH
    )
    return fold([opened])


def picture(example: Session, step: Step) -> Drawing:
    drawing = drawn_set_up(example, step, BOTH)
    assert drawing is not None
    return drawing


def place(drawing: Drawing, words: str) -> np.ndarray:
    (position,) = [label.at for label in drawing.labels if label.words == words]
    return np.array(position)


def test_every_step_shows_its_bar_the_point_on_it_and_the_axes() -> None:
    example = session()
    geometry = example.opened.machine.geometry()
    ups = {"x": (-1.0, -1.0), "y": (1.0, -1.0), "z": (0.0, 1.0)}
    for step in example.steps():
        drawing = picture(example, step)
        (thick,) = [s.points for s in drawing.strokes if s.style is StrokeStyle.THICK]
        end, foot = np.array(thick)
        assert tuple(foot) == tuple(place(drawing, step.leg.upper())), "the bar bears its letter"
        (series,) = drawing.series
        touched = np.array([series.x[0], series.y[0]])
        share = (touched - end) @ (foot - end) / ((foot - end) @ (foot - end))
        assert touched == pytest.approx(end + share * (foot - end))
        covered = geometry.lengths[0]
        assert share == pytest.approx(step.station - step.displacement_mm / covered)
        for number, axis in enumerate(step.axes, start=1):
            plus = f"{number} +{axis.upper()}" if number == 1 else f"+{axis.upper()}"
            assert np.sign(place(drawing, plus) - touched) == pytest.approx(
                ups[axis], abs=1e-9
            ) or (axis == "z" and (place(drawing, plus) - touched)[1] > 0.0)
        assert (place(drawing, "2") - touched) @ (place(drawing, plus) - touched) < 0.0


def test_the_words_name_bar_place_port_and_side() -> None:
    example = session()
    step = next(s for s in example.steps() if s.leg == "x")
    words = set_up_text(example, step, BOTH)
    at_mm = step.station * 310.25
    assert words.splitlines() == [
        f"Bar X, {at_mm:.0f} mm from its tool end ({step.station:.0%}). "
        "Set up with the machine at Zero.",
        "1  sylvac /dev/ttyUSB1: along Y, on the +Y side",
        "2  mitutoyo-01a COM5: along Z, on the −Z side",
        "A reading must grow when the bar moves towards +.",
    ]
    unknown = FIRST.model_copy(update={"pushed_in": None})
    assert "if it grows when the spindle is pushed in" in set_up_text(
        example, step, (unknown, SECOND)
    )


def test_a_reading_of_the_tool_has_no_picture() -> None:
    assert drawn_set_up(session(), Step(1, "tool", 0.0, 1, 0.0, ("z",), (0, 0, 0)), BOTH) is None


@pytest.mark.parametrize("size", [(80, 14), (45, 22), (45, 11)])
async def test_a_terminal_marks_the_touched_point_where_the_machine_says(
    size: tuple[int, int],
) -> None:
    example = session("zero-max-min")
    for step in example.steps()[:30:3]:
        drawing = picture(example, step)

        class Page(App[None]):
            def compose(self) -> ComposeResult:
                yield ChartPlot(drawing)  # noqa: B023 (used at once)

        app = Page()
        async with app.run_test(size=size) as pilot:
            await pilot.pause()
            sent = rows(app.screen)
        cells = {}
        for mark in "xXYZ":  # a letter after + is that of an axis
            plain_rows = [re.sub(r"\+[XYZ]", "  ", row) for row in sent[1:-1]]
            ((x, y),) = [(row.index(mark), k) for k, row in enumerate(plain_rows) if mark in row]
            cells[mark] = (float(x), float(y))
        # three points tell the whole linear map from the drawing to cells
        letters = np.array([[*place(drawing, name), 1.0] for name in "XYZ"])
        mapped = np.linalg.solve(letters, np.array([cells[name] for name in "XYZ"]))
        touched = np.array([drawing.series[0].x[0], drawing.series[0].y[0], 1.0]) @ mapped
        assert np.abs(np.array(cells["x"]) - touched).max() <= 1.5, "one cell and its rounding"
