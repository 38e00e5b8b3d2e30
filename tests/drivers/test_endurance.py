"""Ten minutes at full rate in compressed time: nothing lost, nothing mixed up, memory flat."""

from __future__ import annotations

import threading
import tracemalloc
from collections.abc import Callable
from dataclasses import replace

from drivers.line import IndicatorLine
from drivers.profile import IndicatorReading, Outcome, Spindle
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.profiles.sylvac import SYLVAC
from drivers.twins import IndicatorTwin, TwinPort, default_transport
from tests.conftest import LONG

EXCHANGES = 3000
"""Ten minutes at five readings a second, the fastest that these profiles allow."""

WARM = 500
GROWTH_BYTES = 200_000


class Counting:
    """A spindle that moves one step further with every answer."""

    def __init__(self, start_mm: float) -> None:
        self._start_mm = start_mm
        self._count = 0

    def __call__(self) -> float:
        self._count += 1
        return self._start_mm + 0.001 * self._count


@LONG
def test_two_indicators_for_ten_minutes() -> None:
    heard: tuple[list[float], list[float]] = ([], [])
    end = (threading.Event(), threading.Event())
    lines: list[IndicatorLine] = []
    twins: list[TwinPort] = []

    def listener(number: int) -> Callable[[Outcome], None]:
        def hear(outcome: Outcome) -> None:
            assert isinstance(outcome, IndicatorReading)
            heard[number].append(outcome.value_mm)
            if len(heard[number]) >= EXCHANGES:
                end[number].set()

        return hear

    tracemalloc.start()
    patient = [replace(profile, timeout_s=60.0) for profile in (MITUTOYO_01A, SYLVAC)]
    for number, (profile, start) in enumerate(zip(patient, (0.0, -50.0), strict=True)):
        spindle = Spindle(Counting(start), 0.001)
        twins.append(TwinPort(IndicatorTwin(profile, spindle), default_transport()))
        line = IndicatorLine(profile, twins[-1].url, interval_s=0.0, listener=listener(number))
        lines.append(line)
    for line in lines:
        line.start()
    while min(map(len, heard)) < WARM:
        end[0].wait(0.01)
    before = tracemalloc.get_traced_memory()[0]
    assert all(event.wait(600) for event in end)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    for line in lines:
        line.close()
    for twin in twins:
        twin.close()
    for values, start in zip(heard, (0.0, -50.0), strict=True):
        steps = [round((value - start) * 1000) for value in values]
        distance = steps[1] - steps[0]
        assert steps == list(range(steps[0], steps[0] + distance * len(steps), distance))
    values_kept = 2 * 8 * 2 * EXCHANGES * 4  # the lists of this test itself
    assert grown < GROWTH_BYTES + values_kept
