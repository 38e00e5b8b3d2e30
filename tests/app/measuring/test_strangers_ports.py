"""Ports that a file names: what is plugged in here, and nothing else; the rest a person types."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input

from app.measuring.gauges import Gauge
from app.measuring.indicators import (
    check_indicators,
    from_file,
    parse_indicator,
    profile_of,
    this_computer,
)
from app.measuring.opening import opened_event
from app.measuring.plan import PortsUnknown, plan_to_continue
from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, TextDialog
from calib.errors import IndicatorError, UsageError
from drivers.port import open_port
from drivers.profile import Query
from drivers.profiles import profile_named
from protocols.journal import Journal
from protocols.machine import Instrument
from tests.app.cli import refused
from tests.screens.driving import SIZE, quick_plan, said, text, until

HOSTILE = (
    "spy:///dev/ttyUSB0?file=victim",
    "SPY://loop://?file=victim",
    "alt:///dev/ttyUSB0?class=PosixPollSerial",
    "hwgrep://0403",
    "loop://",
    "rfc2217://192.0.2.1:4000",
    "socket://192.0.2.1:4000",
    "socket://127.0.0.1:80@192.0.2.1:4000",
    "socket://127.0.0.1.example:4000",
    "socket://127.0.0.1:4000?logging=debug",
    "/dev/../etc/passwd",
    "/etc/passwd",
    r"\\192.0.2.1\share\COM5",
    "/dev/ttyUSB0\n",
    "",
)
KNOWN = (
    "/dev/ttyUSB0",
    "/dev/serial/by-id/usb-FTDI_FT232R-if00-port0",
    "/dev/cu.usbserial-1410",
    "/dev/pts/3",
    "/dev/indicator_y",
    "COM5",
    r"\\.\COM12",
    "socket://127.0.0.1:4000",
    "socket://localhost:4000",
    "socket://[::1]:4000",
    "simulated",
)


def machine_file(folder: Path, port: str, **keys: str) -> Path:
    lines = ["[[indicator]]", "profile = 'ascii-line'", f"port = {port!r}"]
    path = folder / "machine.toml"
    path.write_text("\n".join([*lines, *(f"{key} = {text}" for key, text in keys.items())]))
    return path


@pytest.mark.parametrize("port", HOSTILE)
def test_a_file_names_no_such_port(port: str) -> None:
    with pytest.raises(UsageError, match="--indicator"):
        from_file([Instrument(profile="sylvac", port=port)], "the machine file")


@pytest.mark.parametrize("port", KNOWN)
def test_a_file_names_what_is_plugged_in(port: str) -> None:
    instrument = Instrument(profile="sylvac", port=port)
    assert from_file([instrument], "the machine file") == (instrument,)


@pytest.mark.parametrize("port", HOSTILE[:5])
def test_nobody_opens_what_is_no_device(port: str, tmp_path: Path) -> None:
    """Also where a person types it: pyserial's other URLs write files, log, search, or echo."""
    with pytest.raises(IndicatorError, match="rfc2217"):
        open_port(profile_named("sylvac"), port)
    with pytest.raises(UsageError, match=port.partition(":")[0]):
        check_indicators([parse_indicator(f"sylvac:{port}")])


def test_a_typed_port_that_is_no_device_is_told(tmp_path: Path) -> None:
    port = f"spy:///dev/null?file={tmp_path / 'victim'}"
    assert "spy" in refused(2, "run", "--dry-run", "--indicator", f"sylvac:{port}", cwd=tmp_path)
    message = refused(4, "indicator", "read", port, "--profile", "sylvac", cwd=tmp_path)
    assert "socket://HOST:PORT" in message
    assert list(tmp_path.iterdir()) == []


def test_the_attack_of_the_machine_file(tmp_path: Path) -> None:
    """A port that is emptied and written by pyserial's spy, a request that a shell would run."""
    victim = tmp_path / "victim.sh"
    victim.write_text("as it was\n")
    machine = machine_file(
        tmp_path,
        f"spy:///dev/null?file={victim}",
        pattern=r"'(?P<number>\d+\.\d+)'",
        request=r'";touch ran;#"',
    )
    message = refused(2, "run", "--machine", machine, cwd=tmp_path)
    assert "port in the machine file" in message
    assert victim.read_text() == "as it was\n"
    assert set(tmp_path.iterdir()) == {victim, machine}


