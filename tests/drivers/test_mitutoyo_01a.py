"""The 01A frames: what is a value, what is not, and the twin that speaks them."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.profile import Fault, FaultKind, IndicatorReading, Query, Spindle
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.twins import IndicatorTwin


@pytest.mark.parametrize(
    ("frame", "value", "resolution"),
    [
        (b"01A+0000.123", 0.123, 0.001),
        (b"01A-001.2340", -1.2340, 0.0001),
        (b"01A+00.12345", 0.12345, 0.00001),
        (b"01A+0000.1234", 0.1234, 0.0001),
        (b"01A-0000.000", 0.0, 0.001),
    ],
)
def test_values(frame: bytes, value: float, resolution: float) -> None:
    reading = MITUTOYO_01A.parse(frame.decode("latin-1"), Query())
    assert isinstance(reading, IndicatorReading)
    assert reading.value_mm == value
    assert reading.resolution_mm == pytest.approx(resolution)
    assert reading.unit_assumed
    assert reading.text == frame.decode()


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (b"911", FaultKind.DEVICE_FAULT),
        (b"912", FaultKind.DEVICE_FAULT),
        (b"918", FaultKind.BUSY),
        (b"919", FaultKind.DEVICE_FAULT),
        (b"02A+0000.123", FaultKind.WRONG_CHANNEL),
        (b"01A+0000.1", FaultKind.NOT_UNDERSTOOD),
        (b"01A0000.123", FaultKind.NOT_UNDERSTOOD),
        (b"01A+00001234", FaultKind.NOT_UNDERSTOOD),
        (b"01A+0000.123 ", FaultKind.NOT_UNDERSTOOD),
        (b"x01A+0000.123", FaultKind.NOT_UNDERSTOOD),
        (b"0001,FOOTSWITCH, ,01", FaultKind.NOT_UNDERSTOOD),
        (b"01A+0000.12\xb3", FaultKind.NOT_UNDERSTOOD),
        (b"01A+0000.1.3", FaultKind.NOT_UNDERSTOOD),
        (b"", FaultKind.NOT_UNDERSTOOD),
    ],
)
def test_what_is_not_a_value(frame: bytes, kind: FaultKind) -> None:
    fault = MITUTOYO_01A.parse(frame.decode("latin-1"), Query())
    assert isinstance(fault, Fault)
    assert fault.kind is kind


@given(st.binary(max_size=20))
def test_no_value_from_outside_the_grammar(frame: bytes) -> None:
    outcome = MITUTOYO_01A.parse(frame.decode("latin-1"), Query())
    if isinstance(outcome, IndicatorReading):
        assert re.fullmatch(rb"01A[+-][0-9]+\.[0-9]+", frame)


@given(st.floats(-99.0, 99.0), st.sampled_from([0.01, 0.001, 0.0001]))
def test_the_twin_speaks_what_the_profile_reads(position: float, resolution: float) -> None:
    reply = IndicatorTwin(MITUTOYO_01A, Spindle(lambda: position, resolution)).receive(b"1\r")
    assert reply.endswith(b"\r")
    reading = MITUTOYO_01A.parse(reply[:-1].decode(), Query())
    assert isinstance(reading, IndicatorReading)
    assert abs(reading.value_mm - position) <= resolution / 2 + 1e-9
    assert reading.resolution_mm == pytest.approx(resolution)


def test_the_twin_waits_for_a_whole_request() -> None:
    device = IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 1.0, 0.001))
    assert device.receive(b"1") == b""
    assert device.receive(b"\r1\rx\r").count(b"\r") == 2
