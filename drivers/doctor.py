"""What can be wrong with an indicator on a port: every fault found, each with the next step."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from calib.errors import IndicatorError
from drivers.line import IndicatorLine
from drivers.profile import Asked, Fault, FaultKind, Outcome, Profile, Reading, Unit, Verified

USB_DEVICES = Path("/sys/bus/usb/devices")
KEYBOARD_TOOLS = {("0fe7", "4001"): "Mitutoyo USB input tool"}
ATTEMPTS = 3
LONGEST_MM = 100.0

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
    FaultKind.TOO_SLOW: "Find what makes it slow: radio link, hub, another program that asks it.",
    FaultKind.SENDS_UNASKED: "Switch its continuous output off: it must send on request only.",
    FaultKind.DISCONNECTED: "Plug the cable in again.",
}


@dataclass(frozen=True)
class Finding:
    """One thing looked at: whether it is well, what was seen, what to do."""

    well: bool
    what: str
    next_step: str = ""


def examine(
    profile: Profile, port: str, asked: Asked, others: Iterable[Profile] = ()
) -> list[Finding]:
    """Everything that can be found out; ``others`` are profiles that might fit better.

    Opens only the named port.
    """
    findings = [_trust(profile), *keyboard_tools()]
    line = IndicatorLine(profile, port, asked=asked)
    try:
        line.start()
    except IndicatorError as problem:
        found = f"port {port}: {problem.found or problem.reason}"
        return [*findings, Finding(False, found, problem.next_step or str(problem.allowed))]
    findings.append(Finding(True, f"port {port} opens"))
    try:
        outcomes = [line.ask().result() for _ in range(ATTEMPTS)]
    finally:
        line.close()
    return findings + list(_of_outcomes(profile, asked, outcomes, others))


def _trust(profile: Profile) -> Finding:
    if profile.verified is Verified.UNVERIFIED:
        return Finding(
            False,
            f"profile {profile.name} is unverified ({profile.source})",
            "Compare a few readings with the display before you trust it.",
        )
    return Finding(True, f"profile {profile.name}: {profile.verified}")


def keyboard_tools(devices: Path = USB_DEVICES) -> list[Finding]:
    """USB tools that type like a keyboard and therefore have no port (Linux only)."""
    findings = []
    for vendor_file in sorted(devices.glob("*/idVendor")):
        product_file = vendor_file.with_name("idProduct")
        try:
            identity = (vendor_file.read_text().strip(), product_file.read_text().strip())
        except OSError:
            continue
        if identity in KEYBOARD_TOOLS:
            found = f"{KEYBOARD_TOOLS[identity]} found as a keyboard, without a serial port"
            findings.append(Finding(False, found, "Install its VCP driver to get a port."))
    return findings


def _of_outcomes(
    profile: Profile, asked: Asked, outcomes: list[Outcome], others: Iterable[Profile]
) -> Iterable[Finding]:
    faults = {outcome.kind: outcome for outcome in outcomes if isinstance(outcome, Fault)}
    for kind, fault in faults.items():
        seen = f": {fault.text!r}" if fault.text else ""
        yield Finding(False, f"{kind}: {fault.words}{seen}", f"{NEXT_STEPS[kind]} {profile.hint}")
        if kind is FaultKind.NOT_UNDERSTOOD:
            fitting = [p.name for p in others if isinstance(p.parse(fault.text, asked), Reading)]
            if fitting:
                yield Finding(False, f"the answer fits {', '.join(fitting)}", "Try that profile.")
    readings = [outcome for outcome in outcomes if isinstance(outcome, Reading)]
    if readings:
        yield from _of_reading(readings[-1])


def _of_reading(reading: Reading) -> Iterable[Finding]:
    shown = f"{reading.value_mm:+.6g} mm, step {reading.resolution_mm:.2g} mm ({reading.text!r})"
    yield Finding(True, f"answers {shown}")
    if reading.unit_assumed:
        looks_inch = reading.unit is Unit.MM and reading.resolution_mm < 0.00005
        yield Finding(
            not looks_inch,
            f"the answer names no unit; {reading.unit} is assumed",
            "So many decimals look like inch: look at the display." if looks_inch else "",
        )
    if abs(reading.value_mm) > LONGEST_MM:
        yield Finding(False, "further out than an indicator can be", "Set zero, check the unit.")
    if reading.warning:
        yield Finding(False, reading.warning, "Change the battery before you measure.")
