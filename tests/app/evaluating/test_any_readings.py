"""Whatever readings a session has: an answer in finite figures, or a sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.evaluating.diagnosis import diagnose_sessions
from app.evaluating.solution import solve_sessions
from app.report.schema.diagnosis import DiagnosisReport
from app.report.schema.document import to_json
from app.report.schema.solution import SolutionReport
from app.report.text.diagnosis import diagnosis_text
from app.report.text.result import solution_text
from calib.errors import GlidecalError
from protocols.record import Record, read_record
from protocols.session import Reading, Session, fold
from tests.conftest import LONG, SAMPLES

NAMES = (
    "simulated_zero-max-min.jsonl",
    "simulated_plane.jsonl",
    "simulated_align.jsonl",
    "experiment_1_six.jsonl",
    "every_schema/11/moved.jsonl",
    "every_schema/11/measured.jsonl",
    "every_schema/11/plate.jsonl",
    "every_schema/11/contacts.jsonl",
)
"""Of legs by one and two indicators, over a plane, on rails, corrected; of a plate."""


@lru_cache
def record_of(name: str) -> Record:
    return read_record(SAMPLES / name)


FACTORS = st.sampled_from([1.0, 1.0, 0.0, 1e-6, -1.0, 25.4, 1000.0])
OUTLIERS_MM = st.sampled_from([0.0, 0.0, 0.05, 3.0, 1e5])


def check_answer(name: str, kept: list[bool], factor: float, outlier_mm: float) -> None:
    """Some readings of a session, all times a factor, the last one off."""
    record = record_of(name)
    readings = [event for event in record.events if isinstance(event, Reading)]
    counted = [reading for reading, keep in zip(readings, kept, strict=False) if keep]
    values_mm = {reading.reading: factor * reading.value_mm for reading in counted}
    if counted:
        values_mm[counted[-1].reading] += outlier_mm
    session = fold(
        event.model_copy(update={"value_mm": values_mm[event.reading], "text": ""})
        if isinstance(event, Reading)
        else event
        for event in record.events
        if not isinstance(event, Reading) or event.reading in values_mm
    )
    for answer in (solution_of, diagnosis_of):
        with suppress(GlidecalError):
            text, document = answer(session)
            assert "nan" not in text.split()
            assert all(map(math.isfinite, numbers_in(json.loads(document))))


def solution_of(session: Session) -> tuple[str, str]:
    result = solve_sessions([session])
    return solution_text(result), to_json(SolutionReport.of(result, None, None, None))


def diagnosis_of(session: Session) -> tuple[str, str]:
    diagnosed = diagnose_sessions([session])
    report = DiagnosisReport.of(diagnosed, None, None)
    return diagnosis_text(diagnosed, None), to_json(report)


def numbers_in(part: object) -> Iterator[float]:
    if isinstance(part, dict | list):
        for inner in part.values() if isinstance(part, dict) else part:
            yield from numbers_in(inner)
    elif isinstance(part, float):
        yield part


KEPT = st.lists(st.booleans(), min_size=60, max_size=60) | st.integers(1, 60).map(
    lambda count: [True] * count
)
"""Which readings there are: any of the first 60, or all of the first few."""


@settings(max_examples=3)
@given(st.sampled_from(NAMES), KEPT, FACTORS, OUTLIERS_MM)
def test_some_readings(name: str, kept: list[bool], factor: float, outlier_mm: float) -> None:
    check_answer(name, kept, factor, outlier_mm)


@LONG
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=12)
@given(kept=KEPT, factor=FACTORS, outlier_mm=OUTLIERS_MM)
def test_many_readings(name: str, kept: list[bool], factor: float, outlier_mm: float) -> None:
    check_answer(name, kept, factor, outlier_mm)


@LONG
@pytest.mark.parametrize(
    ("name", "kept", "factor", "outlier_mm"),
    [
        ("every_schema/11/plate.jsonl", [number in {3, 25} for number in range(1, 61)], 1.0, 0.0),
        ("every_schema/11/plate.jsonl", [True] * 60, 1.0, 1e5),
        ("every_schema/11/moved.jsonl", [True] * 20, 1e-6, 3.0),
    ],
    ids=["nothing-to-exchange", "repeats-of-one-agree", "nothing-missing"],
)
def test_readings_that_had_no_answer(
    name: str, kept: list[bool], factor: float, outlier_mm: float
) -> None:
    check_answer(name, kept, factor, outlier_mm)
