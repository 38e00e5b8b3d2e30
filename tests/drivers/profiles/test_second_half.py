"""Magnescale, Keyence, Marposs, CDI, Starrett, multiplexers and bridges: bytes → outcome."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import IndicatorError
from drivers.profile import (
    Fault,
    FaultKind,
    IndicatorReading,
    Outcome,
    Profile,
    Query,
    Spindle,
    Unit,
)
from drivers.profiles.ascii_line import ASCII_LINE, ascii_line
from drivers.profiles.cdi import CDI
from drivers.profiles.keyence_dl_rs1a import KEYENCE_DL_RS1A
from drivers.profiles.magnescale_lt import MAGNESCALE_LT
from drivers.profiles.marposs_quick_read import MARPOSS_QUICK_READ
from drivers.profiles.metro_mux import METRO_MUX
from drivers.profiles.mux import DMX, MUX
from drivers.profiles.starrett_iq import STARRETT_IQ
from drivers.twins import IndicatorTwin
from tests.conftest import LONG

ASKED_LINE = ascii_line(r"(?P<number>-?\d+\.\d+)", request=b"READ?")

GRAMMARS: dict[str, tuple[Profile, str]] = {
    "magnescale-lt": (
        MAGNESCALE_LT,
        r"(A([NPIA]M[UGLE]?)?[-+ ](?=[0-9.]{7}([ ,;]?B|$))[0-9]+\.[0-9]+)([ ,;]?B.+)?",
    ),
    "keyence-dl-rs1a": (KEYENCE_DL_RS1A, r"M0(,[-+][0-9]{3}\.[0-9]{4})+"),
    "marposs-quick-read": (MARPOSS_QUICK_READ, r"[-+](?=.{7,8}$)[0-9]+\.[0-9]+[<>@X]?"),
    "cdi": (CDI, r"[-+](?=.{8,9},) *[0-9]*\.[0-9]+, MM"),
    "starrett-iq": (STARRETT_IQ, r"[-+](?=.{7,8},) *[0-9]*\.[0-9]+, MM"),
    "mux": (MUX, r"1 MW ?[-+](?=.{7,8} mm)[0-9]+\.[0-9]+ mm *"),
    "dmx": (DMX, r"1 MW ?[-+](?=.{7,8} mm)[0-9]+\.[0-9]+ mm *"),
    "metro-mux": (
        METRO_MUX,
        r"V1: (mm  | mm |  mm|    ) [ <=>A-Za-z]{3} {1,2}[-+ ][0-9]{5}\.[0-9]{6}",
    ),
    "ascii-line": (ASCII_LINE, r"[-+]?0{0,4}[0-9]{0,4}\.[0-9]{1,6}( ?mm)?"),
    "ascii-line asked": (ASKED_LINE, r"-?[0-9]+\.[0-9]+"),
}
TRAPS = ["", "911", "999999.99", "1234", "0001,FOOTSWITCH, ,01", "3:+0012.46", "15052 ms 1.47 mm"]
TRAPS += ["00-09.9999", "001, -1.2340, NRM, 01", "1e3", "١.٥", "+12.34\xb5", "inf", "\x8d"]
PROFILES = {name: profile for name, (profile, _) in GRAMMARS.items()}


def heard(name: str, text: str, channel: int = 1, unit: Unit = Unit.MM) -> Outcome | None:
    return PROFILES[name].parse(text, Query(channel, unit))


@pytest.mark.parametrize(
    ("name", "text", "value", "step"),
    [
        ("magnescale-lt", "A+12.3456", 12.3456, 1e-4),
        ("magnescale-lt", "A-12.3456", -12.3456, 1e-4),
        ("magnescale-lt", "A 012.345", 12.345, 1e-3),
        ("marposs-quick-read", "+00.1341", 0.1341, 1e-4),
        ("marposs-quick-read", "-00.0282", -0.0282, 1e-4),
        ("marposs-quick-read", "-000.123", -0.123, 1e-3),
        ("marposs-quick-read", "+00.1341>", 0.1341, 1e-4),
        ("marposs-quick-read", "+00.1341<", 0.1341, 1e-4),
        ("marposs-quick-read", "+00.1341@", 0.1341, 1e-4),
        ("marposs-quick-read", "+00.1341X", 0.1341, 1e-4),
        ("keyence-dl-rs1a", "M0,+012.3456", 12.3456, 1e-4),
        ("keyence-dl-rs1a", "M0,-000.0010,+012.3456", -0.001, 1e-4),
        ("metro-mux", f"V1:{' ' * 11}-00001.250000", -1.25, 1e-6),
        ("metro-mux", f"V1:{' ' * 11}00001.250000", 1.25, 1e-6),
        ("ascii-line", "-0.012", -0.012, 1e-3),
        ("ascii-line", ".5", 0.5, 0.1),
        ("ascii-line", "+1.50", 1.5, 0.01),
        ("ascii-line", "0000.123", 0.123, 1e-3),
    ],
)
def test_values_without_a_unit(name: str, text: str, value: float, step: float) -> None:
    reading = heard(name, text)
    assert isinstance(reading, IndicatorReading)
    assert (reading.value_mm, reading.resolution_mm) == (value, step)
    assert reading.unit_assumed
    assert reading.text == text


@pytest.mark.parametrize(
    ("name", "text", "query", "value", "step"),
    [
        ("magnescale-lt", "ANM+12.3456", Query(), 12.3456, 1e-4),
        ("magnescale-lt", "APMG-12.3456", Query(), -12.3456, 1e-4),
        ("magnescale-lt", "AAI+0.12345", Query(unit=Unit.INCH), 3.13563, 2.54e-4),
        ("magnescale-lt", "ANM+12.3456 BNM-01.2345", Query(), 12.3456, 1e-4),
        ("magnescale-lt", "ANM+12.3456,BNM-01.2345", Query(2), -1.2345, 1e-4),
        ("cdi", "+   2.1380, MM", Query(), 2.138, 1e-4),
        ("cdi", "+  2.1380, MM", Query(), 2.138, 1e-4),
        ("cdi", "-   0.0050, IN", Query(unit=Unit.INCH), -0.127, 2.54e-3),
        ("starrett-iq", "+ 2.1380, MM", Query(), 2.138, 1e-4),
        ("starrett-iq", "-12.1380, MM", Query(), -12.138, 1e-4),
        ("starrett-iq", "- 0.0050, IN", Query(unit=Unit.INCH), -0.127, 2.54e-3),
        ("mux", "1 MW+003.4665 inch", Query(unit=Unit.INCH), 88.0491, 2.54e-3),
        ("mux", "2 MW-00088.29 mm", Query(2), -88.29, 0.01),
        ("mux", "4 MW +00001.55 mm", Query(4), 1.55, 0.01),
        ("mux", "1 MW+00012.50 um", Query(unit=Unit.MICROMETRE), 0.0125, 1e-5),
        ("dmx", "1 MW +001.378 mm    ", Query(), 1.378, 1e-3),
        ("dmx", "8 MW +001.378 mm    ", Query(8), 1.378, 1e-3),
        ("metro-mux", "V2: mm        -00001.250000", Query(2), -1.25, 1e-6),
        ("metro-mux", "V2: mm       -00001.250000", Query(2), -1.25, 1e-6),
        ("metro-mux", "V2: mm    >  +00001.250000", Query(2), 1.25, 1e-6),
        ("metro-mux", "V1: inch     +00001.000000", Query(unit=Unit.INCH), 25.4, 2.54e-5),
        ("ascii-line", "1.47 mm", Query(), 1.47, 0.01),
        ("ascii-line", "-3.07 mm", Query(), -3.07, 0.01),
        ("ascii-line", "0.0390 inches", Query(unit=Unit.INCH), 0.9906, 2.54e-3),
        ("ascii-line", "12.5 µm", Query(unit=Unit.MICROMETRE), 0.0125, 1e-4),
    ],
)
def test_values_with_their_unit(
    name: str, text: str, query: Query, value: float, step: float
) -> None:
    reading = heard(name, text, query.channel, query.unit)
    assert isinstance(reading, IndicatorReading)
    assert reading.value_mm == pytest.approx(value, abs=1e-12)
    assert reading.resolution_mm == pytest.approx(step)
    assert not reading.unit_assumed
    assert reading.unit is query.unit


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        ("magnescale-lt", "A+F2.3456", FaultKind.OVER_RANGE),
        ("magnescale-lt", "ANM+F2.3456", FaultKind.OVER_RANGE),
        ("magnescale-lt", "AF2.3456", FaultKind.OVER_RANGE),
        ("magnescale-lt", "AE", FaultKind.DEVICE_FAULT),
        ("magnescale-lt", "AEF", FaultKind.DEVICE_FAULT),
        ("magnescale-lt", "AEO", FaultKind.DEVICE_FAULT),
        ("magnescale-lt", 'ANME"  Error "', FaultKind.DEVICE_FAULT),
        ("magnescale-lt", "B+12.3456", FaultKind.WRONG_CHANNEL),
        ("magnescale-lt", "ANI+0.12345", FaultKind.WRONG_UNIT),
        ("magnescale-lt", "00-09.9999", FaultKind.NOT_UNDERSTOOD),
        ("magnescale-lt", "00NM-09.9999", FaultKind.NOT_UNDERSTOOD),
        ("magnescale-lt", "A+12.345", FaultKind.NOT_UNDERSTOOD),
        ("magnescale-lt", "A+1234567", FaultKind.NOT_UNDERSTOOD),
        ("magnescale-lt", "A+12.3456Bx", FaultKind.NOT_UNDERSTOOD),
        ("keyence-dl-rs1a", "ER,SR,65", FaultKind.DEVICE_FAULT),
        ("keyence-dl-rs1a", "ER,M0,00", FaultKind.DEVICE_FAULT),
        ("keyence-dl-rs1a", "ER,M0,77", FaultKind.DEVICE_FAULT),
        ("keyence-dl-rs1a", "M0,+999.9999", FaultKind.OVER_RANGE),
        ("keyence-dl-rs1a", "MS,4,+012.3456", FaultKind.NOT_UNDERSTOOD),
        ("keyence-dl-rs1a", "SR,06,101,+012.3456", FaultKind.NOT_UNDERSTOOD),
        ("keyence-dl-rs1a", "M0,+012.3456,", FaultKind.NOT_UNDERSTOOD),
        ("marposs-quick-read", "O", FaultKind.OVER_RANGE),
        ("marposs-quick-read", "N", FaultKind.DEVICE_FAULT),
        ("marposs-quick-read", "I", FaultKind.DEVICE_FAULT),
        ("marposs-quick-read", "ERR3", FaultKind.DEVICE_FAULT),
        ("marposs-quick-read", ">", FaultKind.NOT_UNDERSTOOD),
        ("marposs-quick-read", "+00.1341>>", FaultKind.NOT_UNDERSTOOD),
        ("cdi", "-   0.0050, IN", FaultKind.WRONG_UNIT),
        ("cdi", "+   2.1380", FaultKind.NOT_UNDERSTOOD),
        ("cdi", "+   2.1380, CM", FaultKind.NOT_UNDERSTOOD),
        ("cdi", "+   2. 380, MM", FaultKind.NOT_UNDERSTOOD),
        ("starrett-iq", "- 0.0050, IN", FaultKind.WRONG_UNIT),
        ("starrett-iq", "NOT FOUND", FaultKind.DEVICE_FAULT),
        ("starrett-iq", "NO ACCESS", FaultKind.DEVICE_FAULT),
        ("starrett-iq", "OUT OF BOUNDS", FaultKind.DEVICE_FAULT),
        ("starrett-iq", "NON NUMERIC", FaultKind.DEVICE_FAULT),
        ("mux", "1 TO 999999.99 mm", FaultKind.DEVICE_FAULT),
        ("mux", "3 TO 999999.99 mm", FaultKind.WRONG_CHANNEL),
        ("mux", "1 MW+003.4665 inch", FaultKind.WRONG_UNIT),
        ("mux", "2 MW-00088.29 mm", FaultKind.WRONG_CHANNEL),
        ("mux", "1 MW+003.4665 deg", FaultKind.NOT_UNDERSTOOD),
        ("mux", "1 MW+003.4665", FaultKind.NOT_UNDERSTOOD),
        ("mux", "1 TO+003.4665 mm ?", FaultKind.NOT_UNDERSTOOD),
        ("dmx", "1 TO 999999.99 mm", FaultKind.DEVICE_FAULT),
        ("metro-mux", "N12:E1", FaultKind.DEVICE_FAULT),
        ("metro-mux", "N12:E3", FaultKind.DEVICE_FAULT),
        ("metro-mux", "V2: mm        -00001.250000", FaultKind.WRONG_CHANNEL),
        ("metro-mux", "V1: inch     +00001.000000", FaultKind.WRONG_UNIT),
        ("metro-mux", "V1: deg      +00001.000000", FaultKind.NOT_UNDERSTOOD),
        ("ascii-line", "0.1835 in", FaultKind.WRONG_UNIT),
        ("ascii-line", "nan", FaultKind.NOT_UNDERSTOOD),
        ("ascii-line", "1,25", FaultKind.NOT_UNDERSTOOD),
        ("ascii-line", "# Error reading from instrument: -1", FaultKind.NOT_UNDERSTOOD),
        ("ascii-line", "15052 ms 1.47 mm", FaultKind.NOT_UNDERSTOOD),
        ("ascii-line", "18675 ms 0.1835 in", FaultKind.NOT_UNDERSTOOD),
        ("ascii-line", "--1.2", FaultKind.NOT_UNDERSTOOD),
        ("ascii-line", "-\x00009891", FaultKind.NOT_UNDERSTOOD),
        ("ascii-line", "1.5\x00", FaultKind.NOT_UNDERSTOOD),
    ],
)
def test_faults(name: str, text: str, kind: FaultKind) -> None:
    fault = heard(name, text)
    assert isinstance(fault, Fault)
    assert (fault.kind, fault.text) == (kind, text)
    assert fault.words


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("magnescale-lt", "*r"),
        ("keyence-dl-rs1a", "M0"),
        ("marposs-quick-read", "M?"),
        ("cdi", "R"),
        ("starrett-iq", "R"),
        ("starrett-iq", "SUCCESS"),
        ("mux", "1"),
        ("mux", "1234"),
        ("mux", "MUX2 V1.10"),
        ("dmx", "C1"),
        ("metro-mux", "1"),
    ],
)
def test_passed_over(name: str, text: str) -> None:
    assert heard(name, text) is None


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize(
    "text",
    TRAPS,
)
def test_traps_are_no_values(name: str, text: str) -> None:
    if (name, text) != ("ascii-line asked", "999999.99"):  # its pattern allows this one
        assert not isinstance(heard(name, text), IndicatorReading)


def test_the_channel_picks_the_amplifier() -> None:
    text = "M0,+001.0000,-002.0000,+999.9999"
    outcomes = [heard("keyence-dl-rs1a", text, channel) for channel in (0, 1, 2, 3, 4)]
    kinds = [
        outcome.value_mm if isinstance(outcome, IndicatorReading) else outcome and outcome.kind
        for outcome in outcomes
    ]
    wrong, beyond = FaultKind.WRONG_CHANNEL, FaultKind.OVER_RANGE
    assert kinds == [wrong, 1.0, -2.0, beyond, wrong]


@pytest.mark.parametrize(
    ("name", "channel", "request_bytes"),
    [
        ("magnescale-lt", 1, b"*r\r\n"),
        ("keyence-dl-rs1a", 3, b"M0\r\n"),
        ("marposs-quick-read", 1, b"M?\r"),
        ("cdi", 1, b"R\r"),
        ("starrett-iq", 1, b"R\r"),
        ("mux", 3, b"3"),
        ("dmx", 3, b"C3\r\n"),
        ("metro-mux", 3, b"3"),
    ],
)
def test_requests(name: str, channel: int, request_bytes: bytes) -> None:
    request = PROFILES[name].request
    assert request is not None
    assert request(Query(channel)) == request_bytes


@pytest.mark.parametrize(
    ("name", "position", "resolution", "channel", "reply"),
    [
        ("magnescale-lt", 12.3456, 1e-4, 1, b"A+12.3456\r\n"),
        ("magnescale-lt", 123.4567, 1e-4, 1, b"A+F3.4567\r\n"),
        ("keyence-dl-rs1a", 12.3456, 1e-4, 2, b"M0,+000.0000,+012.3456\r\n"),
        ("marposs-quick-read", 0.1341, 1e-4, 1, b"+00.1341\r"),
        ("marposs-quick-read", -0.123, 1e-3, 1, b"-000.123\r"),
        ("marposs-quick-read", 123.4567, 1e-4, 1, b"O\r"),
        ("cdi", 2.138, 1e-4, 1, b"+   2.1380, MM\r\n"),
        ("starrett-iq", 2.138, 1e-4, 1, b"+ 2.1380, MM\r"),
        ("mux", -88.29, 0.01, 2, b"2 MW-00088.29 mm\r\n"),
        ("dmx", 1.378, 1e-3, 1, b"1 MW +001.378 mm    \r\n"),
        ("metro-mux", -1.25, 1e-3, 2, b"V2: mm        -00001.250000\r\n"),
        ("ascii-line", -0.012, 1e-3, 1, b"-0.012\r\n"),
    ],
)
def test_twins_speak_these_bytes(
    name: str, position: float, resolution: float, channel: int, reply: bytes
) -> None:
    assert spoken(PROFILES[name], position, resolution, channel) == reply


def spoken(profile: Profile, position: float, resolution: float, channel: int = 1) -> bytes:
    twin = IndicatorTwin(profile, Spindle(lambda: position, resolution, channel))
    if profile.request is None:
        assert profile.stream_s > 0.0
        assert twin.receive(b"anything") == b""
        return twin.receive(b"")
    assert twin.receive(b"") == b""
    return twin.receive(profile.request(Query(channel)))


@pytest.mark.parametrize("name", PROFILES)
@given(
    position=st.floats(-99.0, 99.0),
    resolution=st.sampled_from([0.01, 0.001, 0.0005, 0.0001]),
    channel=st.sampled_from([1, 2]),
)
def test_round_trip(name: str, position: float, resolution: float, channel: int) -> None:
    reply = spoken(PROFILES[name], position, resolution, channel)
    reading = heard(name, reply.decode("latin-1").rstrip("\r\n"), 1 if "A+" in name else channel)
    assert isinstance(reading, IndicatorReading)
    assert abs(reading.value_mm - position) <= resolution / 2 + 1e-9
    assert reading.resolution_mm <= resolution * (1 + 1e-9)


@pytest.mark.parametrize("name", PROFILES)
def test_bad_replies_are_what_they_say(name: str) -> None:
    for bad in PROFILES[name].bad_replies.values():
        assert bad.reply.endswith((b"\r", b"\r\n"))
        fault = heard(name, bad.reply.decode("latin-1").rstrip("\r\n"))
        assert isinstance(fault, Fault)
        assert fault.kind is bad.kind
    assert PROFILES[name].bad_replies or name == "ascii-line asked"


@pytest.mark.parametrize("name", [name for name in PROFILES if name != "ascii-line"])
def test_twins_answer_nothing_else_with_a_value(name: str) -> None:
    twin = IndicatorTwin(PROFILES[name], Spindle(lambda: 1.5, 0.001))
    reply = twin.receive(b"?9\r\n").decode("latin-1").strip()
    assert not reply or not isinstance(heard(name, reply), IndicatorReading)


SIGNS = st.sampled_from([*'+-. 0159AFMBERNVOTWIX<>=:,;"x\r\nµ', "mm", "MM", "\xff", "٣"])
LITERALS = ["A+12.3456 B-01.2345", "ANM+12.3456", "M0,+012.3456,-000.1000", "+00.1341>"]
LITERALS += ["+   2.1380, MM", "+ 2.1380, MM", "1 MW +001.378 mm    ", "1 TO 999999.99 mm"]
LITERALS += ["V1: mm        -00001.250000", "1.47 mm", "-0.012"]


@st.composite
def damaged(draw: st.DrawFn) -> str:
    """A literal reply with a few signs put in, taken out or changed."""
    text = draw(st.sampled_from(LITERALS))
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(text)))
        text = text[:place] + draw(st.just("") | SIGNS) + text[place + draw(st.integers(0, 1)) :]
    return text


@LONG
@pytest.mark.parametrize("name", GRAMMARS)
@given(text=damaged() | st.text(SIGNS.map(lambda sign: sign[0]), max_size=24) | st.text())
def test_no_value_from_outside_the_grammar(name: str, text: str) -> None:
    profile, grammar = GRAMMARS[name]
    outcome = profile.parse(text, Query())
    if isinstance(outcome, IndicatorReading):
        assert re.fullmatch(grammar, text)
        assert abs(outcome.value_mm) < 1e9


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        ("(?P<number>[0-9", "missing ]"),
        ("(?P<number>a{99999999999999999999})", "pattern of ascii-line"),
        ("(?u)(?P<number>1)", "invalid perl operator"),
        (r"(?P<number>\d+)(?=x)", "look-around"),
        (r"(\d)\1(?P<number>\d)", "back-references"),
        ("\ud800", "surrogates not allowed"),
        (r"-?\d+\.\d+", "without that group"),
        ("", "without that group"),
        (r"(?P<number>)\d+", "no number fits"),
        (r"(?P<number>[a-z)]+)", "no number fits"),
        (r"(?P<number>\d+,\d+)", "no number fits"),
        (r"(?P<unit>mm)\((?P<number>x\))", "no number fits"),
    ],
)
def test_patterns_that_cannot_work(pattern: str, words: str) -> None:
    with pytest.raises(IndicatorError, match=words) as raised:
        ascii_line(pattern)
    assert raised.value.thing == "pattern of ascii-line"
    assert raised.value.found
    assert "such as" in raised.value.allowed


@pytest.mark.parametrize(
    ("pattern", "text", "value"),
    [
        (r"\d+ ms (?P<number>-?\d+\.\d+) (?P<unit>mm|in)", "15052 ms -1.47 mm", -1.47),
        (r"(?P<number>[+-]\d{6}\.\d{2});", "+000001.25;", 1.25),
        (r"\[(?P<number>(?:\+|-)?[0-9)]*\.(\d+))\]", "[1.5]", 1.5),
        (r"D(?P<number> *\d+)", "D  12", 12.0),
    ],
)
def test_patterns_of_the_user(pattern: str, text: str, value: float) -> None:
    profile = ascii_line(pattern)
    reading = profile.parse(text, Query())
    assert isinstance(reading, IndicatorReading)
    assert reading.value_mm == value
    assert isinstance(profile.parse(f"{text}x", Query()), Fault)


def test_a_pattern_that_lets_in_what_is_no_number() -> None:
    profile = ascii_line(r"(?P<number>.*?)(?P<unit> [a-z]+)?")
    for text in ("nan", "1,25", "1e5", "", "1" * 400, "1.5 furlong"):
        assert isinstance(profile.parse(text, Query()), Fault)
