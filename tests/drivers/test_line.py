"""A line through real pyserial over a pseudo-terminal and over TCP, with faults on demand."""

from __future__ import annotations

import os
import queue
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace

import pytest

from calib.errors import IndicatorError, UsageError
from drivers.line import IndicatorLine
from drivers.port import open_port
from drivers.profile import Fault, FaultKind, IndicatorReading, Outcome, Profile, Spindle
from drivers.profiles import profile_named
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.profiles.sylvac import SYLVAC
from drivers.twins import IndicatorTwin, SimulatedRig, Transport, TwinPort

QUICK = replace(MITUTOYO_01A, timeout_s=0.3, interval_s=60.0)
POSIX = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals need POSIX")
BOTH = [pytest.param("pty", marks=POSIX), "tcp"]


class Scripted:
    """A device whose answers are written down beforehand."""

    def __init__(self, *answers: bytes, after_s: float = 0.0) -> None:
        self._answers = list(answers)
        self._after_s = after_s

    def receive(self, request: bytes) -> bytes:
        time.sleep(self._after_s)
        return self._answers.pop(0) if self._answers else b""


@contextmanager
def line(port: str, profile: Profile = QUICK) -> Iterator[IndicatorLine]:
    opened = IndicatorLine(profile, port)
    opened.start()
    try:
        yield opened
    finally:
        opened.close()


def first_outcome(port: str) -> Outcome:
    """The line asks by itself at once; the interval then keeps it silent."""
    outcomes: list[Outcome] = []
    opened = IndicatorLine(QUICK, port, listener=outcomes.append)
    opened.start()
    try:
        deadline = time.monotonic() + 60
        while not outcomes and time.monotonic() < deadline:
            time.sleep(0.01)
    finally:
        opened.close()
    return outcomes[0]


@pytest.mark.parametrize("transport", BOTH)
@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        (b"", FaultKind.NO_ANSWER),
        (b"01A+0000.1", FaultKind.PARTIAL_LINE),
        (b"911\r", FaultKind.DEVICE_FAULT),
        (b"02A+0000.123\r", FaultKind.WRONG_CHANNEL),
        (b"\x30\xb1\x8d", FaultKind.WRONG_PARITY),
    ],
)
def test_faults(transport: Transport, answer: bytes, kind: FaultKind) -> None:
    with TwinPort(Scripted(answer), transport) as twin:
        outcome = first_outcome(twin.url)
    assert isinstance(outcome, Fault)
    assert outcome.kind is kind
    assert outcome.words


@pytest.mark.parametrize("transport", BOTH)
@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n", b"\n\r"])
def test_terminators(transport: Transport, end: bytes) -> None:
    with TwinPort(Scripted(b"\x00\r\n01A+0001.500" + end), transport) as twin:
        outcome = first_outcome(twin.url)
    assert isinstance(outcome, IndicatorReading)
    assert outcome.value_mm == 1.5


@pytest.mark.parametrize("transport", BOTH)
def test_busy_is_asked_again(transport: Transport) -> None:
    device = Scripted(b"918\r", b"918\r", b"01A-0000.250\r")
    with TwinPort(device, transport) as twin:
        outcome = first_outcome(twin.url)
    assert isinstance(outcome, IndicatorReading)


@pytest.mark.parametrize("transport", BOTH)
def test_a_late_answer_is_not_taken_for_the_next_reading(transport: Transport) -> None:
    """The first answer comes after the time-out; the second request must get the second."""
    device = Scripted(b"01A+0001.000\r", b"01A+0002.000\r", after_s=0.5)
    with TwinPort(device, transport) as twin:
        outcomes: list[Outcome] = []
        opened = IndicatorLine(
            replace(QUICK, timeout_s=0.3), twin.url, interval_s=0.05, listener=outcomes.append
        )
        opened.start()
        deadline = time.monotonic() + 60
        while len(outcomes) < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
        opened.close()
    values = [outcome.value_mm for outcome in outcomes if isinstance(outcome, IndicatorReading)]
    assert isinstance(outcomes[0], Fault)
    assert 1.0 not in values


@pytest.mark.parametrize("transport", BOTH)
def test_unplugged_and_plugged_in_again(transport: Transport) -> None:
    twin = TwinPort(IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 0.5, 0.001)), transport)
    with line(twin.url, replace(QUICK, interval_s=0.05)) as opened:
        assert isinstance(opened.ask().result(timeout=60), IndicatorReading)
        twin.close()
        gone = opened.ask().result(timeout=60)
        assert isinstance(gone, Fault)
        assert gone.kind is FaultKind.DISCONNECTED
        assert opened.port in gone.words


@pytest.mark.parametrize("transport", BOTH)
def test_two_indicators_on_a_moving_rig(transport: Transport) -> None:
    with closing(SimulatedRig([QUICK, QUICK], resolution_mm=0.001, transport=transport)) as rig:
        lines = [IndicatorLine(QUICK, port, interval_s=0.01) for port in rig.ports]
        for opened in lines:
            opened.start()
        for goal in ((0.1, -0.1), (1.234, 5.678), (-0.5, 0.0)):
            rig.go(goal)
            values = [opened.ask().result(timeout=60) for opened in lines]
            assert [v.value_mm for v in values if isinstance(v, IndicatorReading)] == list(goal)
        for opened in lines:
            opened.close()


