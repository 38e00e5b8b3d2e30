"""The doctor names each fault and says what to do."""

from __future__ import annotations

import os
import random
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from serial import SerialException

from calib.errors import IndicatorError
from drivers.doctor import (
    PortFinding,
    Trials,
    examine,
    examine_by_trial,
    findings_of,
    keyboard_tools,
    try_profiles,
)
from drivers.profile import BadReply, Evidence, FaultKind, Profile, Query, Spindle, Unit
from drivers.profiles import PROFILES
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A, MITUTOYO_MUX
from drivers.profiles.sylvac import SYLVAC
from drivers.twins import IndicatorTwin, LineTrouble, Twin, TwinPort, default_transport
from tests.conftest import first_quick

QUICK = replace(MITUTOYO_01A, timeout_s=0.3, interval_s=0.0)


def told(profile: Profile, port: str, query: Query | None = None) -> str:
    findings = examine(profile, port, query or Query(), PROFILES.values())
    assert all(finding.next_step for finding in findings if not finding.well)
    return "\n".join(f"{f.well} {f.description} {f.next_step}" for f in findings)


def examined(profile: Profile, fault: str | None = None, position_mm: float = 0.5) -> str:
    twin = IndicatorTwin(profile, Spindle(lambda: position_mm, 0.001), fault)
    with TwinPort(twin, "tcp") as port:
        return told(profile, port.url)


def test_a_healthy_indicator() -> None:
    words = examined(QUICK)
    assert "False" not in words
    assert "answers +0.5 mm" in words
    assert "names no unit; mm is assumed" in words


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (LineTrouble.SILENCE, "no answer"),
        (LineTrouble.PARITY, "wrong parity"),
        ("no-data", "battery empty"),
        ("wrong-channel", "wrong channel"),
        ("busy", "busy"),
    ],
)
def test_faults_by_name(fault: str, message: str) -> None:
    lines = examined(QUICK, fault).splitlines()
    assert any(line.startswith("False ") and message in line for line in lines)


def test_over_range_and_wrong_profile() -> None:
    quick = replace(SYLVAC, timeout_s=0.3, interval_s=0.0)
    assert "over range" in examined(quick, "over-range")
    with TwinPort(IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 0.5, 0.001)), "tcp"):
        pass
    device = IndicatorTwin(MITUTOYO_01A, Spindle(lambda: 0.5, 0.001))

    class AnswersAnything:
        def receive(self, request: bytes) -> bytes:
            return device.receive(b"1\r")

    with TwinPort(AnswersAnything(), "tcp") as port:
        words = told(quick, port.url)
    assert "not understood" in words
    assert "fits mitutoyo-01a" in words


def test_wrong_unit_and_inch_that_looks_like_it() -> None:
    in_inch = replace(
        QUICK, bad_replies={"inch": BadReply(b"01A+00.12345\r", FaultKind.WRONG_UNIT)}
    )
    assert "look like inch" in examined(in_inch, "inch")
    with TwinPort(IndicatorTwin(QUICK, Spindle(lambda: 0.5, 0.001)), "tcp") as port:
        assert "+12.7 mm" in told(QUICK, port.url, Query(unit=Unit.INCH))


def test_missing_and_busy_ports() -> None:
    assert "no such port" in told(QUICK, "/dev/ttyNONE9")
    assert "no device answers" in told(QUICK, "socket://127.0.0.1:1")


def test_unverified_profiles_say_so() -> None:
    assert MITUTOYO_MUX.verified is Evidence.UNVERIFIED
    assert "unverified" in told(replace(MITUTOYO_MUX, timeout_s=0.2), "socket://127.0.0.1:1")


def test_far_out() -> None:
    assert "beyond the travel" in examined(QUICK, position_mm=250.0)


def test_usb_tool_that_is_a_keyboard(tmp_path: Path) -> None:
    device = tmp_path / "1-2"
    device.mkdir()
    (device / "idVendor").write_text("0fe7\n")
    (device / "idProduct").write_text("4001\n")
    (finding,) = keyboard_tools(tmp_path)
    assert isinstance(finding, PortFinding)
    assert not finding.well
    assert "VCP driver" in finding.next_step


