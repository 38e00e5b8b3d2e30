"""Late answers, devices that send by themselves, lost bytes and floods, in simulated time.

Small here; with GLIDECAL_FUZZ 10,000 asks a schedule and 1,000 minutes of unasked lines.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, count, product, repeat

import pytest

from drivers.profile import Fault, FaultKind, IndicatorReading, Profile, Query, Spindle
from drivers.profiles import PROFILES
from drivers.profiles.ascii_line import ascii_line
from drivers.twins import IndicatorTwin
from tests.conftest import ROOT
from tests.drivers.simulated_wire import Delay, Stalled, Tally, Wire, always, jittered, stalls

FULL = "GLIDECAL_FUZZ" in os.environ
ASKS = 10_000 if FULL else 250
MINUTES = 1000 if FULL else 30
ASKED = [profile for profile in PROFILES.values() if profile.request]
BUTTONS = [profile for profile in ASKED if profile.button]
SYLVAC = PROFILES["sylvac"]

pytestmark = pytest.mark.timeout(1200)

at_once = always(0.002)


def at_once_out(at: float) -> float:
    return at


def schedules(chance: random.Random, limit_s: float) -> dict[str, Delay]:
    """Latencies of 0.1 to 5 times the time-out."""
    steady = {f"{k} ×": always(k * limit_s) for k in (0.1, 0.9, 1.1, 2.1, 3.3, 4.5, 5.0)}
    low, high = 0.1 * limit_s, 5 * limit_s
    return steady | {
        "jittered": jittered(chance, low, high),
        "around the time-out": jittered(chance, low, 1.3 * limit_s),
        "rarely late": lambda _: chance.uniform(
            low, 0.5 * limit_s if chance.random() < 0.95 else high
        ),
        "growing": lambda at: low + at % 400 / 400 * (high - low),
    }


NAMES = list(schedules(random.Random(1), 1.0))


@pytest.mark.parametrize("name", NAMES)
def test_no_answer_is_older_than_its_question(name: str) -> None:
    for profile in ASKED if FULL else (SYLVAC, PROFILES["mitutoyo-it007r"]):
        delay = schedules(random.Random(name), profile.timeout_s)[name]
        wire, tally = Wire(profile, delay), Tally()
        kinds = tally.count(wire, ASKS)
        assert tally.stale == 0, (profile.name, tally)
        assert not wire.presses
        if name in ("0.1 ×", "0.9 ×"):
            assert tally.readings == ASKS
        elif name.endswith("×") and not profile.line.dtr_pulse_s:
            assert tally.readings == 0
            assert FaultKind.TOO_SLOW in kinds
        elif name == "growing":
            assert tally.readings > 0


@pytest.mark.parametrize("lost", [False, True])
@pytest.mark.parametrize(("of_s", "every_s"), [(2.7, 3.2), (12, 40), (100, 200)])
def test_stalls_of_any_length_end_in_a_burst_that_is_dropped(
    of_s: float, every_s: float, lost: bool
) -> None:
    for profile in ASKED if FULL else (SYLVAC, PROFILES["mitutoyo-it007r"]):
        delay = jittered(random.Random(1), 0.01, 0.4)
        wire, tally = Wire(profile, delay, stalled=stalls(of_s, every_s, lost=lost)), Tally()
        tally.count(wire, ASKS)
        assert tally.stale == 0, (profile.name, tally)
        assert not wire.presses
        assert not FULL or of_s == 2.7 or profile.timeout_s > 2 or tally.readings > 0


@dataclass(frozen=True)
class Sender:
    """A device that sends unasked so many times a second (0: never), stalls, or is slow."""

    hz: float
    delay: Delay
    stalled: Stalled

    def wire(self, profile: Profile, chance: random.Random) -> Wire:
        pauses = (chance.uniform(0.8, 1.2) / self.hz for _ in count()) if self.hz else None
        return Wire(profile, self.delay, pauses, self.stalled)


def senders(chance: random.Random) -> list[Sender]:
    stalls_tried = (at_once_out, stalls(2.7, 3.2), stalls(2.7, 3.2, lost=True))
    delays = (at_once, jittered(chance, 0.1, 0.9), jittered(chance, 0.1, 10.0))
    unasked = [
        Sender(*delays_of_sender)
        for delays_of_sender in product((0, 1, 2, 5, 10, 20), delays, stalls_tried)
    ]
    slow = [Sender(0, always(late_s), at_once_out) for late_s in (0.1, 0.5, 1, 2.1, 4.5, 7, 10)]
    cut = [Sender(0, at_once, stalls(*span)) for span in ((8, 9), (12, 30), (40, 70))]
    return unasked + slow + cut


def test_nothing_is_taken_without_a_key() -> None:
    chance = random.Random(3)
    pairs = list(product(PROFILES.values(), senders(chance)))
    cases = chance.sample(pairs, len(pairs))
    minutes = 0.0
    for profile, sender in cases if FULL else cases[:120]:
        wire = sender.wire(profile, chance)
        while wire.now_s < max(15.0, 60 * MINUTES / len(cases)):
            wire.exchange.outcome()
        minutes += wire.now_s / 60
        assert not wire.presses, (profile.name, sender)
    assert minutes >= MINUTES


def polled(wire: Wire, seconds: float) -> set[str]:
    """Let a line be read for a while; the kinds of its faults."""
    until, kinds = wire.now_s + seconds, set()
    while wire.now_s < until:
        outcome = wire.exchange.outcome()
        if isinstance(outcome, Fault):
            kinds.add(str(outcome.kind))
    return kinds


@pytest.mark.parametrize("profile", BUTTONS, ids=lambda profile: profile.name)
def test_a_press_is_told_once_and_soon(profile: Profile) -> None:
    for after_s in (0.0, 0.013, 0.05, 0.12):
        wire = Wire(profile, lambda _: 0.01)
        polled(wire, 6.0)
        for press in range(1, 4):
            wire.wait(after_s)
            pressed_s = wire.now_s
            wire.press()
            assert not polled(wire, 7.0)
            assert len(wire.presses) == press
            assert wire.presses[-1] - pressed_s < 1.5 + 2.1 * profile.interval_s


def test_two_lines_at_once_are_no_press() -> None:
    wire = Wire(SYLVAC)
    polled(wire, 6.0)
    for pause_s in (0.0, 0.3, 1.2):
        wire.press()
        polled(wire, pause_s)
        wire.press()
        assert polled(wire, 10.0) == {"sends unasked"}
        assert not wire.presses
        polled(wire, 3.0)
        assert not polled(wire, 5.0), "it is believed again"


def test_a_take_in_between_is_what_the_press_was_meant_for() -> None:
    wire = Wire(SYLVAC)
    polled(wire, 6.0)
    wire.press()
    polled(wire, 0.5)
    assert isinstance(wire.exchange.checked_outcome(), IndicatorReading)
    assert not polled(wire, 5.0)
    assert not wire.presses


def test_a_device_without_a_button_has_no_presses() -> None:
    wire = Wire(PROFILES["mahr-optorsd"])
    polled(wire, 6.0)
    wire.press()
    assert polled(wire, 5.0) == {"sends unasked"}
    assert not wire.presses


def test_a_device_that_was_off_is_believed_within_nine_time_outs() -> None:
    wire = Wire(SYLVAC, stalled=lambda at: None if 10 < at < 100 else at)
    polled(wire, 11.0)
    assert polled(wire, 88.0) == {"no answer"}
    polled(wire, 1.0 + 9 * SYLVAC.timeout_s)
    assert not polled(wire, 10.0)


DOCUMENTED = {"mitutoyo-it007r": [b"01A+0000.1234\r"]}
"""Frames of another width than the twin's."""


