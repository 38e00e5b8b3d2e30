"""Indicators as a person names them: ``PROFILE:PORT@AXES``, or entries of the machine file."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import platform
import re
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from app.settings import data_path
from calib.errors import GlidecalError, RecordError, UsageError
from drivers.port import check_port, ports_here
from drivers.profile import Profile, Query, Unit
from drivers.profiles import profile_named
from drivers.profiles.ascii_line import ASCII_LINE, ascii_line
from protocols.documents import Document, Name, Words, describe, read_remembered
from protocols.files import write_files
from protocols.machine import Instrument, Machine
from protocols.procedure import ALL_AXES, axes_on_leg

SIMULATED = "simulated"
DEFAULT_PROFILE = "mitutoyo-01a"
SPEC = re.compile(r"(?P<profile>[\w-]+):(?P<port>.+?)(?:@(?P<axes>[^@/\\]*))?")

FORM = "PROFILE:PORT or PROFILE:PORT@AXES, as in mitutoyo-01a:/dev/ttyUSB0@yx"

OF_A_FILE = re.compile(
    r"/dev/(?!.*(?:\.\.|\\))[ -~]+"
    r"|(?:\\\\\.\\)?(?:COM|CNC[AB])\d{1,3}"
    r"|socket://(?:127\.\d{1,3}\.\d{1,3}\.\d{1,3}|localhost|\[::1\]):\d{1,5}",
    re.ASCII | re.IGNORECASE,
)
"""Ports that a file may name: what is plugged into this computer, or listens on it."""

OWN_REQUEST = re.compile(r"(?:[ -~]{1,32}(?:\r\n|\r|\n)?)?")
"""One short line, or nothing. It stands in a file, and whoever reads the port would obey more."""


def parse_indicator(text: str) -> Instrument:
    """An indicator from the command line. Raises UsageError."""
    match = SPEC.fullmatch(text)
    axes = match["axes"] if match else None
    if not match or (axes is not None and not re.fullmatch("[xyz]{1,3}", axes)):
        raise UsageError("--indicator", repr(text), FORM)
    return Instrument(profile=match["profile"], port=match["port"], axes=axes or "xyz")


def indicator_words(number: int, instrument: Instrument) -> str:
    """An indicator, counted from 0, by number, profile and port."""
    return f"indicator {number + 1} ({instrument.profile}, {instrument.port})"


FORM_ALLOWED = {
    "profile": "one of the list",
    "channel": "a whole number, 1 … 99",
    "serial_number": "at most 200 letters",
    "certificate": "at most 200 letters",
    "certificate_date": "a date as 2026-01-31, from 1950 to 2100, or nothing",
}


def indicator_of(form: Mapping[str, object]) -> Instrument:
    """The indicator that a form holds; empty texts count as nothing.

    Raises UsageError naming the field, IndicatorError for a port that is none.
    """
    fields = {name: value for name, value in form.items() if value not in ("", None)}
    if not fields.get("port"):
        raise UsageError("port", "none", "a serial port, socket://HOST:PORT or rfc2217://HOST:PORT")
    if not fields.get("profile"):
        raise UsageError(f"profile at {fields['port']}", "none", FORM_ALLOWED["profile"])
    if str(fields.get("channel", "")).isdecimal():
        fields["channel"] = int(str(fields["channel"]))
    try:
        instrument = Instrument.model_validate_json(json.dumps(fields))
    except ValidationError as problem:
        name = str(problem.errors()[0]["loc"][0])
        rule = FORM_ALLOWED.get(name, describe(problem))
        raise UsageError(name.replace("_", " "), repr(fields.get(name))[:60], rule) from problem
    check_port(instrument.port)
    return instrument


def port_is_gone(port: str) -> bool:
    """Whether a serial port of this name is not here now; nothing is opened to find out."""
    if port == SIMULATED or "://" in port:
        return False
    return not Path(port).exists() and port not in dict(serial_ports())


def serial_ports() -> list[tuple[str, str]]:
    """The serial ports of this computer and what the system says of each; nothing is opened."""
    return [(port.device, port.description or "") for port in ports_here()]


def adapters() -> dict[str, str]:
    """For each serial port here the serial number of its adapter, where it has one.

    An adapter with several ports has its number once: the interface behind it tells them apart.
    A number that two adapters have, as cheap ones do, names neither. Nothing is opened.
    """
    numbers: dict[str, str] = {}
    for port in ports_here():
        if port.serial_number:
            interface = (port.location or "").partition(":")[2]
            number = f"{port.serial_number} {interface}".strip()
            numbers[port.device] = "".join(filter(str.isprintable, number))[:100]
    times = Counter(numbers.values())
    return {port: number for port, number in numbers.items() if times[number] == 1}


def adapter_at(port: str) -> str:
    """The serial number of the adapter at a port, empty where there is none to be known."""
    if port == SIMULATED or "://" in port:
        return ""
    return adapters().get(port, "")


def port_of(adapter: str, port: str) -> str | None:
    """Where an adapter is now that was at this port; None where it is there, or not to be found."""
    here = adapters() if adapter else {}
    if here.get(port) == adapter:
        return None
    return next((device for device, number in here.items() if number == adapter), None)


def ports_to_choose(adapter: str, ports_in_use: Collection[str]) -> list[tuple[str, str, bool]]:
    """The serial ports that are not used, with what the system says, those of the adapter first.

    Each with whether it is that of the adapter.
    """
    numbers = adapters()
    free = [
        (port, description, bool(adapter) and numbers.get(port) == adapter)
        for port, description in serial_ports()
        if port not in ports_in_use
    ]
    return sorted(free, key=lambda port: not port[2])


class RememberedIndicators(Document):
    """The indicators that were used last with each machine, by its name, and its serial number.

    ``adapters`` are the serial numbers of the adapters at their ports.
    """

    machines: dict[Name, Annotated[tuple[Instrument, ...], Field(max_length=2)]] = Field(
        default_factory=dict
    )
    serial_numbers: dict[Name, Words] = Field(default_factory=dict)
    places: dict[Name, Words] = Field(default_factory=dict)
    adapters: dict[Name, Name] = Field(default_factory=dict)


def last_used() -> RememberedIndicators:
    """What was used last: a proposal for a person to look at. Raises RecordError."""
    return read_remembered(data_path(), RememberedIndicators, "indicators used last,")


def remember(
    machine: str, instruments: Sequence[Instrument], serial_number: str = "", place: str = ""
) -> None:
    """Keep what is used for the next session. Raises RecordError, UsageError for a link."""
    remembered = last_used()
    ports, here = {instrument.port for instrument in instruments}, adapters()
    present = ports & {port for port, _ in serial_ports()}  # what is there now has no other number
    absent = {port: n for port, n in remembered.adapters.items() if port not in present}
    numbers = {machine: serial_number} if serial_number else {}
    updated = RememberedIndicators(
        machines=remembered.machines | {machine: tuple(instruments)},
        serial_numbers=remembered.serial_numbers | numbers,
        places=remembered.places | ({machine: place} if place else {}),
        adapters=absent | {port: number for port, number in here.items() if port in ports},
    )
    if updated != remembered:
        write_files(data_path(), {"": updated.model_dump_json(indent=1)}, replace=True)


def propose_again(machine: Machine, instruments: Sequence[Instrument]) -> None:
    """Remember them for the next session on this machine; none fails where that cannot be done."""
    with contextlib.suppress(RecordError, UsageError):
        identity = machine.serial_number or "", machine.place or ""
        remember(machine.name, instruments, *identity)


def adapter_before(port: str) -> str:
    """The serial number of the adapter that was used last at a port, empty where unknown."""
    with contextlib.suppress(RecordError):
        return last_used().adapters.get(port, "")
    return ""


def moved_adapters(instruments: Sequence[Instrument]) -> dict[int, str]:
    """The new port of each indicator, counted from 0, whose adapter is at another one.

    It is known by the serial number that it had when it was used last.
    """
    return {
        number: port
        for number, instrument in enumerate(instruments)
        if (port := port_of(adapter_before(instrument.port), instrument.port)) is not None
    }


def check_indicators(instruments: Sequence[Instrument], *, legs: bool = True) -> None:
    """Everything that is wrong with the choice, in one message, before any port is opened.

    Axes must fit ``legs`` where these are read. Raises UsageError.
    """
    faults: list[str] = []
    for instrument in instruments:
        try:
            profile_of(instrument)
            check_port(instrument.port)
        except GlidecalError as problem:
            faults.append(f"{problem.thing} {problem.found}")
        request = instrument.request or ""
        if request and "://" in instrument.port:  # whatever service is there would obey
            faults.append(
                f"request {request!r:.60} to {instrument.port!r}, which is not a serial port"
            )
        elif not OWN_REQUEST.fullmatch(request):
            faults.append(f"request {request!r:.60}, not one line of at most 32 plain characters")
    ports = [i.port for i in instruments if i.port != SIMULATED]
    faults += [f"port {port} twice" for port in dict.fromkeys(ports) if ports.count(port) > 1]
    if not 1 <= len(instruments) <= 2:
        faults.append(f"{len(instruments)} indicators")
    elif legs:
        faults += _misfits(instruments)
    if faults:
        raise UsageError(
            "indicators",
            "; ".join(dict.fromkeys(faults)),
            "one or two different ports, known profiles, and axes that fit every leg",
            "glidecal ports lists the ports and the profiles.",
        )


def check_request(profile: Profile, port: str) -> None:
    """Raises UsageError for a request of one's own to what is no serial port."""
    if profile.name == ASCII_LINE.name and profile.request is not None and "://" in port:
        raise UsageError(f"port of profile {profile.name} with a request", port, "a serial port")


