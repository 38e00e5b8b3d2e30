"""The picture of a leg: one description, as characters, as SVG and on axes of a notebook."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest
from matplotlib.figure import Figure

import glidecal
from app.report.charts.legs import LegFigure, scale_words
from app.report.pages.notebook import SessionFigures
from calib.errors import UsageError
from tests.app.cli import glidecal as command
from tests.conftest import LONG, SAMPLES
from tests.hidden_sessions import write_session

SWEEP = SAMPLES / "simulated_sweep.jsonl"
MARKS = {"towards +": ">", "towards −": "<", "first": "o"}


@pytest.fixture(scope="module")
def figures() -> SessionFigures:
    return glidecal.figures(SWEEP)


def test_positions_have_whole_numbers() -> None:
    """Before: 2.5, 5.0, 7.5 … of 19 positions."""
    above, below = Figure().subplots(2)
    glidecal.figures(SAMPLES / "every_schema" / "6" / "contacts.jsonl").draw(0, above, below)
    assert below.get_xlabel() == "number of the position"
    for axes in (above, below):
        ticks = axes.get_xticks()
        assert len(ticks) > 2
        assert all(tick == round(tick) for tick in ticks)


def test_every_reading_is_a_point_of_both_parts(figures: SessionFigures) -> None:
    session = glidecal.load(SWEEP)
    assert [leg.title for leg in figures.legs] == [
        f"Leg {leg}, measured along {axis}" for leg in "XYZ" for axis in "XYZ" if axis != leg
    ]
    for leg in figures.legs:
        for chart in leg.charts:
            points = sorted(x for series in chart.series for x in series.x)
            name, axis = leg.title[4].lower(), leg.title[-1].lower()
            readings = [r for r in session.readings if (r.leg, r.axis) == (name, axis)]
            assert points == sorted(r.displacement_mm for r in readings)
        assert {s.name: s.mark for s in leg.readings.series} == MARKS


def test_what_is_left_is_the_distance_of_points_from_the_line(figures: SessionFigures) -> None:
    """At the last place of the line: the largest displacement."""
    for leg in figures.legs:
        (line,) = leg.readings.strokes
        end_mm, fitted_mm = line.points[-1]
        above, below = (_at(leg, chart, end_mm) for chart in (0, 1))
        assert [1000.0 * (mm - fitted_mm) for mm in above] == pytest.approx(below, abs=1e-9)


def _at(leg: LegFigure, chart: int, place: float) -> list[float]:
    series = leg.charts[chart].series
    return [y for line in series for x, y in zip(line.x, line.y, strict=True) if x == place]


def test_the_factor_is_that_of_the_scales_which_all_share(figures: SessionFigures) -> None:
    ends = {tuple((c.y_ticks()[0], c.y_ticks()[-1]) for c in leg.charts) for leg in figures.legs}
    ((above, below),) = ends
    for leg in figures.legs:
        assert leg.enlarged == pytest.approx(1000.0 * (above[1] - above[0]) / (below[1] - below[0]))
        assert f"{leg.enlarged:.3g} times enlarged" in leg.left.heading
        assert leg.left.y_words == "µm"


def test_what_is_drawn_smaller_is_not_called_enlarged() -> None:
    assert [scale_words(factor) for factor in (29.31, 0.5)] == [
        "29.3 times enlarged",
        "at 0.5 of the scale above",
    ]


def test_characters_are_those_of_the_command(figures: SessionFigures) -> None:
    run = command("solve", SWEEP, "--figures")
    assert run.out.endswith(f"\n\n{figures}\n")
    lines = str(figures).splitlines()
    assert max(map(len, lines)) <= 76
    assert sum("times enlarged, µm" in line for line in lines) == 6
    assert {mark for mark in MARKS.values() if mark in str(figures)} == set(MARKS.values())
    refusal = command("solve", SWEEP, "--figures", "--json")
    assert refusal.status == 2
    assert "--figures" in refusal.err


def test_a_notebook_shows_it_and_draws_it_on_axes(figures: SessionFigures) -> None:
    drawn = ElementTree.fromstring(f"<div>{figures._repr_html_()}</div>")  # as Jupyter calls it
    words = [
        "".join(element.itertext()) for element in drawn.iter() if element.tag.endswith("text")
    ]
    for leg in figures.legs:
        assert words.count(leg.title) == 1
        assert leg.left.title in words
    above, below = Figure().subplots(2)
    with pytest.raises(UsageError, match=r"99.*0 to 5"):
        figures.draw(99, above, below)
    figures.draw(1, above, below)
    assert above.get_title(loc="left") == figures.legs[1].title
    curves = {line.get_label(): list(line.get_ydata()) for line in above.lines}
    for series in figures.legs[1].readings.series:
        assert curves[series.name] == list(series.y)


@LONG
def test_an_adopted_play_is_a_line_for_each_direction(tmp_path: Path) -> None:
    """Across leg Y along X the play of carriage X shows; what is left is noise then."""
    session = write_session(tmp_path / "play.jsonl", "sweep", 3, "backlash:x", 0.03)
    model = tmp_path / "found.json"
    assert command("diagnose", session, "--adopt", model).status == 0
    without, adopted = glidecal.figures(session), glidecal.figures(session, model=model)
    heights = []
    for figures, count, words in (
        (without, 1, "left by offsets and lengths"),
        (adopted, 2, "left by the model with its effects"),
    ):
        leg = next(
            picture for picture in figures.legs if picture.title == "Leg Y, measured along X"
        )
        assert len(leg.readings.strokes) == count
        assert leg.left.title.startswith(f"{words}, ")
        heights.append(max(abs(y) for series in leg.left.series for y in series.y))
    assert heights[1] < 0.6 * heights[0]
