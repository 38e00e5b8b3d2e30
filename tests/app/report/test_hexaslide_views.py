"""Drawings of the Hexa Slide, its units, and the way to its screen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from app.planning.hexaslide import Request, hexaslide_planning
from app.report.charts.charts import Drawing, Stroke, StrokeStyle, ticks_within
from app.report.charts.hexaslide import drawn_machine, drawn_postures
from calib.arrays import condition
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.geometry import HexaSlide
from calib.hexaslide.planning import Scale, look_at
from calib.hexaslide.procedures import Procedure, ProcedureKind
from calib.hexaslide.search import Search, searches
from protocols.hexaslide import load_hexaslide
from tests.app.cli import refused
from tests.conftest import LONG

LINK_M = 0.88
VERB = ("identifiability", "hexaslide", "--procedure", "position", "--screen")


@pytest.fixture
def machine() -> HexaSlide:
    hexaslide = load_hexaslide()
    return hexaslide.whole()


def strokes(drawing: Drawing, look: StrokeStyle) -> list[np.ndarray]:
    return [np.array(stroke.points) for stroke in drawing.strokes if stroke.style is look]


def test_drawn_links_have_their_length_and_end_on_the_platform(machine: HexaSlide) -> None:
    posture = machine.box.random(1, np.random.default_rng(5))[0]
    front, above = drawn_machine(machine, posture)
    seen_in_front, seen_above = strokes(front, StrokeStyle.THIN), strokes(above, StrokeStyle.THIN)
    assert len(seen_in_front) == len(seen_above) == 6
    (ring,) = strokes(above, StrokeStyle.THICK)
    assert ring[0] == pytest.approx(ring[-1])
    for xz, xy in zip(seen_in_front, seen_above, strict=True):
        (dx, dz), dy = xz[1] - xz[0], (xy[1] - xy[0])[1]
        assert math.sqrt(dx**2 + dy**2 + dz**2) == pytest.approx(LINK_M, abs=1e-12)
        assert min(np.abs(ring - xy[1]).max(axis=1)) < 1e-12


def test_labels_stand_on_the_rails(machine: HexaSlide) -> None:
    _, above = drawn_machine(machine, machine.box.centre)
    assert [label.words for label in above.labels] == list("123456")
    for label, rail in zip(above.labels, strokes(above, StrokeStyle.DOTTED), strict=True):
        along = rail[-1] - rail[0]
        off = np.array(label.at) - rail[0]
        assert along[0] * off[1] - along[1] * off[0] == pytest.approx(0.0, abs=1e-12)


def test_an_even_scale_draws_a_square_square() -> None:
    square = Stroke(StrokeStyle.THIN, ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))
    drawing = Drawing("a square", "", "m", (), strokes=(square,), even=True)
    for columns, rows in ((40, 10), (20, 30), (1, 1)):
        across, upwards = drawing.limits(columns, rows)
        cell = (across[1] - across[0]) / columns
        assert (upwards[1] - upwards[0]) / rows == pytest.approx(2.0 * cell)
        assert across[0] < 0.0
        assert across[1] > 1.0
        assert upwards[0] < 0.0
        assert upwards[1] > 1.0
    across, _ = replace(drawing, even=False).limits(40, 10)
    assert across == pytest.approx((-0.04, 1.04))


@pytest.mark.parametrize("limits", [(-1.31, -0.99), (-31.0, 31.0), (0.0, 1e-4), (-0.7, 0.9)])
@pytest.mark.parametrize("maximum", [2, 3, 7])
def test_ticks_are_round_few_and_inside(limits: tuple[float, float], maximum: int) -> None:
    ticks = ticks_within(limits, maximum)
    assert 1 <= len(ticks) <= maximum
    assert all(limits[0] <= tick <= limits[1] for tick in ticks)
    assert all(float(f"{tick:.3g}") == pytest.approx(tick, abs=1e-15) for tick in ticks)


def test_postures_of_nothing_found_show_the_box_alone(machine: HexaSlide) -> None:
    drawings = drawn_postures(machine, None)
    assert [drawing.heading for drawing in drawings] == [
        "y over x, m",
        "z over x, m",
        "psi over theta, °",
        "phi over theta, °",
    ]
    assert all(not drawing.series for drawing in drawings)
    (outline,) = strokes(drawings[3], StrokeStyle.MARKED)
    assert outline.min(axis=0) == pytest.approx([-15.0, -30.0])
    assert outline.max(axis=0) == pytest.approx([15.0, 30.0])


@pytest.mark.parametrize("kind", ProcedureKind)
def test_millimetres_as_if_the_machine_were_written_in_them(kind: str) -> None:
    view = look_at(hexaslide_planning(Request(kind, postures=60)))
    metres, link = view.machine.geometry, view.machine.link
    assert link is not None
    big = replace(
        metres,
        base=1e3 * metres.base,
        platform=1e3 * metres.platform,
        links=1e3 * metres.links,
    )
    long = replace(
        link,
        platform_end=1e3 * link.platform_end,
        base_end=1e3 * link.base_end,
        length_m=1e3 * link.length_m,
    )
    postures = view.machine.box.random(60, np.random.default_rng(0))
    count = len(view.seen.identifiability.names)
    rows = jacobian(view.procedure, metres, postures, link).reshape(-1, count)
    scale = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])
    jacobian_mm = jacobian(view.procedure, big, scale * postures, long).reshape(-1, count)
    converted = Scale.in_units(view.procedure, "mm, rad").applied(rows)
    assert converted == pytest.approx(jacobian_mm, rel=1e-9, abs=1e-9 * np.abs(jacobian_mm).max())
    rank = view.seen.identifiability.rank
    assert view.conditions["mm, rad"] == pytest.approx(condition(jacobian_mm, rank), rel=1e-6)


def test_degrees_change_the_rows_of_angles_alone() -> None:
    view = look_at(hexaslide_planning(Request("pose-forward", postures=20)))
    rows = view.seen.examined.sensitivity.jacobian
    turned = Scale.in_units(view.procedure, "m, °").applied(rows).reshape(20, 6, -1)
    assert turned[:, :3] == pytest.approx(rows.reshape(20, 6, -1)[:, :3])
    assert turned[:, 3:] == pytest.approx(np.degrees(rows.reshape(20, 6, -1)[:, 3:]))


@LONG
def test_a_search_begins_at_the_random_postures_of_its_seed(machine: HexaSlide) -> None:
    procedure = Procedure.of("pose-inverse")
    (optimum,) = searches(procedure, machine, 9, Search(seed=3, starts=1))
    assert optimum.coordinates.shape == (9, 6)
    assert optimum.begin == pytest.approx(machine.box.random(9, np.random.default_rng(3)))
    assert optimum.search.source == "random"


def test_the_screen_needs_a_terminal_and_the_hexaslide() -> None:
    assert "no terminal" in refused(2, *VERB)
    message = refused(2, "identifiability", "orthoglide", "--procedure", "sweep", "--screen")
    assert "--screen: found the machine orthoglide. Allowed: the machine hexaslide" in message