def from_file(instruments: Sequence[Instrument], source: str) -> tuple[Instrument, ...]:
    """The indicators that a file names. Raises UsageError for a port that only a person may name.

    A file may come from a stranger: it must not make this computer talk to another one, nor open
    what is no port.
    """
    for port in (instrument.port for instrument in instruments):
        if port != SIMULATED and not OF_A_FILE.fullmatch(port):
            raise UsageError(
                f"port in {source}",
                f"{port!r:.80}",
                "a serial port as /dev/ttyUSB0 or COM5, or a socket of this computer",
                "If it is meant, name it yourself: --indicator PROFILE:PORT@AXES.",
            )
    return tuple(instruments)


def this_computer() -> str:
    """A digest that tells computers apart; their names cannot be read from it.

    Where there is no machine-id it is the name alone that counts. It is no signature.
    """
    names = [platform.node()]
    with contextlib.suppress(OSError):
        names.append(Path("/etc/machine-id").read_text(encoding="ascii", errors="replace"))
    return hashlib.sha256("\n".join(["glidecal computer", *names]).encode()).hexdigest()[:16]


def choose_indicators(
    texts: Sequence[str], ports: Sequence[str], profile: str, *, machine: Machine, simulated: bool
) -> tuple[Instrument, ...]:
    """Indicators of the command line, else those of the machine file; checked, nothing opened.

    Empty where neither names any. Raises UsageError.
    """
    from_options = [parse_indicator(text) for text in texts]
    from_options += [Instrument(profile=profile, port=port) for port in ports]
    if simulated and from_options:
        raise UsageError("--simulated and a port", "both", "one of them")
    if simulated:
        return simulated_indicators([profile])
    instruments = tuple(from_options) or from_file(machine.indicator, "the machine file")
    if instruments:
        check_indicators(instruments, legs=False)  # that depends on the procedure
    return instruments