def losing(*answers: bytes) -> Callable[[Spindle], str]:
    """These answers one after the other, the last one for ever."""
    following = chain(answers, repeat(answers[-1]))
    return lambda _: next(following).decode("latin-1")


def frames(profile: Profile) -> Iterator[bytes]:
    request = profile.request(Query()) if profile.request else b""
    for position in (1.234, -0.567, 12.345, -23.456, 0.012, -0.002):
        for resolution in (0.01, 0.001, 0.0001):
            spindle = Spindle(partial(float, position), resolution)
            yield IndicatorTwin(profile, spindle).receive(request)
    yield from DOCUMENTED.get(profile.name, ())


def value(profile: Profile, frame: bytes) -> float | None:
    outcome = profile.parse(frame.strip(b"\r\n").decode("latin-1"), Query())
    return outcome.value_mm if isinstance(outcome, IndicatorReading) else None


def shortened(profile: Profile) -> Iterator[tuple[bytes, bytes]]:
    """Each frame, and the same without one of its bytes."""
    for frame in frames(profile):
        for at in range(len(frame.rstrip(b"\r\n"))):
            yield frame, frame[:at] + frame[at + 1 :]


def is_changed(profile: Profile, frame: bytes, short: bytes) -> bool:
    return value(profile, short) not in (None, value(profile, frame))