def test_a_machine_file_sends_no_byte_to_another_computer(tmp_path: Path) -> None:
    """Not before measuring, not at all: nobody even connects."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        number = listening.getsockname()[1]
        listening.settimeout(0.2)
        machine = machine_file(tmp_path, f"socket://0.0.0.0:{number}")
        assert "--indicator" in refused(2, "run", "--machine", machine, cwd=tmp_path)
        with pytest.raises(TimeoutError):
            listening.accept()


@pytest.mark.parametrize(
    ("request_text", "port", "right"),
    [
        ("", "/dev/ttyUSB0", True),
        ("r", "/dev/ttyUSB0", True),
        ("READ?\r\n", "COM5", True),
        ("READ?\r", "COM5", True),
        ("a\nb", "COM5", False),
        ("\n", "COM5", False),
        ("a\n\n", "COM5", False),
        ("\x1b[2J", "COM5", False),
        ("é", "COM5", False),
        ("r" * 33, "COM5", False),
        ("FLUSHALL\r\n", "socket://127.0.0.1:6379", False),
    ],
)
def test_a_request_of_ones_own_is_one_short_line_to_a_serial_port(
    request_text: str, port: str, right: bool
) -> None:
    pattern = r"(?P<number>\d+\.\d+)"
    instrument = Instrument(profile="ascii-line", port=port, pattern=pattern, request=request_text)
    if right:
        check_indicators([instrument])
    else:
        with pytest.raises(UsageError, match="request"):
            check_indicators([instrument])


def test_a_request_of_ones_own_goes_to_no_socket_that_is_typed_later() -> None:
    pattern, request = r"(?P<number>\d+\.\d+)", "FLUSHALL\r\n"
    instrument = Instrument(profile="ascii-line", port="COM5", pattern=pattern, request=request)
    gauge = Gauge(profile_of(instrument), "COM5", Query(), window_s=1.0, tolerance_mm=0.004)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.2)
        with pytest.raises(UsageError, match="Allowed: a serial port"):
            gauge.go_on_at(f"socket://127.0.0.1:{listening.getsockname()[1]}")
        with pytest.raises(TimeoutError):
            listening.accept()
    assert gauge.port == "COM5"


def begun(folder: Path, ports: Sequence[str], computer: str | None) -> Path:
    """An interrupted record with these ports, as another computer left it."""
    instruments = tuple(Instrument(profile="sylvac", port=p, axes="xyz") for p in ports)
    plan = replace(quick_plan(folder), instruments=instruments)
    opened = opened_event(plan).model_copy(update={"computer": computer})
    Journal.create(plan.path, opened).close()
    return plan.path


def test_ports_of_another_computer_are_asked_for_again(tmp_path: Path) -> None:
    ports = ("/dev/ttyUSB0", "/dev/ttyUSB1")
    path = begun(tmp_path, ports, "0123456789abcdef")
    with pytest.raises(PortsUnknown, match="named again: --indicator PROFILE:PORT@xyz --indicator"):
        plan_to_continue(path)
    before = path.read_bytes()
    assert "not named on this computer" in refused(2, "run", "--continue", path, cwd=tmp_path)
    assert path.read_bytes() == before
    anew = tuple(Instrument(profile="sylvac", port=port) for port in ("COM5", "COM6"))
    assert plan_to_continue(path, anew).instruments == anew


def test_a_record_that_tells_no_computer_is_asked_for_ports(tmp_path: Path) -> None:
    with pytest.raises(PortsUnknown):
        plan_to_continue(begun(tmp_path, ["COM5", "COM6"], None))


def test_ports_of_this_computer_are_known(tmp_path: Path) -> None:
    path = begun(tmp_path, ["COM5", "COM6"], this_computer())
    assert [i.port for i in plan_to_continue(path).instruments] == ["COM5", "COM6"]


def test_a_record_of_this_computer_names_no_such_port_either(tmp_path: Path) -> None:
    path = begun(tmp_path, ["COM5", "spy:///dev/null?file=victim"], this_computer())
    assert "spy://" in refused(2, "run", "--continue", path, cwd=tmp_path)
    assert not (tmp_path / "victim").exists()


def test_simulated_sessions_go_on_anywhere_and_tell_no_computer(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    assert opened_event(plan).computer is None
    Journal.create(plan.path, opened_event(plan)).close()
    assert plan_to_continue(plan.path).simulated


def test_the_digest_of_a_computer_does_not_name_it() -> None:
    import platform

    assert this_computer() == this_computer()
    assert len(this_computer()) == 16
    assert platform.node() not in this_computer()


async def to_continue(pilot: Pilot[str], interface: Glidecal) -> None:
    """The session without a reading stands with the others: it is continued by its choices."""
    await pilot.press("enter")
    await until(pilot, "choices", lambda: isinstance(interface.screen, ChoiceDialog))
    await pilot.press("1")
    await until(pilot, "the question", lambda: isinstance(interface.screen, TextDialog))


async def test_the_screen_asks_for_the_ports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = begun(tmp_path, ["/dev/ttyUSB0", "/dev/ttyUSB1"], None)
    monkeypatch.chdir(tmp_path)
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await pilot.pause()
        await pilot.press("end")
        await to_continue(pilot, interface)
        assert "another computer" in text(interface, "Static")
        nobody = "socket://127.0.0.1:1"
        interface.screen.query_one(Input).value = f"sylvac:{nobody}@x sylvac:{nobody}@y"
        await pilot.press("enter")
        await until(pilot, "a refusal", lambda: "other axes" in said(interface))
        await to_continue(pilot, interface)
        interface.screen.query_one(Input).value = f"sylvac:{nobody} sylvac:socket://127.0.0.1:2"
        await pilot.press("enter")
        await until(pilot, "the check", lambda: isinstance(interface.screen, CheckScreen))
        await until(pilot, "no port", lambda: "no device answers" in text(interface, "#words"))
    assert len(path.read_bytes().splitlines()) == 1
