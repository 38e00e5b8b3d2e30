"""What a device sends unasked, and a port that goes away and comes back."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.line import IndicatorLine
from drivers.profile import Fault, FaultKind, IndicatorReading, Outcome, Spindle
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.profiles.sylvac import SYLVAC
from drivers.twins import IndicatorTwin, TwinPort

PATIENCE_S = 30.0


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "did not happen"
        time.sleep(0.005)


def test_a_pressed_button_is_a_take_and_not_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes come over a bare socket: first an answer, later a value nobody asked for."""
    monkeypatch.setattr("drivers.exchange.ALONE_S", 0.2)
    pressed: list[Outcome] = []
    outcomes: list[Outcome] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        polled = replace(SYLVAC, interval_s=0.3)
        line = IndicatorLine(polled, url, listener=outcomes.append, on_button=pressed.append)
        line.start()
        client, _ = server.accept()
        with client:
            client.settimeout(PATIENCE_S)
            assert client.recv(10) == b"?\r"
            client.sendall(b"+000.100\r")
            time.sleep(0.1)
            client.sendall(b"+000.200\r")
            for _ in range(2):
                assert client.recv(10) == b"?\r"
                client.sendall(b"+000.300\r")
            until(lambda: len(outcomes) == 3)
            line.close()
    assert [o.value_mm for o in outcomes if isinstance(o, IndicatorReading)] == [0.1, 0.3, 0.3]
    assert [o.value_mm for o in pressed if isinstance(o, IndicatorReading)] == [0.2]


@pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals and links")
def test_replugged_under_the_same_name(tmp_path: Path) -> None:
    """The port vanishes and comes back; the line notices both by itself."""
    name = tmp_path / "gauge"
    outcomes: list[Outcome] = []
    quick = replace(MITUTOYO_01A, timeout_s=10.0)
    first = TwinPort(IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 1.0, 0.001)), "pty")
    name.symlink_to(first.url)
    line = IndicatorLine(quick, str(name), interval_s=0.02, listener=outcomes.append)
    line.start()
    until(lambda: bool(outcomes) and isinstance(outcomes[-1], IndicatorReading))
    pulled = time.monotonic()
    first.close()
    name.unlink()
    until(lambda: isinstance(outcomes[-1], Fault))
    assert time.monotonic() - pulled <= 1.5 * quick.timeout_s
    fault = outcomes[-1]
    assert isinstance(fault, Fault)
    assert fault.kind is FaultKind.DISCONNECTED
    with TwinPort(IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 2.0, 0.001)), "pty") as second:
        name.symlink_to(second.url)
        until(lambda: isinstance(outcomes[-1], IndicatorReading))
        line.close()
    back = outcomes[-1]
    assert isinstance(back, IndicatorReading)
    assert back.value_mm == 2.0
