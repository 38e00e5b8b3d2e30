"""The one door to pyserial: serial ports are opened, closed and listed here, with plain words."""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import serial
from serial.tools.list_ports_common import ListPortInfo as ListPortInfo

from calib.errors import IndicatorError
from drivers.profile import LineSettings, Profile

SerialPort: TypeAlias = serial.Serial
"""What the other rooms of drivers call a port that is open."""

PORT_ERRORS: tuple[type[Exception], ...] = (
    serial.SerialException,
    OSError,
    ValueError,  # pyserial for an impossible URL or setting
)
if sys.platform != "win32":
    import termios

    PORT_ERRORS = (*PORT_ERRORS, termios.error)

SLICE_S = 0.05
"""How long a read waits before its caller looks up whether it is to stop."""

OVER_A_NETWORK = ("socket", "rfc2217")
"""The URLs of pyserial that lead to a device; its others write files, log, or search."""

NO_WORDS = "n/a"
"""What pyserial has for a port of which the system says nothing."""

WRITE_S = 0.5
"""A request is a few bytes: a port that does not take them is blocked."""

PSEUDO_TERMINALS = ("/dev/pts/", "/dev/ttys00")


def open_port(profile: Profile, port: str) -> SerialPort:
    """The open port with the profile's settings. Raises IndicatorError in plain words."""
    check_port(port)
    settings = profile.line
    if not carries_settings(port) and "://" not in port:
        # a pseudo-terminal keeps 8N1 and refuses anything else when a setting changes later
        settings = replace(settings, data_bits=8, parity="N", stop_bits=1)
    try:
        return open_serial(port, settings)
    except PORT_ERRORS as problem:
        raise cannot_open(port, problem) from problem


def open_serial(
    port: str, settings: LineSettings, read_s: float = SLICE_S, write_s: float = WRITE_S
) -> SerialPort:
    """The open port; nobody else may open it. Raises one of `PORT_ERRORS`."""
    opened = serial.serial_for_url(
        port,
        baudrate=settings.baud,
        bytesize=settings.data_bits,
        parity=settings.parity,
        stopbits=settings.stop_bits,
        timeout=read_s,
        write_timeout=write_s,
        do_not_open=True,  # else DTR and RTS rise first, and devices start anew or lose power
        **({} if "://" in port else {"exclusive": True}),
    )
    with contextlib.suppress(OSError):  # virtual ports have no control lines
        opened.dtr, opened.rts = settings.dtr, settings.rts
    opened.open()
    return opened


def ports_here() -> list[ListPortInfo]:
    """The serial ports of this computer by name; nothing is opened. What is not known is None."""
    from serial.tools import list_ports

    ports: list[ListPortInfo] = sorted(list_ports.comports())
    for port in ports:
        for name in ("description", "hwid"):
            if getattr(port, name) == NO_WORDS:
                setattr(port, name, None)
    return ports


def check_port(port: str) -> None:
    """Raises IndicatorError for a URL that is no way to a device, such as ``spy://``."""
    scheme, url, _ = port.partition("://")
    if url and scheme.lower() not in OVER_A_NETWORK:
        forms = " or ".join(f"{scheme_name}://HOST:PORT" for scheme_name in OVER_A_NETWORK)
        raise IndicatorError(f"port {port!r}", f"{scheme[:20]!r}", f"a serial port, {forms}")


def carries_settings(port: str) -> bool:
    """Whether speed and parity mean anything there."""
    return not port.startswith((*PSEUDO_TERMINALS, "socket:"))


def ask_by_pulse(port: SerialPort, line: LineSettings, wait: Callable[[float], object]) -> None:
    """Drop DTR for a while where the device is asked like that; virtual ports have no DTR."""
    if line.dtr_pulse_s:
        with contextlib.suppress(OSError):
            port.dtr = not line.dtr
            wait(line.dtr_pulse_s)
            port.dtr = line.dtr


def close_port(port: SerialPort) -> None:
    """Close the port whatever state it is in."""
    # pyserial leaves the socket of a vanished peer open: its shutdown fails before close
    port_socket: socket.socket | None = getattr(port, "_socket", None)
    with contextlib.suppress(*PORT_ERRORS):
        port.close()
    if port_socket is not None:
        port_socket.close()


def cannot_open(port: str, problem: Exception) -> IndicatorError:
    """Why a port cannot be opened, and what to do."""
    message = str(problem)
    look = "Plug the device in; glidecal ports lists what is there"
    # Windows says PermissionError for a port that another program holds, so that comes first
    reasons = {
        "No such file": ("no such port", look),
        "FileNotFoundError": ("no such port", look),
        "PermissionError": ("no permission or in use", "Close other programs that use the port"),
        "Permission": (
            "no permission",
            "Join the group that owns the port (dialout), log in again",
        ),
        "exclusively lock": ("in use by another program", "Close the other program"),
        "busy": ("in use by another program", "Close the other program"),
        "Inappropriate ioctl": ("no serial port", "glidecal ports lists what is there"),
        "Is a directory": ("no serial port", "glidecal ports lists what is there"),
        "refused": ("no device answers at this address", "Start the device or the simulator first"),
    }
    matches = (advice for sign, advice in reasons.items() if sign in message)
    reason, next_step = next(matches, (message, "glidecal ports lists what is there"))
    return IndicatorError(f"port {port}", next_step=next_step, reason=reason)
