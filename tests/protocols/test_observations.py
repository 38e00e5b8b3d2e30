"""From records to arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.results import CleanedReadings
from calib.errors import NotIdentifiable, UsageError
from protocols.machine import Machine
from protocols.observations import (
    AS_READ,
    corrected_readings,
    indicator_figures,
    to_observations,
)
from protocols.session import Opened, Reading, Session, Superseded, fold


def session(
    rows: list[tuple[str, float]], superseded: tuple[int, ...] = (), machine: Machine | None = None
) -> Session:
    readings = [
        Reading(
            reading=k,
            leg="x",
            axis="y" if mount == "xy" else "z",
            displacement_mm=displacement,
            value_mm=float(k),
            text=str(k),
            mount=mount,
        )
        for k, (mount, displacement) in enumerate(rows, start=1)
    ]
    opened = Opened(program="t", origin="imported", machine=machine or Machine())
    return fold([opened, *readings, Superseded(readings=superseded, reason="test")])


def test_approach_follows_from_the_rows_of_the_same_mount() -> None:
    observations = to_observations(
        [
            session(
                [("xy", 0.0), ("xz", 0.0), ("xy", 60.0), ("xy", 60.0), ("xy", -100.0), ("xz", 60.0)]
            )
        ]
    )
    assert observations.approach.tolist() == [0.0, 0.0, 1.0, 1.0, -1.0, 1.0]
    assert observations.mount.tolist() == [0, 1, 0, 0, 0, 1]


def test_superseded_readings_do_not_count() -> None:
    observations = to_observations(
        [session([("xy", 0.0), ("xy", 60.0), ("xy", 60.0)], superseded=(2,))]
    )
    assert observations.value_mm.tolist() == [1.0, 3.0]


def test_approach_remembers_superseded_readings() -> None:
    """0, -71, -100 undone, -71 again: that last one was approached upwards."""
    rows = [("xy", 0.0), ("xy", -71.0), ("xy", -100.0), ("xy", -71.0)]
    observations = to_observations([session(rows, superseded=(2, 3))])
    assert observations.approach.tolist() == [0.0, 1.0]


def test_two_sessions_have_mountings_of_their_own() -> None:
    single = session([("xy", 0.0), ("xy", 60.0)])
    observations = to_observations([single, single])
    assert observations.mount.tolist() == [0, 0, 1, 1]
    assert np.isnan(observations.temperature_c).all()


def test_sessions_of_different_machines_are_not_mixed() -> None:
    first = session([("xy", 0.0)])
    second = session([("xy", 0.0)], machine=Machine(leg_length_mm=300.0))
    with pytest.raises(UsageError, match=r"sessions of different machines.* other leg_length_mm"):
        to_observations([first, second])
    entered = session([("xy", 0.0)], machine=Machine(entered_offsets_mm=(1.0, 0.0, 0.0)))
    with pytest.raises(UsageError, match=r"offsets entered between them.*glidecal verify"):
        to_observations([first, entered])


def test_a_key_that_no_reading_depends_on_may_change_between_sessions() -> None:
    """The owner states a tolerance or another indicator after the first session."""
    first = session([("xy", 0.0), ("xy", 60.0)])
    later = Machine(tool_tolerance_mm=0.05, fastest_feed_mm_min=3000.0)
    observations = to_observations([first, session([("xy", 0.0), ("xy", 60.0)], machine=later)])
    assert len(observations) == 4
    aligned = session([("xy", 0.0)], machine=Machine(frame="aligned"))
    with pytest.raises(UsageError, match=r"sessions of different machines.* other frame"):
        to_observations([first, aligned])


def test_no_reading_at_all() -> None:
    with pytest.raises(NotIdentifiable):
        to_observations([session([])])


def written(values_mm: list[float], decimals: int, *, averaged: int = 1) -> Session:
    """One set-up whose readings are written down with so many decimals."""
    readings = [
        Reading(
            reading=k,
            leg="x",
            axis="y",
            displacement_mm=float(k),
            value_mm=value,
            text=f"{value:.{decimals}f}",
            mount="xy",
            averaged=averaged,
        )
        for k, value in enumerate(values_mm, start=1)
    ]
    return fold([Opened(program="t", origin="imported", machine=Machine()), *readings])


def test_the_step_that_the_values_show_is_the_display_s() -> None:
    """Readings of 1 µm written with six decimals: the zeros behind them are no resolution."""
    values = [0.123, 0.457, -0.209, 0.124, 0.456, -0.211]
    figures = indicator_figures([written(values, 6)])
    assert (figures.step_mm, figures.values_step_mm) == (1e-6, 0.001)
    assert figures.display_mm == figures.display_found_mm == 0.001
    figures = indicator_figures([written(values, 3)])
    assert (figures.display_mm, figures.display_found_mm) == (0.001, None)


def test_inches_have_the_step_of_their_display_in_mm() -> None:
    inches = [0.0052, 0.0181, -0.0077, 0.0123, 0.0064, 0.0200]
    figures = indicator_figures([written([25.4 * value for value in inches], 6)])
    assert figures.display_mm == pytest.approx(0.0001 * 25.4)


def test_a_mean_of_several_readings_shows_no_step() -> None:
    figures = indicator_figures([written([0.123, 0.457, -0.209, 0.124], 6, averaged=4)])
    assert figures.values_step_mm is None


def test_a_corrected_reading_says_what_it_was_and_of_another_posture_has_no_step() -> None:
    record = session([("xy", 0.0), ("xy", 60.0), ("xy", -100.0)])
    steps = tuple(r.model_copy(update={"step": k}) for k, r in enumerate(record.readings, start=1))
    record = fold([record.opened, *steps])
    observations = to_observations([record])
    changed = replace(
        observations,
        value_mm=observations.value_mm + np.array([0.0, 0.25, 0.0]),
        displacement_mm=np.array([0.0, 60.0, 60.0]),
    )
    rows = np.arange(3)
    cleaned = CleanedReadings(changed, rows, np.zeros(3, dtype=np.intp))
    value, posture = corrected_readings(record, cleaned)
    was_mm = record.readings[1].value_mm
    assert (value.reading, value.step) == (2, 2)
    assert value.value_mm == pytest.approx(was_mm + 0.25)
    assert value.extra[AS_READ] == f"value_mm {was_mm}"
    assert (posture.reading, posture.step, posture.displacement_mm) == (3, None, 60.0)
    assert posture.extra[AS_READ] == "displacement_mm -100.0"
    moved = CleanedReadings(observations, rows, np.array([0, 0, 1], dtype=np.intp))
    (after,) = corrected_readings(record, moved)
    assert (after.reading, after.step, after.mount) == (3, 3, "xy, moved 1")
