"""What the next reading should be, and readings that are further off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest

from protocols.expectation import (
    Contradiction,
    ExpectedReading,
    Movement,
    contradiction,
    expected,
    movement,
    since_last_repeat,
)
from protocols.machine import Instrument, Machine
from protocols.procedure import Procedure, Step
from protocols.session import Event, Mounted, Opened, Reading, Restored, Session, Superseded, fold

LIMIT_MM = 0.05
AT_S = 100.0
Raw = tuple[str, float, float]
"""Mounting, displacement and value, mm."""


def opened(machine: Machine | None = None, limit_mm: float = LIMIT_MM) -> Opened:
    procedure = Procedure(
        schema="glidecal.procedure/1",
        name="p",
        title="p",
        cycles=9,
        levels=("zero", "max", "min"),
        repeat_limit_mm=limit_mm,
    )
    return Opened(
        program="test",
        origin="measured",
        machine=machine or Machine(),
        procedure=procedure,
        instruments=(Instrument(profile="a"), Instrument(profile="a")),
    )


def reading(number: int, raw: Raw) -> Reading:
    mount, displacement_mm, value_mm = raw
    return Reading(
        reading=number,
        leg="x",
        axis="z" if mount.startswith("xz") else "y",
        displacement_mm=displacement_mm,
        value_mm=value_mm,
        text=str(value_mm),
        mount=mount,
        time_s=AT_S,
    )


def due(
    raw: Sequence[Raw],
    displacement_mm: float,
    *,
    then: Sequence[Event] = (),
    machine: Machine | None = None,
    limit_mm: float = LIMIT_MM,
) -> tuple[ExpectedReading, ...]:
    """What is expected next along y (and z, where it was read) after these readings at Zero."""
    axes = tuple(axis for axis in "yz" if any(mount.startswith(f"x{axis}") for mount, _, _ in raw))
    mounts = {axis: next(m for m, _, _ in raw[::-1] if m[1] == axis) for axis in axes}
    readings = [reading(k, row) for k, row in enumerate(raw, start=1)]
    mounted = Mounted.model_validate({"leg": "x", "station": 0.5, "mounts": mounts})
    session = fold([opened(machine, limit_mm), mounted, *readings, *then])
    step = Step(99, "x", displacement_mm, 9, 0.5, axes)  # type: ignore[arg-type]
    return expected(session, step, AT_S)


CALM = [("xy", 0.0, 0.0), ("xy", 60.0, 0.30), ("xy", 60.0, 0.32), ("xy", 60.0, 0.34)]


def test_nothing_is_expected_of_the_first_reading_of_a_mounting() -> None:
    session = fold([opened(), Mounted(leg="x", station=0.5, mounts={"y": "xy", "z": "xz"})])
    assert expected(session, session.steps()[0], AT_S) == ()


def test_a_repeat_is_expected_at_the_mean_of_the_earlier_ones() -> None:
    (expectation,) = due(CALM, 60.0)
    assert expectation.mean_mm == pytest.approx(0.32, abs=0.001)
    assert expectation.limit_mm == LIMIT_MM
    assert expectation.is_beyond(0.50)
    assert expectation.is_beyond(0.20)
    assert not expectation.is_beyond(0.36)


def test_the_first_visit_is_expected_within_the_tolerances_of_the_parts() -> None:
    """sqrt(a² + b²) of 2 mm and sqrt(c² + b²) of 0.1 mm, a, b, c of papers/000, (11); 0.1 √2 mm."""
    (expectation,) = due([("xy", 0.0, 5.0)], 60.0)
    assert expectation.mean_mm == pytest.approx(5.0, abs=1e-6)
    parts_mm = (0.4737**2 + 0.0263**2 + 0.02) ** 0.5
    assert expectation.play_free == pytest.approx((5.0, parts_mm), abs=0.003)
    play_mm = 0.05 * (0.5 + 60.0 / 310.25)  # of carriage y, which goes down; the bar slid by 60 mm
    assert expectation.deviation_mm == pytest.approx(math.hypot(parts_mm, play_mm), abs=0.003)
    small = Machine(offset_tolerance_mm=0.02, length_tolerance_mm=0.01)
    (well_made,) = due([("xy", 0.0, 5.0)], 60.0, machine=small)
    assert well_made.play_free[1] < 0.01


def test_the_limit_of_a_repeat_is_the_procedures() -> None:
    assert due([("xy", 0.0, 0.0)], 0.0, limit_mm=0.02)[0].limit_mm == 0.02


def test_a_leg_tells_what_to_expect_of_the_next_one() -> None:
    """With offsets 1, 2, 0 mm leg x reads 0.330 along y at Max and leg y 0.523 along x."""
    x, y = 0.1934, 0.1367
    values = {60.0: y * 1.0 + x * 2.0, -100.0: -0.0605 * 1.0 - 0.3223 * 2.0}
    raw = [("xy", at, value) for at, value in ((0.0, 0.0), *values.items())]
    zero = reading(4, ("yx", 0.0, 1.0)).model_copy(update={"leg": "y", "axis": "x"})
    mounted = Mounted(leg="y", station=0.5, mounts={"x": "yx"})
    readings = [reading(k, row) for k, row in enumerate(raw, start=1)]
    session = fold([opened(), *readings, mounted, zero])
    (expectation,) = expected(session, Step(99, "y", 60.0, 1, 0.5, ("x",)), AT_S)
    assert expectation.play_free[1] < 0.25
    assert expectation.mean_mm == pytest.approx(1.0 + x * 1.0 + y * 2.0, abs=0.25)


def test_play_is_expected_from_the_other_side_and_known_once_it_was_seen() -> None:
    """Carriage y goes down where the tool goes out along x, and up where it comes back.

    By 0.05 mm it takes the tool along at Zero, and half of it the bar's middle.
    """
    out = [("xy", 0.0, 0.0), ("xy", 22.0, 0.0), ("xy", 60.0, 0.0)]
    (again,) = due(out, 60.0)
    assert again.limit_mm == LIMIT_MM
    (back,) = due(out, 22.0)
    assert back.deviation_mm == pytest.approx(0.5 * 0.05, abs=0.004)
    assert not back.is_beyond(-0.06)
    assert back.is_beyond(-0.10)
    readings = [*out, ("xy", 22.0, -0.06), ("xy", 0.0, -0.06), ("xy", 22.0, 0.0)]
    (following,) = due([*readings, ("xy", 60.0, 0.0)], 22.0)
    assert following.mean_mm == pytest.approx(-0.06, abs=0.01)
    assert following.limit_mm == LIMIT_MM


def test_another_mounting_has_a_zero_of_its_own() -> None:
    (expectation,) = due([("xy", 0.0, 0.1), ("xy#2", 0.0, 0.9)], 0.0)
    assert expectation.mean_mm == pytest.approx(0.9, abs=0.001)


def test_a_kept_outlier_does_not_make_the_next_one_questionable() -> None:
    superseded = Superseded(readings=(5,), reason="questioned")
    restoration = Restored(readings=(5,), reason="kept")
    raw = [*CALM, ("xy", 60.0, 0.9)]
    assert due(raw, 60.0, then=[superseded])[0].mean_mm == pytest.approx(0.32, abs=0.001)
    (expectation,) = due(raw, 60.0, then=[superseded, restoration])
    assert expectation.mean_mm == pytest.approx(0.32, abs=0.01)
    assert expectation.previous.reading == 5


def test_no_machine_drifts_back_in_a_question() -> None:
    """A drift that showed in the Zeros is expected to go on."""
    readings = [
        reading(k, ("xy", at, value)).model_copy(update={"time_s": 20.0 * k})
        for k, (at, value) in enumerate([(0.0, 0.0), (60.0, 0.32), (0.0, 0.04)], start=1)
    ]
    mounted = Mounted(leg="x", station=0.5, mounts={"y": "xy"})
    session = fold([opened(), mounted, *readings])
    (expectation,) = expected(session, Step(99, "x", 60.0, 1, 0.5, ("y",)), 80.0)
    assert expectation.mean_mm == pytest.approx(0.36, abs=0.01)


def to(displacement_mm: float) -> Step:
    return Step(99, "x", displacement_mm, 9, 0.5, ("y", "z"))


KNOWN = [("xy", 60.0, 0.30), ("xz", 60.0, 0.0), ("xy", 0.0, 0.0), ("xz", 0.0, 0.0)]


@pytest.mark.parametrize(
    ("at_mm", "display", "after_s", "outcome"),
    [
        (60.0, (0.30, 0.0), 5.0, Movement.CONFIRMED),
        (60.0, (0.002, 0.001), 5.0, Movement.UNCHANGED),
        (60.0, (0.02, 0.0), 30.0, Movement.UNCHANGED),  # a drift
        (60.0, (0.0, 0.02), 5.0, Movement.CONFIRMED),  # is questioned for being beyond
        (0.0, (0.0, 0.0), 5.0, Movement.CONFIRMED),  # read again in place
        (60.0, (0.0, 0.0), 600.0, Movement.UNKNOWN),  # a drift may hide it
    ],
)
def test_what_readings_tell_of_a_move(
    at_mm: float, display: tuple[float, float], after_s: float, outcome: Movement
) -> None:
    rests_mm = (0.004, 0.004)
    assert movement(to(at_mm), due(KNOWN, at_mm), display, rests_mm, AT_S + after_s) is outcome


def test_on_a_calibrated_machine_readings_prove_nothing() -> None:
    entered = Machine(entered_offsets_mm=(0.1, 0.0, 0.0))
    still = due(KNOWN, 60.0, machine=entered)
    assert movement(to(60.0), still, (0.0, 0.0), (0.004, 0.004), AT_S) is Movement.UNKNOWN
    unmoving = due([(mount, at, 0.0) for mount, at, _ in KNOWN], 60.0)
    assert movement(to(60.0), unmoving, (0.0, 0.0), (0.004, 0.004), AT_S) is Movement.UNKNOWN


Steps = Sequence[tuple[float, float]]
"""Displacement and value of each step in the order taken, mm."""


def measured(steps: Steps, then: Sequence[Event] = ()) -> Session:
    """A leg read along y; steps are numbered in their order, 20 s apart."""
    readings = [
        reading(k, ("xy", at, value)).model_copy(update={"step": k, "time_s": 20.0 * k})
        for k, (at, value) in enumerate(steps, start=1)
    ]
    mounted = Mounted(leg="x", station=0.5, mounts={"y": "xy"})
    return fold([opened(), mounted, *readings, *then])


def of_latest(steps: Steps, then: Sequence[Event] = ()) -> tuple[bool, list[int], bool] | None:
    """Whether the latest may be wrong, which earlier ones may, and whether they are repeats."""
    session, before = measured(steps, then), measured(steps[:-1], then)
    displacement_mm, value_mm = steps[-1]
    step = Step(len(steps), "x", displacement_mm, 9, 0.5, ("y",))
    (due,) = expected(before, step, 20.0 * len(steps))
    disagree: Contradiction | None = contradiction(
        session, session.readings[-1:], beyond=due.is_beyond(value_mm)
    )
    if disagree is None:
        return None
    return disagree.latest, [r.reading for r in disagree.earlier], disagree.repeats


CYCLE = [(0.0, 0.0), (60.0, 0.3), (-100.0, -0.4)]


def test_of_two_repeats_either_may_be_wrong() -> None:
    assert of_latest([*CYCLE, (0.0, 0.0), (60.0, 0.32)]) is None
    assert of_latest([*CYCLE, (0.0, 0.0), (60.0, -0.4)]) == (True, [2], True)


def test_the_third_repeat_settles_which_was_wrong() -> None:
    """Only the odd one is in question, be it the latest, the first or the second."""
    for right_mm, wrong_mm in ((0.3, -0.4), (-0.4, 0.3)):
        first, second, third = (
            [
                (0.0, 0.0), (60.0, a), (-100.0, -0.41),
                (0.0, 0.001), (60.0, b), (-100.0, -0.4),
                (0.0, 0.0), (60.0, c),
            ]
            for a, b, c in (
                (wrong_mm, right_mm, right_mm + 0.004),
                (right_mm, wrong_mm, right_mm - 0.004),
                (right_mm, right_mm + 0.004, wrong_mm),
            )
        )  # fmt: skip
        assert of_latest(first) == (False, [2], True)
        assert of_latest(second) == (False, [5], True)
        assert of_latest(third) == (True, [], False)


def test_it_is_settled_also_where_the_second_was_kept() -> None:
    steps = [*CYCLE, (0.0, 0.0), (60.0, -0.4), (-100.0, -0.41), (0.0, 0.0), (60.0, -0.403)]
    questioned = Superseded(readings=(5,), reason="questioned")
    restoration = Restored(readings=(5,), reason="kept")
    assert of_latest(steps, [questioned, restoration]) == (False, [2], True)


def test_three_that_all_differ_settle_nothing() -> None:
    steps = [*CYCLE, (0.0, 0.0), (60.0, -0.4), (-100.0, -0.41), (0.0, 0.0), (60.0, 1.0)]
    questioned = Superseded(readings=(5,), reason="questioned")
    restoration = Restored(readings=(5,), reason="kept")
    disagree = of_latest(steps, [questioned, restoration])
    assert disagree is not None
    latest, earlier, repeats = disagree
    assert latest
    assert earlier in ([2], [5])
    assert repeats


def test_a_first_visit_is_held_against_the_step_before() -> None:
    assert of_latest([(0.0, 0.0), (60.0, 4.0)]) == (True, [1], False)


def test_a_drift_is_no_contradiction() -> None:
    """1 µm/s, as two standard deviations, over a minute."""
    assert of_latest([*CYCLE, (0.0, 0.06)]) is None
    assert of_latest([*CYCLE, (0.0, 0.16)]) == (True, [1], True)


def test_since_when_the_stand_may_have_moved() -> None:
    """It was seen at Zero of cycle 2; MAX and MIN of that cycle may have moved with it."""
    moved = [*CYCLE, (0.0, 0.02), (60.0, 0.6), (-100.0, -0.1), (0.0, 0.3)]
    assert [r.reading for r in since_last_repeat(measured(moved))] == [5, 6, 7]
    assert [r.reading for r in since_last_repeat(measured(moved[:3]))] == [2, 3]
    calm = [*CYCLE, (0.0, 0.01), (60.0, 0.31)]
    assert since_last_repeat(measured(calm)) == ()
    again = [*CYCLE, (0.0, 0.0), (60.0, 0.6), (60.0, 0.61)]  # agree with each other alone
    assert [r.reading for r in since_last_repeat(measured(again))] == [5, 6]


def test_without_a_procedure_only_what_is_the_same_is_a_repeat() -> None:
    """But for the drift that a minute may bring."""
    for back_mm, since in ((0.4, [2, 3, 4, 5]), (0.02, [5])):
        session = measured([*CYCLE, (0.0, back_mm), (60.0, 0.9)])
        bare = session.opened.model_copy(update={"procedure": None})
        unplanned = replace(session, opened=bare)
        assert [r.reading for r in since_last_repeat(unplanned)] == since
