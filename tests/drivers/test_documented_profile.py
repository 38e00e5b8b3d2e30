"""The profile that the documentation shows works as it stands there."""

from __future__ import annotations

import re
from typing import Any

from drivers.profile import FaultKind, IndicatorReading, Profile, Query, Spindle
from drivers.twins import IndicatorTwin
from tests.conftest import ROOT


def test_example_of_the_documentation() -> None:
    text = (ROOT / "docs" / "indicators.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(code.splitlines()) < 60
    names: dict[str, Any] = {}
    exec(compile(code, "docs/indicators.md", "exec"), names)
    example: Profile = names["EXAMPLE"]
    reply = IndicatorTwin(example, Spindle(lambda: -1.5, 0.001)).receive(b"R\r")
    reading = example.parse(reply.decode().strip(), Query())
    assert isinstance(reading, IndicatorReading)
    assert reading.value_mm == -1.5
    for bad in example.bad_replies.values():
        fault = example.parse(bad.reply.decode().strip(), Query())
        assert not isinstance(fault, IndicatorReading)
        assert fault is not None
        assert fault.kind is bad.kind
    assert example.bad_replies["inch"].kind is FaultKind.WRONG_UNIT