def test_no_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(port: str, **_: object) -> None:
        raise PermissionError(13, "Permission denied", port)

    monkeypatch.setattr("serial.serial_for_url", refuse)
    assert "no permission" in told(QUICK, "/dev/ttyUSB0")
    assert "dialout" in told(QUICK, "/dev/ttyUSB0")


def test_a_port_that_windows_refuses_may_be_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(port: str, **_: object) -> None:
        why = PermissionError(13, "Access is denied.", None, 5)
        raise SerialException(f"could not open port {port!r}: {why!r}")

    monkeypatch.setattr("serial.serial_for_url", refuse)
    assert "in use" in told(QUICK, "COM5")
    assert "dialout" not in told(QUICK, "COM5")


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals need POSIX")
def test_port_in_use() -> None:
    from drivers.port import open_port

    with TwinPort(IndicatorTwin(QUICK, Spindle(lambda: 0.5, 0.001)), "pty") as port:
        holder = open_port(QUICK, port.url)
        assert "in use by another program" in told(QUICK, port.url)
        holder.close()


HASTY, PATIENT = (
    tuple(replace(p, timeout_s=timeout_s, interval_s=0.0) for p in PROFILES.values())
    for timeout_s in (0.15, 2.0)
)
"""A busy machine may hold an answer up for longer than the first wait."""

SETS = (
    {"sylvac", "sylvac-simplex", "mahr-marcator", "tesa"},
    {"mitutoyo-counter", "mitutoyo-vl50"},
)
IT007R_LIKE = {"mitutoyo-01a", "mitutoyo-it007r", "mitutoyo-mux"}
ALIKE = {name: alike for alike in SETS for name in alike} | {
    # they take the 1 out of the requests 1, CR and C1, CR, LF; those who want the end do not
    "mitutoyo-it007r": IT007R_LIKE,
    "mitutoyo-mux": IT007R_LIKE,
    "mux": {"mux", "dmx"},
}
"""What answers alike where speed and parity mean nothing; the others stand alone."""


def tried(twin: Twin, stream_s: float = 0.0, profiles: Sequence[Profile] = HASTY) -> Trials:
    with TwinPort(twin, default_transport(), stream_s=stream_s) as port:
        return try_profiles(profiles, port.url, Query())


def names(trials: Trials) -> set[str]:
    return {profile.name for profile, _ in trials.fits}


def trial_of_twin(name: str) -> Trials:
    profile = PROFILES[name]
    twin = IndicatorTwin(profile, Spindle(lambda: 0.5, 0.001))
    stream_s = min(profile.stream_s, 0.03)
    trial = tried(twin, stream_s)
    return trial if names(trial) == ALIKE.get(name, {name}) else tried(twin, stream_s, PATIENT)


def test_trying_names_the_profile_of_each_twin() -> None:
    """Eight at once: a trial waits far longer than it works."""
    with ThreadPoolExecutor(8) as threads:
        trials = dict(zip(PROFILES, threads.map(trial_of_twin, PROFILES), strict=True))
    for name, trial in trials.items():
        assert names(trial) == ALIKE.get(name, {name}), name
        assert all(finding.well for finding in findings_of(trial)), name


@dataclass
class Cable:
    """A serial port whose device hears noise, and stays silent, at other settings than its own."""

    device: Profile
    twin: Twin
    written: list[bytes]
    here: bytes = b""

    def __call__(self, _: str, **settings: object) -> Cable:
        settings_of_line, keys = self.device.line, ("baudrate", "bytesize", "parity", "stopbits")
        expected = (
            settings_of_line.baud,
            settings_of_line.data_bits,
            settings_of_line.parity,
            settings_of_line.stop_bits,
        )
        self.matched, self.here = tuple(settings[key] for key in keys) == expected, b""
        return self

    def open(self) -> None: ...

    def close(self) -> None: ...

    def write(self, request: bytes) -> None:
        self.written.append(request)
        self.here += self.twin.receive(request) if self.matched else b""
        if not self.matched:
            self.twin.receive(b"\x80")

    @property
    def in_waiting(self) -> int:
        if self.device.stream_s and self.matched and not self.here:
            self.here = self.twin.receive(b"")
            time.sleep(0.01)
        return len(self.here) if not self.device.stream_s else 0

    def read(self, size: int) -> bytes:
        assert self.in_waiting >= 0
        if not self.here:
            time.sleep(0.02)
        content, self.here = self.here[:size], self.here[size:]
        return content


