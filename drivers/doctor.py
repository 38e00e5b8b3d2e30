"""What can be wrong with an indicator on a port: every fault found, each with the next step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from calib.errors import IndicatorError
from drivers.exchange import Exchange
from drivers.port import carries_settings
from drivers.profile import (
    Evidence,
    Fault,
    FaultKind,
    IndicatorReading,
    Outcome,
    Profile,
    Query,
    Unit,
    not_understood,
)

USB_DEVICES = Path("/sys/bus/usb/devices")
KEYBOARD_TOOLS = {("0fe7", "4001"): "Mitutoyo USB input tool"}
ATTEMPTS = 3
LONGEST_MM = 100.0
LISTEN_S = 3.0
"""An Arduino starts anew when its port is opened, which takes it 2 s."""

NEXT_STEPS = {
    FaultKind.NO_ANSWER: "Switch the indicator on, check cable, battery and profile.",
    FaultKind.PARTIAL_LINE: "Check speed and line settings against the indicator's menu.",
    FaultKind.NOT_UNDERSTOOD: "Choose the profile that fits; glidecal ports lists them.",
    FaultKind.DEVICE_FAULT: "Do what the fault says, then ask again.",
    FaultKind.OVER_RANGE: "Bring the spindle into its range and set zero there.",
    FaultKind.LOW_BATTERY: "Change the battery, then ask again.",
    FaultKind.BUSY: "Wait, or close the menu of the device.",
    FaultKind.WRONG_CHANNEL: "Give the channel the indicator is plugged into.",
    FaultKind.WRONG_UNIT: "Set the display to the unit expected, or state its unit.",
    FaultKind.WRONG_PARITY: "Choose a profile with 7 data bits and even parity, as sylvac.",
    FaultKind.TOO_SLOW: "Find the cause of the delay: radio link, hub, another program.",
    FaultKind.SENDS_UNASKED: "Switch its continuous output off: it must send on request only.",
    FaultKind.DISCONNECTED: "Plug the cable in again.",
}


@dataclass(frozen=True)
class PortFinding:
    """One thing looked at: whether it is well, what was seen, what to do."""

    well: bool
    description: str
    next_step: str = ""


def examine(
    profile: Profile, port: str, query: Query, alternatives: Iterable[Profile] = ()
) -> list[PortFinding]:
    """Everything that can be found out; ``alternatives`` are profiles that might fit better.

    Opens only the named port.
    """
    findings = [_trust(profile), *keyboard_tools()]
    exchange = Exchange(profile, port, query, profile.interval_s)
    try:
        exchange.open()
    except IndicatorError as problem:
        return [*findings, refused(port, problem)]
    findings.append(PortFinding(True, f"port {port} opens"))
    try:
        outcomes = [exchange.checked_outcome() for _ in range(ATTEMPTS)]
    finally:
        exchange.hang_up()
    return findings + list(_of_outcomes(profile, query, outcomes, alternatives))


Fit = tuple[Profile, Outcome]
"""A profile that was asked in its own way and answered, twice alike: a reading, or a value in
another unit or of another channel than asked for."""


@dataclass(frozen=True)
class Trials:
    """What came of trying profiles: those that fit, and what was heard instead of a value."""

    fits: tuple[Fit, ...]
    faults: tuple[tuple[Profile, Fault], ...]
    count: int


Group = tuple[Profile, ...]
"""Profiles that are asked alike, over the same settings of the line."""

VALUE_KINDS = (FaultKind.WRONG_UNIT, FaultKind.WRONG_CHANNEL)
"""Faults whose line is a whole value of the profile all the same."""

A_VALUE = 1
"""The rank of these; lower is a reading, higher no value."""


def try_profiles(
    profiles: Iterable[Profile],
    port: str,
    query: Query,
    *,
    progress: Callable[[int, int, Group], object] = lambda *_: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Trials:
    """Ask one port as each profile does. Raises IndicatorError where it cannot be opened.

    This writes to the port. After a value only profiles that could have sent it are tried, so that
    all that cannot be told apart are found and a device that was found hears little more.
    """
    waiting = _groups(profiles, port, query)
    count, number = len(waiting), 0
    fits: list[Fit] = []
    faults: list[tuple[Profile, Fault]] = []
    while waiting and not stopped():
        group, number = waiting.pop(0), number + 1
        progress(number, count, group)
        outcome = _trial(group, port, query, stopped)
        group_fits = _fitting(group, outcome.text, query)
        if group_fits and _rank(outcome) <= A_VALUE:
            fits += group_fits
            candidates = (
                [profile for profile, _ in _fitting(group, outcome.text, query)]
                for group in waiting
            )
            waiting = [tuple(fitting) for fitting in candidates if fitting]
            count = number + len(waiting)
        elif isinstance(outcome, Fault) and outcome.kind is not FaultKind.NO_ANSWER:
            faults.append((group[0], outcome))
    return Trials(tuple(fits), tuple(faults), number)


def _groups(profiles: Iterable[Profile], port: str, query: Query) -> list[Group]:
    """Profiles in the order of trying: first who only listens, then who asks for most, quickly.

    A request without a line end comes last: what stays of it in a device spoils the next one.
    """
    groups: dict[tuple[object, ...], list[Profile]] = {}
    for profile in profiles:
        request = profile.request(query) if profile.request else None
        settings = profile.line if carries_settings(port) else None
        groups.setdefault((request, settings), []).append(profile)

    def order(group: Group) -> tuple[float, ...]:
        request = group[0].request(query) if group[0].request else b"\r"
        ended = request.endswith((b"\r", b"\n"))
        return (group[0].request is not None, not ended, -len(group), group[0].timeout_s)

    return sorted(map(tuple, groups.values()), key=order)


def _trial(group: Group, port: str, query: Query, stopped: Callable[[], bool]) -> Outcome:
    """What a group's question brings, asked again where it was no value.

    The first question may end what others left in the device, and be lost with it. A value must
    come twice alike: noise that looks like one does not.
    """
    listens = group[0].request is None
    patience_s = max(profile.timeout_s for profile in group)
    if listens and carries_settings(port):
        patience_s = LISTEN_S

    def parse(text: str, query: Query) -> Outcome | None:
        return min((profile.parse(text, query) for profile in group), key=_rank)

    combined = replace(group[0], timeout_s=patience_s, parse=parse)
    earlier = FaultKind.NO_ANSWER if listens else None
    for _ in range(ATTEMPTS):
        exchange = Exchange(combined, port, query, combined.interval_s, stopped=stopped)
        exchange.open()
        try:
            outcome = exchange.checked_outcome()
        finally:
            exchange.hang_up()
        if isinstance(outcome, IndicatorReading) or outcome.kind is earlier:
            return outcome
        earlier = outcome.kind
    return not_understood(outcome.text)  # never the same twice


def _rank(outcome: Outcome | None) -> int:
    """How much a line says: the reading that one profile finds in it wins over all others."""
    if isinstance(outcome, IndicatorReading):
        return 0
    if outcome is None:  # an echo or an identification
        return 2
    ranks = {FaultKind.NOT_UNDERSTOOD: 4, **dict.fromkeys(VALUE_KINDS, A_VALUE)}
    return ranks.get(outcome.kind, 3)


def _fitting(group: Sequence[Profile], text: str, query: Query) -> list[Fit]:
    """The profiles of a group that read a value in a line."""
    outcomes = ((profile, profile.parse(text, query)) for profile in group)
    return [
        (profile, outcome) for profile, outcome in outcomes if outcome and _rank(outcome) <= A_VALUE
    ]


def refused(port: str, problem: IndicatorError) -> PortFinding:
    """A port that does not open."""
    fault = f"port {port}: {problem.found or problem.reason}"
    return PortFinding(False, fault, problem.next_step or str(problem.allowed))


def examine_by_trial(
    port: str,
    query: Query,
    profiles: Iterable[Profile],
    progress: Callable[[int, int, Group], object],
) -> list[PortFinding]:
    """Which profiles fit the indicator on a port, found by `try_profiles`."""
    try:
        trials = try_profiles(profiles, port, query, progress=progress)
    except IndicatorError as problem:
        return [*keyboard_tools(), refused(port, problem)]
    return [*keyboard_tools(), PortFinding(True, f"port {port} opens"), *findings_of(trials)]


def findings_of(trials: Trials) -> list[PortFinding]:
    """The profiles that fit, or why none does."""
    findings = [] if trials.fits else list(_of_silence(trials.faults))
    readings = [value for _, value in trials.fits if isinstance(value, IndicatorReading)]
    if readings:
        findings += _of_reading(readings[0])
    for profile, outcome in trials.fits:
        fits = f"{profile.name} fits: {profile.title} ({profile.verified})"
        if isinstance(outcome, Fault):
            next_step = NEXT_STEPS[outcome.kind]
            findings.append(PortFinding(False, f"{fits}, but {outcome.words}", next_step))
        else:
            findings.append(PortFinding(True, fits))
    if len(trials.fits) > 1:
        advice = "these profiles give the same answers: choose the name of your indicator"
        findings.append(PortFinding(True, advice))
    return findings


def _of_silence(faults: Sequence[tuple[Profile, Fault]]) -> Iterable[PortFinding]:
    for profile, fault in faults:
        answer = f"asked as {profile.name}: {fault.kind}, {fault.text!r:.60}"
        yield PortFinding(False, answer, fault.words)
    evidence = "none of its answers is a value" if faults else "nothing came"
    next_step = "Check power, cable and plug. What is set at the device itself (speed, pattern)"
    yield PortFinding(False, f"no profile fits: {evidence}", f"{next_step} needs --profile.")


def _trust(profile: Profile) -> PortFinding:
    if profile.verified is Evidence.UNVERIFIED:
        return PortFinding(
            False,
            f"profile {profile.name} is unverified ({profile.source})",
            "Compare a few readings with the display before you trust it.",
        )
    return PortFinding(True, f"profile {profile.name}: {profile.verified}")


def keyboard_tools(devices: Path = USB_DEVICES) -> list[PortFinding]:
    """USB tools that type like a keyboard and therefore have no port (Linux only)."""
    findings = []
    for vendor_file in sorted(devices.glob("*/idVendor")):
        product_file = vendor_file.with_name("idProduct")
        try:
            identity = (vendor_file.read_text().strip(), product_file.read_text().strip())
        except OSError:
            continue
        if identity in KEYBOARD_TOOLS:
            device = f"{KEYBOARD_TOOLS[identity]} found as a keyboard, without a serial port"
            findings.append(PortFinding(False, device, "Install its VCP driver to get a port."))
    return findings


def _of_outcomes(
    profile: Profile, query: Query, outcomes: list[Outcome], alternatives: Iterable[Profile]
) -> Iterable[PortFinding]:
    faults = {outcome.kind: outcome for outcome in outcomes if isinstance(outcome, Fault)}
    for kind, fault in faults.items():
        quotation = f": {fault.text!r}" if fault.text else ""
        yield PortFinding(
            False, f"{kind}: {fault.words}{quotation}", f"{NEXT_STEPS[kind]} {profile.hint}"
        )
        if kind is FaultKind.NOT_UNDERSTOOD:
            fitting = [
                p.name
                for p in alternatives
                if isinstance(p.parse(fault.text, query), IndicatorReading)
            ]
            if fitting:
                yield PortFinding(
                    False, f"the answer fits {', '.join(fitting)}", "Try that profile."
                )
    readings = [outcome for outcome in outcomes if isinstance(outcome, IndicatorReading)]
    if readings:
        yield from _of_reading(readings[-1])


def _of_reading(reading: IndicatorReading) -> Iterable[PortFinding]:
    value = f"{reading.value_mm:+.6g} mm, step {reading.resolution_mm:.2g} mm ({reading.text!r})"
    yield PortFinding(True, f"answers {value}")
    if reading.unit_assumed:
        looks_inch = reading.unit is Unit.MM and reading.resolution_mm < 0.00005
        yield PortFinding(
            not looks_inch,
            f"the answer names no unit; {reading.unit} is assumed",
            "So many decimals look like inch: look at the display." if looks_inch else "",
        )
    if abs(reading.value_mm) > LONGEST_MM:
        yield PortFinding(False, "beyond the travel of any indicator", "Set zero, check the unit.")
    if reading.warning:
        yield PortFinding(False, reading.warning, "Change the battery before you measure.")
