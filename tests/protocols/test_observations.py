"""From records to arrays."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import NotIdentifiable, UsageError
from protocols.machine import Machine
from protocols.observations import to_observations
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
    found = to_observations(
        [
            session(
                [("xy", 0.0), ("xz", 0.0), ("xy", 60.0), ("xy", 60.0), ("xy", -100.0), ("xz", 60.0)]
            )
        ]
    )
    assert found.approach.tolist() == [0.0, 0.0, 1.0, 1.0, -1.0, 1.0]
    assert found.mount.tolist() == [0, 1, 0, 0, 0, 1]


def test_superseded_readings_do_not_count() -> None:
    found = to_observations([session([("xy", 0.0), ("xy", 60.0), ("xy", 60.0)], superseded=(2,))])
    assert found.value_mm.tolist() == [1.0, 3.0]


def test_approach_remembers_superseded_readings() -> None:
    """0, -71, -100 undone, -71 again: that last one was approached upwards."""
    rows = [("xy", 0.0), ("xy", -71.0), ("xy", -100.0), ("xy", -71.0)]
    found = to_observations([session(rows, superseded=(2, 3))])
    assert found.approach.tolist() == [0.0, 1.0]


def test_two_sessions_have_mountings_of_their_own() -> None:
    one = session([("xy", 0.0), ("xy", 60.0)])
    found = to_observations([one, one])
    assert found.mount.tolist() == [0, 0, 1, 1]
    assert np.isnan(found.temperature_c).all()


def test_sessions_of_different_machines_are_not_mixed() -> None:
    other = session([("xy", 0.0)], machine=Machine(entered_offsets_mm=(1.0, 0.0, 0.0)))
    with pytest.raises(UsageError, match="sessions of different machines"):
        to_observations([session([("xy", 0.0)]), other])


def test_no_reading_at_all() -> None:
    with pytest.raises(NotIdentifiable):
        to_observations([session([])])
