"""Indicators as a person names them: ``PROFILE:PORT@AXES``, or entries of the machine file."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence

from calib.errors import GlidecalError
from drivers.outcome import Asked, Unit
from drivers.profile import Profile
from drivers.profiles import profile_named
from drivers.profiles.ascii_line import ascii_line
from protocols.errors import UsageError
from protocols.machine import Instrument, Machine
from protocols.procedure import ALL_AXES, axes_on_leg

SIMULATED = "simulated"
DEFAULT_PROFILE = "mitutoyo-01a"
SPEC = re.compile(r"(?P<profile>[\w-]+):(?P<port>.+?)(?:@(?P<axes>[^@/\\]*))?")
FORM = "PROFILE:PORT or PROFILE:PORT@AXES, as in mitutoyo-01a:/dev/ttyUSB0@yx"


def parse_indicator(text: str) -> Instrument:
    """An indicator from the command line. Raises UsageError."""
    found = SPEC.fullmatch(text)
    axes = found["axes"] if found else None
    if not found or (axes is not None and not re.fullmatch("[xyz]{1,3}", axes)):
        raise UsageError("--indicator", repr(text), FORM)
    return Instrument(profile=found["profile"], port=found["port"], axes=axes or "xyz")


def check_indicators(instruments: Sequence[Instrument]) -> None:
    """Everything that is wrong with the choice, in one message, before any port is opened.

    Raises UsageError.
    """
    faults: list[str] = []
    for instrument in instruments:
        try:
            profile_of(instrument)
        except GlidecalError as problem:
            faults.append(f"{problem.thing} {problem.found}")
    ports = [i.port for i in instruments if i.port != SIMULATED]
    faults += [f"port {port} twice" for port in dict.fromkeys(ports) if ports.count(port) > 1]
    if not 1 <= len(instruments) <= 2:
        faults.append(f"{len(instruments)} indicators")
    else:
        faults += _misfits(instruments)
    if faults:
        raise UsageError(
            "indicators",
            "; ".join(faults),
            "one or two different ports, known profiles, and axes that fit every leg",
        )


def choose_indicators(
    named: Sequence[str],
    ports: Sequence[str],
    profile: str,
    *,
    machine: Machine,
    simulated: bool,
) -> tuple[Instrument, ...]:
    """Indicators of the command line, else those of the machine file; checked, nothing opened.

    Empty where neither names any. Raises UsageError.
    """
    chosen = [parse_indicator(text) for text in named]
    chosen += [Instrument(profile=profile, port=port) for port in ports]
    if simulated and chosen:
        raise UsageError("--simulated and a port", "both", "one of them")
    if simulated:
        return simulated_indicators([profile])
    instruments = tuple(chosen) or machine.indicator
    if instruments:
        check_indicators(instruments)
    return instruments


def some_indicators(profile: str, *, needed: bool) -> tuple[Instrument, ...]:
    """Two indicators for a dry run that names none. Raises UsageError where real ones count."""
    if needed:
        raise UsageError(
            "indicators", "none", "--indicator PROFILE:PORT, [[indicator]] in the machine file"
        )
    return simulated_indicators([profile])


def simulated_indicators(profiles: Sequence[str] = (DEFAULT_PROFILE,)) -> tuple[Instrument, ...]:
    """Two simulated indicators, of one profile or of two."""
    both = (*profiles, *profiles)[:2]
    return tuple(Instrument(profile=name, port=SIMULATED) for name in both)


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

    Raises IndicatorError for an unknown name or a pattern that cannot be used.
    """
    if instrument.pattern is not None:
        request = (instrument.request or "").encode("latin-1", "replace")
        return ascii_line(instrument.pattern, request=request)
    return profile_named(instrument.profile)


def asked_of(instrument: Instrument) -> Asked:
    """Channel and unit to ask for."""
    return Asked(channel=instrument.channel, unit=Unit(instrument.unit))


def asked_for(unit: str, channel: int) -> Asked:
    """What to ask for, from the command line. Raises UsageError for an unknown unit."""
    plain = {"um": Unit.MICROMETRE, "in": Unit.INCH} | {known.value: known for known in Unit}
    if unit not in plain:
        raise UsageError("--unit", repr(unit), ", ".join(known.value for known in Unit))
    return Asked(channel=channel, unit=plain[unit])


def swinging() -> Callable[[], float]:
    """A spindle that swings slowly by half a millimetre."""
    started = time.monotonic()
    return lambda: 0.5 * math.sin((time.monotonic() - started) / 5.0)
