"""A mistake that was named is put right in a new record; made by the blind bench's simulation."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from protocols.record import read_record
from protocols.session import Reading, Session, fold
from tests.app.cli import glidecal, refused
from tests.blind import blunders
from tests.blind.blunders import Table
from tests.blind.cases import BLUNDERS, Case
from tests.blind.forward import FloatArray
from tests.blind.generator import make
from tests.conftest import LONG, first_quick

NOISE_MM = 0.002


def table_of(values_mm: FloatArray, rows: Table, folder: Path, name: str) -> Path:
    """The table of a session, imported: what stands in it and nothing else."""
    path = folder / f"{name}.csv"
    of = rows.rows
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("leg", "axis", "displacement_mm", "value_mm", "cycle", "station"))
        for k, value in enumerate(values_mm.tolist()):
            leg, axis = "xyz"[of.leg[k]], "xyz"[of.axis[k]]
            place = f"{of.displacement_mm[k]:g}", f"{value:.6f}", of.cycle[k], f"{of.station[k]:g}"
            writer.writerow((leg, axis, *place))
    session = folder / f"{name}.jsonl"
    run = glidecal("import", path, "-o", session)
    assert run.status == 0, run.err
    return session


def folded(path: Path) -> Session:
    return fold(read_record(path).events)


def at_their_places(readings: Iterable[Reading]) -> list[Reading]:
    """In the order of their places: which of two indicators was read first does not matter."""
    return sorted(readings, key=lambda reading: (*place(reading), reading.reading))


def place(reading: Reading) -> tuple[str, str, float, float, int]:
    return reading.leg or "", reading.axis, reading.station, reading.displacement_mm, reading.cycle


@LONG
@pytest.mark.parametrize("kind", first_quick(BLUNDERS))
def test_the_new_record_is_the_session_without_the_mistake(kind: str, tmp_path: Path) -> None:
    sample = make(Case(f"correct/{kind}", "none", "two-station", "gaussian"), 3)
    right = Table(sample.rows, sample.values_mm)
    wrong, _ = blunders.commit(kind, right, NOISE_MM, np.random.default_rng(5))
    good = folded(table_of(right.values_mm, right, tmp_path, "good"))
    bad = table_of(wrong.values_mm, wrong, tmp_path, "bad")
    before, new = bad.read_bytes(), tmp_path / "new.jsonl"
    run = glidecal("diagnose", bad, "--correct", new)
    assert run.status == 0, run.err
    assert bad.read_bytes() == before
    # not "Gap 0.0011 mm" above "gap 0.1200 → 0.0011 mm"
    assert "With the mistakes of the readings corrected the gap is" in " ".join(run.out.split())
    session = folded(new)
    (remark,) = session.opened.remarks
    assert remark.startswith(f"Corrected from bad.jsonl, digest {read_record(bad).digest}: ")
    numbers = [reading.reading for reading in session.readings]
    assert len(numbers) == len(good.readings) - (kind in {"wild", "label_error"})
    as_read = {reading.reading: reading for reading in folded(bad).readings}
    truth = {reading.reading: reading for reading in good.readings}
    for new_reading in session.readings:
        if kind != "gauge_swap":  # it changes the axes of readings, and keeps what they read
            assert place(new_reading) == place(truth[new_reading.reading])
        read = as_read[new_reading.reading]
        is_unchanged = (new_reading.value_mm, new_reading.mount, *place(new_reading)) == (
            read.value_mm,
            read.mount,
            *place(read),
        )
        assert new_reading.text == read.text
        assert ("as_read" in new_reading.extra) == (not is_unchanged)
    if kind == "stand_slip":
        moved = {reading.mount for reading in session.readings} - {
            reading.mount for reading in good.readings
        }
        (name,) = moved
        assert name.endswith(", moved 1")
    else:
        corrected = at_their_places(session.readings)
        expected = at_their_places(truth[number] for number in numbers)
        assert [place(reading) for reading in corrected] == [place(reading) for reading in expected]
        pairs = zip(corrected, expected, strict=True)
        off = np.array([reading.value_mm - expectation.value_mm for reading, expectation in pairs])
        assert np.abs(off).max() < 26.4 * 0.5e-6  # six places, some of inches
    verdicts = [
        glidecal("diagnose", path).out.split()[0] for path in (new, tmp_path / "good.jsonl")
    ]
    assert verdicts[0] == verdicts[1]


def test_nothing_is_corrected_that_was_not_named(samples: Path, tmp_path: Path) -> None:
    session, new = samples / "experiment_2_twelve.jsonl", tmp_path / "new.jsonl"
    assert "no mistake in the readings was named" in refused(
        2, "diagnose", session, "--correct", new
    )
    assert not new.exists()


def test_a_session_that_is_there_is_never_replaced(samples: Path, tmp_path: Path) -> None:
    there = tmp_path / "there.jsonl"
    there.write_bytes((samples / "experiment_1_six.jsonl").read_bytes())
    arguments = ("diagnose", samples / "experiment_2_twelve.jsonl", "--adopt", tmp_path / "m.json")
    assert "exists already" in refused(3, *arguments, "--correct", there)
    assert [path.name for path in tmp_path.iterdir()] == ["there.jsonl"]