@pytest.mark.parametrize("profile", PROFILES.values(), ids=list(PROFILES))
def test_a_lost_byte_changes_no_reading_that_is_kept(profile: Profile) -> None:
    """Every byte of every frame; before and after it whole ones come."""
    changed = 0
    for frame, short in shortened(profile):
        if not is_changed(profile, frame, short):
            continue
        for answers in ((frame, frame, short, frame), (frame, short, frame)):
            wire = Wire(replace(profile, reply=losing(*answers)))
            wire.exchange.outcome()
            outcomes = [wire.exchange.checked_outcome() for _ in range(3)]
            changed += sum(
                isinstance(o, IndicatorReading) and o.value_mm != value(profile, frame)
                for o in outcomes
            )
    assert changed == 0


def test_the_documentation_names_the_profiles_that_are_blind_to_a_lost_byte() -> None:
    text = (ROOT / "docs" / "indicators.md").read_text(encoding="utf-8")
    for profile in PROFILES.values():
        pairs = list(shortened(profile))
        share = sum(is_changed(profile, *pair) for pair in pairs) / len(pairs)
        row = f"| `{profile.name}` | {100 * share:.0f} % |"
        assert (row in text) == (share > 0), row


def test_the_rest_of_a_line_begun_before_the_question_is_no_answer() -> None:
    """Of a stream ``-10.012`` the tail ``.012`` is a number too."""

    class Cut(Wire):
        def send(self, line: bytes) -> None:
            for at in range(len(line)):
                self.coming.append((self.now_s + 0.001 * at, line[at : at + 1]))

    for phase in range(40):
        profile = replace(PROFILES["ascii-line"], reply=losing(b"-10.012\r\n"))
        wire = Cut(profile)
        wire.wait(0.2 + 0.0005 * phase)
        for _ in range(5):
            outcome = wire.exchange.outcome()
            assert isinstance(outcome, IndicatorReading)
            assert outcome.value_mm == -10.012
            wire.wait(0.0305)


@pytest.mark.parametrize("line", [b"+000.100\r", b"?\r", b"x", b"\x00", b"\r\n", b"1.5\r"])
@pytest.mark.parametrize("name", ["sylvac", "ascii-line", "mitutoyo-01a", "u-wave"])
def test_a_flood_has_an_outcome_within_the_time_out(name: str, line: bytes) -> None:
    """A megabyte a second without an end; two hundredths of a second are allowed for it."""

    class Flooded(Wire):
        @property
        def in_waiting(self) -> int:
            return 1

        def read(self, size: int) -> bytes:
            self.now_s += size * 1e-6
            return (line * size)[:size]

        def write(self, request: bytes) -> None:
            self.questions += 1

    wire = Flooded(PROFILES[name])
    for _ in range(20):
        start_s = max(wire.now_s, wire.exchange.ready_at)
        outcome = wire.exchange.checked_outcome()
        assert wire.now_s - start_s <= wire.profile.timeout_s + 0.2
        assert isinstance(outcome, Fault)
        assert outcome.kind is FaultKind.SENDS_UNASKED


@pytest.mark.parametrize("profile", PROFILES.values(), ids=list(PROFILES))
def test_a_number_of_hundreds_of_digits_is_none(profile: Profile) -> None:
    for frame in frames(profile):
        text = frame.strip(b"\r\n").decode("latin-1")
        for at, sign in enumerate(text):
            if sign.isdigit():
                for digit in "09":
                    long = text[:at] + digit * 400 + text[at:]
                    assert not isinstance(profile.parse(long, Query()), IndicatorReading)


@pytest.mark.parametrize("pattern", [r"(?P<number>(\d+)+)", r"(?P<number>(\d|\d\d)*(\.?\d+)*)"])
def test_a_pattern_of_the_user_takes_no_longer_than_the_line(pattern: str) -> None:
    assert isinstance(ascii_line(pattern).parse("1" * 500 + "x", Query()), Fault)
