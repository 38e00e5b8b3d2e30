"""The doctor names each fault and says what to do."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.doctor import Finding, examine, keyboard_tools
from drivers.profile import Asked, BadReply, FaultKind, Profile, Spindle, Unit, Verified
from drivers.profiles import PROFILES
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A, MITUTOYO_MUX
from drivers.profiles.sylvac import SYLVAC
from drivers.twin_port import TwinPort
from drivers.twins import Trouble, twin_of

QUICK = replace(MITUTOYO_01A, timeout_s=0.3, interval_s=0.0)


def told(profile: Profile, port: str, asked: Asked | None = None) -> str:
    findings = examine(profile, port, asked or Asked(), PROFILES.values())
    assert all(finding.next_step for finding in findings if not finding.well)
    return "\n".join(f"{f.well} {f.what} {f.next_step}" for f in findings)


def examined(profile: Profile, fault: str | None = None, position_mm: float = 0.5) -> str:
    twin = twin_of(profile, Spindle(lambda: position_mm, 0.001), fault)
    with TwinPort(twin, "tcp") as port:
        return told(profile, port.url)


def test_a_healthy_indicator() -> None:
    words = examined(QUICK)
    assert "False" not in words
    assert "answers +0.5 mm" in words
    assert "names no unit; mm is assumed" in words


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (Trouble.SILENCE, "no answer"),
        (Trouble.PARITY, "wrong parity"),
        ("no-data", "battery empty"),
        ("wrong-channel", "wrong channel"),
        ("busy", "busy"),
    ],
)
def test_faults_by_name(fault: str, said: str) -> None:
    lines = examined(QUICK, fault).splitlines()
    assert any(line.startswith("False ") and said in line for line in lines)


def test_over_range_and_wrong_profile() -> None:
    quick = replace(SYLVAC, timeout_s=0.3, interval_s=0.0)
    assert "over range" in examined(quick, "over-range")
    with TwinPort(twin_of(MITUTOYO_01A, Spindle(lambda: 0.5, 0.001)), "tcp"):
        pass
    device = twin_of(MITUTOYO_01A, Spindle(lambda: 0.5, 0.001))

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
    with TwinPort(twin_of(QUICK, Spindle(lambda: 0.5, 0.001)), "tcp") as port:
        assert "+12.7 mm" in told(QUICK, port.url, Asked(unit=Unit.INCH))


def test_missing_and_busy_ports() -> None:
    assert "no such port" in told(QUICK, "/dev/ttyNONE9")
    assert "nobody listens" in told(QUICK, "socket://127.0.0.1:1")


def test_unverified_profiles_say_so() -> None:
    assert MITUTOYO_MUX.verified is Verified.UNVERIFIED
    assert "unverified" in told(replace(MITUTOYO_MUX, timeout_s=0.2), "socket://127.0.0.1:1")


def test_far_out() -> None:
    assert "further out" in examined(QUICK, position_mm=250.0)


def test_usb_tool_that_is_a_keyboard(tmp_path: Path) -> None:
    device = tmp_path / "1-2"
    device.mkdir()
    (device / "idVendor").write_text("0fe7\n")
    (device / "idProduct").write_text("4001\n")
    (found,) = keyboard_tools(tmp_path)
    assert isinstance(found, Finding)
    assert not found.well
    assert "VCP driver" in found.next_step


def test_no_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(port: str, **_: object) -> None:
        raise PermissionError(13, "Permission denied", port)

    monkeypatch.setattr("serial.serial_for_url", refuse)
    assert "no permission" in told(QUICK, "/dev/ttyUSB0")
    assert "dialout" in told(QUICK, "/dev/ttyUSB0")


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals need POSIX")
def test_port_in_use() -> None:
    from drivers.port import open_port

    with TwinPort(twin_of(QUICK, Spindle(lambda: 0.5, 0.001)), "pty") as port:
        holder = open_port(QUICK, port.url)
        assert "in use by another program" in told(QUICK, port.url)
        holder.close()