def test_motion_takes_its_time() -> None:
    """By a clock of its own: nothing here depends on how busy the computer is."""
    now_s = [100.0]
    indicator = replace(MITUTOYO_01A, interval_s=0.01)
    with closing(
        SimulatedRig(
            [indicator], resolution_mm=0.001, transport="tcp", motion_s=0.5, clock=lambda: now_s[0]
        )
    ) as rig:
        rig.go((10.0,))
        with line(rig.ports[0], indicator) as opened:
            values = []
            for passed_s in (0.0, 0.25, 0.499, 0.5, 60.0):
                now_s[0] = 100.0 + passed_s
                outcome = opened.ask().result(timeout=30)
                assert isinstance(outcome, IndicatorReading)
                values.append(outcome.value_mm)
    assert values[0] == 0.0
    assert 0.0 < values[1] < values[2] <= values[3] == values[4] == 10.0
    assert values[1] == pytest.approx(5.0)  # half way in half the time


def refused(port: str) -> str:
    with pytest.raises(IndicatorError) as caught:
        open_port(QUICK, port)
    return str(caught.value)


def test_ports_that_cannot_be_opened() -> None:
    assert "no device answers" in refused("socket://127.0.0.1:1")
    assert "foo" in refused("foo://bar")
    missing = refused("COM250" if sys.platform == "win32" else "/dev/ttyNONE9")
    assert "no such port" in missing
    assert "glidecal ports" in missing


@POSIX
def test_a_busy_port_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with TwinPort(Scripted(), "pty") as twin:
        first = open_port(QUICK, twin.url)
        assert "in use" in refused(twin.url)
        first.close()


def test_unknown_profile_lists_what_exists() -> None:
    with pytest.raises(UsageError, match="mitutoyo-01a"):
        profile_named("mitutoyo")


def test_asking_a_closed_line_gives_a_fault() -> None:
    with TwinPort(Scripted(), "tcp") as twin:
        opened = IndicatorLine(QUICK, twin.url)
        opened.start()
        opened.close()
        outcome = opened.ask().result(timeout=1)
    assert isinstance(outcome, Fault)


def test_a_line_that_is_asked_while_it_is_closed_does_not_wait_for_its_turn() -> None:
    def ask_often(opened: IndicatorLine, together: threading.Barrier) -> None:
        together.wait()
        for _ in range(200):
            opened.ask()

    slow = replace(QUICK, interval_s=60.0)
    with TwinPort(IndicatorTwin(QUICK, Spindle(lambda: 0.5, 0.001)), "tcp") as twin:
        for _ in range(8):
            outcomes: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
            opened = IndicatorLine(slow, twin.url, listener=outcomes.put)
            opened.start()
            outcomes.get(timeout=60.0)
            together = threading.Barrier(2)
            asking = threading.Thread(target=ask_often, args=(opened, together))
            asking.start()
            together.wait()
            began_s = time.monotonic()
            opened.close()
            assert time.monotonic() - began_s < 30.0
            asking.join()


@pytest.mark.parametrize("poured", [b"01A+0000.100\r", b"x"])
def test_a_flood_on_a_socket_ends_with_an_outcome_and_a_closed_port(poured: bytes) -> None:
    """As fast as the socket takes it; the times are held in `test_exchange` in simulated time."""
    end = threading.Event()

    def pour(client: socket.socket) -> None:
        with suppress(OSError):
            while not end.is_set():
                client.sendall(poured * 1000)

    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with line(url, replace(QUICK, interval_s=0.05)) as opened:
            client, _ = server.accept()
            pouring = threading.Thread(target=pour, args=(client,), daemon=True)
            pouring.start()
            outcomes = [opened.ask().result(timeout=60) for _ in range(3)]
        end.set()
        client.close()
        pouring.join()
    assert isinstance(outcomes[-1], Fault)
    assert outcomes[-1].kind is FaultKind.SENDS_UNASKED


def test_settings_of_the_profile_reach_the_port(monkeypatch: pytest.MonkeyPatch) -> None:
    settings_made: dict[str, object] = {}

    class Port:
        dtr = rts = None

        def open(self) -> None:
            settings_made.update(dtr=self.dtr, rts=self.rts)

    def record(port: str, **settings: object) -> Port:
        settings_made.update(settings, port=port)
        return Port()

    monkeypatch.setattr("serial.serial_for_url", record)
    open_port(SYLVAC, "COM5")
    assert (settings_made["dtr"], settings_made["rts"]) == (True, False)
    assert (settings_made["bytesize"], settings_made["parity"], settings_made["stopbits"]) == (
        7,
        "E",
        2,
    )
    open_port(QUICK, "COM5")
    assert (
        settings_made["baudrate"],
        settings_made["bytesize"],
        settings_made["parity"],
        settings_made["stopbits"],
    ) == (
        9600,
        8,
        "N",
        1,
    )
    assert settings_made["exclusive"] is True
    assert isinstance(settings_made["timeout"], float)
