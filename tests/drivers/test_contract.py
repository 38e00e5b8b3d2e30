"""One contract for every profile: real pyserial against its own twin, over pty and over TCP."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from drivers.line import IndicatorLine
from drivers.outcome import Asked, Fault, FaultKind, Outcome, Reading
from drivers.profile import Profile, Spindle
from drivers.profiles import PROFILES
from drivers.twin_port import Transport, TwinPort
from drivers.twins import Trouble, twin_of

TRANSPORTS = (["pty"] if os.name == "posix" else []) + ["tcp"]
QUICK_S = 0.4


@contextmanager
def asked(
    profile: Profile, transport: Transport, position_mm: float, fault: str | None = None
) -> Iterator[IndicatorLine]:
    """A line to the twin of a profile, in compressed time."""
    quick = replace(profile, timeout_s=QUICK_S)
    spindle = Spindle(lambda: position_mm, 0.001)
    with TwinPort(twin_of(profile, spindle, fault), transport, stream_s=profile.stream_s) as twin:
        line = IndicatorLine(quick, twin.url, interval_s=0.0)
        line.start()
        try:
            yield line
        finally:
            line.close()


def outcome(
    profile: Profile, transport: Transport, position_mm: float = 1.234, fault: str | None = None
) -> Outcome:
    with asked(profile, transport, position_mm, fault) as line:
        return line.ask().result(timeout=20)


every_profile = pytest.mark.parametrize("profile", PROFILES.values(), ids=list(PROFILES))
every_transport = pytest.mark.parametrize("transport", TRANSPORTS)


@every_profile
@every_transport
def test_values(profile: Profile, transport: Transport) -> None:
    for position in (1.234, -0.567, 0.0):
        found = outcome(profile, transport, position)
        assert isinstance(found, Reading), found
        assert found.value_mm == pytest.approx(position, abs=0.0005 + found.resolution_mm / 2)


@every_profile
@every_transport
def test_own_faults(profile: Profile, transport: Transport) -> None:
    assert profile.bad_replies, "a profile names at least one fault of its device"
    for name, bad in profile.bad_replies.items():
        found = outcome(replace(profile, busy_retries=0), transport, fault=name)
        assert isinstance(found, Fault), (name, found)
        assert found.kind is bad.kind, (name, found)
        assert found.words


@every_profile
@every_transport
@pytest.mark.parametrize(
    ("trouble", "kinds"),
    [
        (Trouble.SILENCE, {FaultKind.NO_ANSWER}),
        (Trouble.SPLIT, {FaultKind.PARTIAL_LINE, FaultKind.NOT_UNDERSTOOD, FaultKind.NO_ANSWER}),
        (Trouble.NOISE, {FaultKind.NOT_UNDERSTOOD}),
        (
            Trouble.PARITY,
            {FaultKind.WRONG_PARITY, FaultKind.PARTIAL_LINE, FaultKind.NOT_UNDERSTOOD},
        ),
        (Trouble.DISCONNECT, {FaultKind.DISCONNECTED, FaultKind.NO_ANSWER}),
    ],
)
def test_troubles_never_give_a_value(
    profile: Profile, transport: Transport, trouble: Trouble, kinds: set[FaultKind]
) -> None:
    found = outcome(profile, transport, fault=trouble)
    assert isinstance(found, Fault), found
    assert found.kind in kinds


@every_profile
@every_transport
@pytest.mark.parametrize("trouble", [Trouble.ECHO, Trouble.SLOW])
def test_troubles_that_a_reader_must_stand(
    profile: Profile, transport: Transport, trouble: Trouble
) -> None:
    """An echo is passed over; a late answer is no value, or the right one."""
    found = outcome(replace(profile, timeout_s=2.0), transport, -0.321, trouble)
    if trouble is Trouble.ECHO and profile.request is not None:
        ended = profile.request(Asked()).endswith((b"\r", b"\n"))
        assert isinstance(found, Reading) or not ended
    if isinstance(found, Reading):
        assert found.value_mm == pytest.approx(-0.321, abs=0.001)


@every_profile
@every_transport
def test_no_reading_is_stale(profile: Profile, transport: Transport) -> None:
    """Whatever was asked, the answer is where the spindle stood after the question."""
    position = [0.0]
    twin = profile.make_twin(Spindle(lambda: position[0], 0.001))
    with TwinPort(twin, transport, stream_s=profile.stream_s) as port:
        line = IndicatorLine(replace(profile, timeout_s=2.0), port.url, interval_s=0.0)
        line.start()
        for step in range(1, 6):
            position[0] = 0.25 * step
            time.sleep(2 * profile.stream_s)
            found = line.ask().result(timeout=10)
            assert isinstance(found, Reading)
            assert found.value_mm == pytest.approx(0.25 * step, abs=0.001)
        line.close()