def simulated_indicators(profiles: Sequence[str] = (DEFAULT_PROFILE,)) -> tuple[Instrument, ...]:
    """Two simulated indicators, of one profile or of two."""
    profiles_of_both = (*profiles, *profiles)[:2]
    return tuple(Instrument(profile=name, port=SIMULATED) for name in profiles_of_both)


def _misfits(instruments: Sequence[Instrument]) -> list[str]:
    misfits = []
    for leg in ALL_AXES:
        try:
            axes_on_leg(leg, [instrument.axes for instrument in instruments])
        except UsageError as problem:
            misfits.append(f"{problem.found} do not fit leg {leg}")
    return misfits


def profile_of(instrument: Instrument) -> Profile:
    """The profile of an indicator, with its own pattern where it has one.

    Raises UsageError for an unknown name, IndicatorError for a pattern that cannot be used.
    """
    if instrument.pattern is not None:
        request = (instrument.request or "").encode("latin-1", "replace")
        return ascii_line(instrument.pattern, request=request)
    return profile_named(instrument.profile)


def asked_of(instrument: Instrument) -> Query:
    """Channel and unit to ask for."""
    return Query(channel=instrument.channel, unit=Unit(instrument.unit))


def asked_for(unit: str, channel: int) -> Query:
    """What to ask for, from the command line. Raises UsageError for an unknown unit."""
    symbol = {"um": "µm", "in": "inch"}.get(unit, unit)
    if symbol not in list(Unit):
        raise UsageError("--unit", repr(unit), ", ".join(Unit))
    return Query(channel=channel, unit=Unit(symbol))


def swinging() -> Callable[[], float]:
    """A spindle that swings slowly by half a millimetre."""
    started = time.monotonic()
    return lambda: 0.5 * math.sin((time.monotonic() - started) / 5.0)