@pytest.mark.parametrize(
    "name",
    first_quick(
        [
            "sylvac",
            "mahr-c1202",
            "mitutoyo-vl50",
            "mitutoyo-01a",
            "mitutoyo-it007r",
            "mux",
            "u-wave",
        ]
    ),
)
def test_trying_on_a_line_with_speed_and_parity(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The device hears noise until it is asked at its own settings."""
    profile = PROFILES[name]
    cable = Cable(profile, IndicatorTwin(profile, Spindle(lambda: 0.5, 0.001)), [])
    monkeypatch.setattr("serial.serial_for_url", cable)
    monkeypatch.setattr("drivers.doctor.LISTEN_S", 0.2)
    trial = try_profiles(HASTY, "/dev/ttyUSB7", Query())
    assert name in names(trial)
    line_settings = (profile.line.baud, profile.line.parity)
    assert {(profile.line.baud, profile.line.parity) for profile, _ in trial.fits} == {
        line_settings
    }
    if profile.request is None:
        assert not cable.written


class Echo:
    def receive(self, request: bytes) -> bytes:
        return request


class Noise:
    def __init__(self, seed: int) -> None:
        self._chance = random.Random(seed)

    def receive(self, request: bytes) -> bytes:
        return self._chance.randbytes(self._chance.randrange(1, 60)) + b"\r"


@pytest.mark.parametrize(
    ("twin", "stream_s"),
    [
        (IndicatorTwin(SYLVAC, Spindle(lambda: 0.5, 0.001), LineTrouble.SILENCE), 0.0),
        (IndicatorTwin(SYLVAC, Spindle(lambda: 0.5, 0.001), LineTrouble.NOISE), 0.0),
        (IndicatorTwin(SYLVAC, Spindle(lambda: 0.5, 0.001), LineTrouble.PARITY), 0.0),
        (Echo(), 0.0),
        *first_quick([(Noise(seed), 0.0) for seed in range(3)], several=True),
        *first_quick([(Noise(seed), 0.02) for seed in range(3)], several=True),
    ],
)
def test_no_profile_is_named_for_silence_noise_or_an_echo(twin: Twin, stream_s: float) -> None:
    trial = tried(twin, stream_s)
    assert not trial.fits
    (*_, last) = findings_of(trial)
    assert not last.well
    assert "no profile fits" in last.description


def test_trying_names_a_profile_in_another_unit_and_says_so() -> None:
    trial = tried(IndicatorTwin(PROFILES["mux"], Spindle(lambda: 0.5, 0.001), "wrong-unit"))
    assert names(trial) == ALIKE["mux"]
    findings = findings_of(trial)
    assert not any(finding.well for finding in findings if "fits" in finding.description)
    assert any("reads in inch, mm is expected" in finding.description for finding in findings)


def test_trying_stops_when_asked_and_ends_where_the_port_is_gone() -> None:
    stopped = try_profiles(HASTY, "socket://127.0.0.1:1", Query(), stopped=lambda: True)
    assert (stopped.fits, stopped.count) == ((), 0)
    twin = IndicatorTwin(QUICK, Spindle(lambda: 0.5, 0.001), LineTrouble.DISCONNECT)
    with TwinPort(twin, "tcp") as port, pytest.raises(IndicatorError, match="no device answers"):
        try_profiles(HASTY, port.url, Query())


def test_trying_a_port_that_does_not_open() -> None:
    (*_, finding) = examine_by_trial("/dev/ttyNONE9", Query(), HASTY, lambda *_: None)
    assert not finding.well
    assert "no such port" in finding.description
