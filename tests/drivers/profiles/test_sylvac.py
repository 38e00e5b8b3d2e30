"""Sylvac: literal replies and what is passed over."""

from __future__ import annotations

import pytest

from drivers.profile import Fault, FaultKind, IndicatorReading, Query
from drivers.profiles.sylvac import SYLVAC


@pytest.mark.parametrize(
    ("text", "value", "step"),
    [
        ("+012.345", 12.345, 0.001),
        (" 12.345", 12.345, 0.001),
        ("-0.001", -0.001, 0.001),
        ("+012.345=", 12.345, 0.001),
        ("+012.345<", 12.345, 0.001),
        ("+000.00", 0.0, 0.01),
    ],
)
def test_values(text: str, value: float, step: float) -> None:
    reading = SYLVAC.parse(text, Query())
    assert isinstance(reading, IndicatorReading)
    assert (reading.value_mm, reading.resolution_mm) == (value, step)
    assert reading.unit_assumed


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("ERR0", FaultKind.DEVICE_FAULT),
        ("ERR1", FaultKind.DEVICE_FAULT),
        ("ERR2", FaultKind.DEVICE_FAULT),
        ("ERR3", FaultKind.OVER_RANGE),
        ("12.345", FaultKind.NOT_UNDERSTOOD),
        ("+012345", FaultKind.NOT_UNDERSTOOD),
        ("+012.345 mm", FaultKind.NOT_UNDERSTOOD),
        ("", FaultKind.NOT_UNDERSTOOD),
    ],
)
def test_what_is_not_a_value(text: str, kind: FaultKind) -> None:
    fault = SYLVAC.parse(text, Query())
    assert isinstance(fault, Fault)
    assert fault.kind is kind


@pytest.mark.parametrize("text", ["SY276", "SY123.opt.opt", "?", "PRI"])
def test_identification_and_echo_are_passed_over(text: str) -> None:
    assert SYLVAC.parse(text, Query()) is None
