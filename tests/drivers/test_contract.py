"""One contract for every profile: real pyserial against its own twin, over pty and over TCP."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from functools import partial

import pytest

from drivers.line import IndicatorLine
from drivers.profile import Fault, FaultKind, IndicatorReading, Outcome, Profile, Query, Spindle
from drivers.profiles import PROFILES
from drivers.twins import IndicatorTwin, LineTrouble, Transport, TwinPort
from tests.conftest import first_quick

TRANSPORTS = (["pty"] if os.name == "posix" else []) + ["tcp"]
QUICK_S, PATIENT_S = 0.4, 2.0
"""For an answer that does not come, and for one that does, on a busy machine, too."""


@contextmanager
def plugged(
    profile: Profile, transport: Transport, position_mm: float, fault: str | None = None
) -> Iterator[TwinPort]:
    """The twin of a profile; the number of its pty goes to nobody else when it is pulled."""
    twin = IndicatorTwin(profile, Spindle(lambda: position_mm, 0.001), fault)
    with TwinPort(twin, transport, stream_s=profile.stream_s) as port:
        descriptor = os.open(port.url, os.O_RDWR | os.O_NOCTTY) if transport == "pty" else None
        try:
            yield port
        finally:
            if descriptor is not None:
                os.close(descriptor)


def answer(profile: Profile, port: TwinPort) -> Outcome:
    """One question on a line of its own, in compressed time."""
    line = IndicatorLine(profile, port.url, interval_s=0.01)
    line.start()
    try:
        return line.ask().result(timeout=300)
    finally:
        line.close()


def outcomes(
    profile: Profile, ports: Iterable[AbstractContextManager[TwinPort]], timeout_s: float = QUICK_S
) -> list[Outcome]:
    """Of all at once: lines wait for devices far longer than they work."""
    quick = replace(profile, timeout_s=timeout_s)
    with ExitStack() as stack:
        open_ports = [stack.enter_context(port) for port in ports]
        with ThreadPoolExecutor(len(open_ports)) as threads:
            return list(threads.map(partial(answer, quick), open_ports))


every_profile = pytest.mark.parametrize("profile", PROFILES.values(), ids=list(PROFILES))
every_transport = pytest.mark.parametrize("transport", TRANSPORTS)
first_transport = pytest.mark.parametrize("transport", first_quick(TRANSPORTS))
"""For what is mostly waited for: values are asked for over each in every run."""


@every_profile
@every_transport
def test_values(profile: Profile, transport: Transport) -> None:
    positions = (1.234, -0.567, 0.0)
    ports = (plugged(profile, transport, position) for position in positions)
    for position, outcome in zip(positions, outcomes(profile, ports, PATIENT_S), strict=True):
        assert isinstance(outcome, IndicatorReading), outcome
        assert outcome.value_mm == pytest.approx(position, abs=0.0005 + outcome.resolution_mm / 2)


@every_profile
@first_transport
def test_own_faults(profile: Profile, transport: Transport) -> None:
    assert profile.bad_replies, "a profile names at least one fault of its device"
    hasty = replace(profile, busy_retries=0)
    ports = (plugged(profile, transport, 1.234, name) for name in profile.bad_replies)
    pairs = zip(profile.bad_replies.items(), outcomes(hasty, ports, profile.timeout_s), strict=True)
    for (name, bad), outcome in pairs:
        assert isinstance(outcome, Fault), (name, outcome)
        assert outcome.kind is bad.kind, (name, outcome)
        assert outcome.words


NO_VALUE = {
    LineTrouble.SILENCE: {FaultKind.NO_ANSWER},
    LineTrouble.SPLIT: {FaultKind.PARTIAL_LINE, FaultKind.NOT_UNDERSTOOD, FaultKind.NO_ANSWER},
    LineTrouble.NOISE: {FaultKind.NOT_UNDERSTOOD},
    LineTrouble.PARITY: {FaultKind.WRONG_PARITY, FaultKind.PARTIAL_LINE, FaultKind.NOT_UNDERSTOOD},
    LineTrouble.DISCONNECT: {FaultKind.DISCONNECTED, FaultKind.NO_ANSWER},
}


@every_profile
@first_transport
def test_troubles_never_give_a_value(profile: Profile, transport: Transport) -> None:
    ports = (plugged(profile, transport, 1.234, trouble) for trouble in NO_VALUE)
    pairs = zip(NO_VALUE.items(), outcomes(profile, ports), strict=True)
    for (trouble, kinds), outcome in pairs:
        assert isinstance(outcome, Fault), (trouble, outcome)
        assert outcome.kind in kinds, (trouble, outcome)


@every_profile
@first_transport
def test_troubles_that_a_reader_must_stand(profile: Profile, transport: Transport) -> None:
    """An echo is passed over; a late answer is no value, or the right one."""
    troubles = (LineTrouble.ECHO, LineTrouble.SLOW)
    ports = (plugged(profile, transport, -0.321, trouble) for trouble in troubles)
    for trouble, outcome in zip(troubles, outcomes(profile, ports, timeout_s=2.0), strict=True):
        if trouble is LineTrouble.ECHO and profile.request is not None:
            ended = profile.request(Query()).endswith((b"\r", b"\n"))
            assert isinstance(outcome, IndicatorReading) or not ended
        if isinstance(outcome, IndicatorReading):
            assert outcome.value_mm == pytest.approx(-0.321, abs=0.001), trouble


@every_profile
@first_transport
def test_no_reading_is_stale(profile: Profile, transport: Transport) -> None:
    """Whatever was asked, the answer is where the spindle stood after the question."""
    position = [0.0]
    twin = IndicatorTwin(profile, Spindle(lambda: position[0], 0.001))
    with TwinPort(twin, transport, stream_s=profile.stream_s) as port:
        line = IndicatorLine(replace(profile, timeout_s=2.0), port.url, interval_s=0.01)
        line.start()
        for step in range(1, 6):
            position[0] = 0.25 * step
            time.sleep(2 * profile.stream_s)
            outcome = line.ask().result(timeout=60)
            assert isinstance(outcome, IndicatorReading)
            assert outcome.value_mm == pytest.approx(0.25 * step, abs=0.001)
        line.close()
