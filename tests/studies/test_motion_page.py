"""docs/motion.md and its drawing are the table of states, and each of its tests exists."""

from __future__ import annotations

import re

import pytest

from drivers.motion.states import TRANSITIONS, Cause, State
from studies import motion
from tests.drivers.motion import test_line

PAGE = motion.PAGE.read_text(encoding="utf-8")


def test_the_drawing_is_that_of_the_table() -> None:
    text = motion.TARGET.read_text(encoding="utf-8")
    assert text == motion.picture(), "make it again: python -m studies.motion"


def test_the_drawing_names_every_row_once() -> None:
    titles = re.findall(
        r"<g><title>(.*?)</title>", motion.TARGET.read_text(encoding="utf-8").replace("\n", "")
    )
    named = [row for title in titles for row in title.split("; ")]
    rows = {f"{a}, {cause}: {b}" for (a, cause), b in TRANSITIONS.items()}
    closing = {f"{state}, {Cause.CLOSED}: {State.OFF}" for state in State}
    assert len(named) == len(set(named))
    assert set(named) == rows - closing


def test_a_row_without_an_arrow_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    answered = State.HELD, State.READY
    arrows = {pair: arrow for pair, arrow in motion.ARROWS.items() if pair != answered}
    monkeypatch.setattr(motion, "ARROWS", arrows)
    with pytest.raises(ValueError, match="held → ready"):
        motion.picture()


def test_the_page_lists_every_row() -> None:
    assert motion.page(PAGE) == PAGE, "make it again: python -m studies.motion"
    listed: dict[tuple[State, Cause], State] = {}
    for cause, names, after in re.findall(r"^\| ([^|]+) \| ([^|]+) → (\w+) \|$", PAGE, re.M):
        states = list(State) if names == motion.EVERY_STATE else map(State, names.split(", "))
        listed |= {(state, Cause(cause)): State(after) for state in states}
    assert listed == TRANSITIONS


def test_the_tests_of_the_rows_exist() -> None:
    names = {motion.test_of(before, cause) for before, cause in TRANSITIONS}
    assert len(names) == len(TRANSITIONS)
    for test in names:
        name, _, case = test.removesuffix("]").partition("[")
        marks = getattr(getattr(test_line, name), "pytestmark", [])
        cases = [_id_of(value, mark) for mark in marks for value in mark.args[1]]
        assert case in (cases or [""]), test


def _id_of(value: object, mark: pytest.Mark) -> str:
    ids = mark.kwargs.get("ids")
    return str(ids(value) if ids else getattr(value, "__name__", value))
