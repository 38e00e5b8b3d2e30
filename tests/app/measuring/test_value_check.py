"""Values and the texts beside them: read again by the profile, as they were when taken."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.measuring.demo import demo_plan
from app.measuring.opening import begin, open_indicators
from app.measuring.recorded import check_values
from calib.errors import RecordError
from drivers.profile import IndicatorReading, Query, Spindle, Unit, not_understood
from drivers.profiles import PROFILES
from protocols.journal import Journal
from protocols.record import Record, check_record, read_record
from protocols.session import Continued, Reading
from tests.app.cli import refused
from tests.recorded import unsealed


@pytest.mark.parametrize("profile", ["mitutoyo-01a", "sylvac", "heidenhain-nd28x"])
def test_a_measured_session_says_what_its_texts_say(tmp_path: Path, profile: str) -> None:
    plan = demo_plan(tmp_path, "zero-max-min", 1, profiles=(profile,))
    with begin(plan, open_indicators(plan)) as guided:
        for _ in range(2):
            guided.go()
            guided.take()
    record = read_record(plan.path)
    assert sum(isinstance(event, Reading) for event in record.events) == 4
    check_values(record)
    with pytest.raises(RecordError, match=r"line 4: found value_mm .* beside the text"):
        check_values(changed(record, 3))


def changed(record: Record, index: int) -> Record:
    """The record with another value on one line."""
    events = list(record.events)
    reading = events[index]
    assert isinstance(reading, Reading)
    events[index] = reading.model_copy(update={"value_mm": reading.value_mm + 0.001})
    return Record(record.path, tuple(events), record.end, 0, 0, "")


def test_the_last_line_altered_before_a_continuation_is_found(
    tmp_path: Path, samples: Path
) -> None:
    """In a record without seals, where no digest shows it."""
    lines = unsealed(samples / "simulated_zero-max-min.jsonl").splitlines(keepends=True)[:20]
    plain = json.loads(lines[-1])
    lines[-1] = lines[-1].replace(f'"value_mm":{plain["value_mm"]}'.encode(), b'"value_mm":0.999')
    path = tmp_path / "s.jsonl"
    path.write_bytes(b"".join(lines))
    Journal.resume(path, "test").finish(complete=False)
    assert check_record(path, path.read_bytes()).end == "closed"
    assert "line 20: found value_mm 0.999" in refused(3, "validate", path)


def test_texts_after_a_break_may_be_of_another_indicator(samples: Path) -> None:
    record = read_record(samples / "simulated_zero-max-min.jsonl")
    events = (record.events[0], Continued(program="test"), *changed(record, 3).events[1:])
    check_values(Record(record.path, events, record.end, 0, 0, ""))


@settings(max_examples=400)
@given(
    st.sampled_from([*PROFILES]),
    st.sampled_from(Unit),
    st.integers(0, 10**6),
    st.integers(0, 15),
)
def test_whatever_a_profile_reads_a_record_takes(
    name: str, unit: Unit, digits: int, decimals: int
) -> None:
    """A reply of the device with any other number in it, as of a firmware that shows more."""
    profile = PROFILES[name]
    reply = profile.reply(Spindle(lambda: 1.25, 0.001)).strip("\r\n")
    number = f"{digits * 10.0**-decimals:.{decimals}f}"
    text = re.sub(r"[0-9]*\.[0-9]+", number, reply, count=1)
    outcome = profile.parse(text, Query(unit=unit))
    if isinstance(outcome, IndicatorReading):
        reading = Reading(
            reading=1,
            leg="x",
            axis="y",
            displacement_mm=0.0,
            value_mm=outcome.value_mm,
            text=outcome.text,
            mount="xy",
            resolution_mm=outcome.resolution_mm,
        )
        assert reading.value_mm == outcome.value_mm


def test_more_decimals_than_a_record_takes_are_no_answer() -> None:
    profile = PROFILES["sylvac"]
    assert isinstance(profile.parse("+0.000000001", Query()), IndicatorReading)
    assert profile.parse("+0.0000000001", Query()) == not_understood("+0.0000000001")
