"""Counters, U-WAVE, Mahr, TESA, Heidenhain: what is a value, what is not, and their twins."""

from __future__ import annotations

import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.profile import Fault, FaultKind, IndicatorReading, Profile, Query, Spindle, Unit
from drivers.profiles.heidenhain_nd28x import HEIDENHAIN_ND28X
from drivers.profiles.mahr_millimar import MAHR_C1202, MAHR_OPTORSD
from drivers.profiles.mitutoyo_counter import MITUTOYO_COUNTER, MITUTOYO_VL50
from drivers.profiles.sylvac import MAHR_MARCATOR
from drivers.profiles.tesa import TESA
from drivers.profiles.u_wave import U_WAVE
from drivers.twins import IndicatorTwin

PROFILES = (
    MITUTOYO_COUNTER,
    MITUTOYO_VL50,
    U_WAVE,
    MAHR_OPTORSD,
    MAHR_C1202,
    MAHR_MARCATOR,
    TESA,
    HEIDENHAIN_ND28X,
)
EVERY = pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)

MM, INCH, UM = Unit.MM, Unit.INCH, Unit.MICROMETRE
FAULTY, WRONG_UNIT = FaultKind.DEVICE_FAULT, FaultKind.WRONG_UNIT
WRONG_CHANNEL, STRANGE = FaultKind.WRONG_CHANNEL, FaultKind.NOT_UNDERSTOOD

A_VALUE = {
    "mitutoyo-counter": r"GN01,[+-][0-9]+\.[0-9]+",
    "mitutoyo-vl50": r"GN01,[+-][0-9]+\.[0-9]+",
    "u-wave": r"DT1[0-9]{2}01[+-][0-9]+\.[0-9]+[M0]",
    "mahr-optorsd": r"[-+ ]?[0-9]+\.[0-9]+ ?mm ?",
    "mahr-c1202": r"1 [+-][0-9]+\.[0-9]+ mm[ <=>]*",
    "mahr-marcator": r"[-+ ][0-9]+\.[0-9]+[<=>]?",
    "tesa": r"[+-][0-9]+\.[0-9]+",
    "heidenhain-nd28x": r"[\x02\x06]*[+-][0-9. ]{9}[0-9] [ <=>]{2,3}[SAGD ]",
}
"""Lines that may give a value to one who asked channel 1 in mm, written down a second time."""


@pytest.mark.parametrize(
    ("profile", "line", "query", "value_mm", "resolution_mm", "assumed"),
    [
        (MITUTOYO_COUNTER, "GN01,+0016.2345", Query(), 16.2345, 1e-4, True),
        (MITUTOYO_COUNTER, "GN01,-0016.2345", Query(), -16.2345, 1e-4, True),
        (MITUTOYO_COUNTER, "GN06,+0016.2345", Query(channel=6), 16.2345, 1e-4, True),
        (MITUTOYO_COUNTER, "GN01,+000.50000", Query(unit=INCH), 12.7, 25.4e-5, True),
        (MITUTOYO_VL50, "GN01,+0016.2345", Query(), 16.2345, 1e-4, True),
        (U_WAVE, "DT10005+00000020.06M", Query(channel=5), 20.06, 0.01, False),
        (U_WAVE, "DT10005-00000001.25M", Query(channel=5), -1.25, 0.01, False),
        (U_WAVE, "DT10012+0000.12345I", Query(12, INCH), 3.13563, 25.4e-5, False),
        (U_WAVE, "DT10005+00000020.060", Query(channel=5), 20.06, 0.01, True),
        (MAHR_OPTORSD, "12.345mm", Query(), 12.345, 1e-3, False),
        (MAHR_OPTORSD, "-12.345mm", Query(), -12.345, 1e-3, False),
        (MAHR_OPTORSD, "-0.5in", Query(unit=INCH), -12.7, 2.54, False),
        (MAHR_OPTORSD, "12.3\xb5m", Query(unit=UM), 0.0123, 1e-4, False),
        (MAHR_C1202, "1 +012.34 um =", Query(unit=UM), 0.01234, 1e-5, False),
        (MAHR_C1202, "2 -012.34 mm <", Query(channel=2), -12.34, 0.01, False),
        (MAHR_C1202, "1 +012.34 mm", Query(), 12.34, 0.01, False),
        (MAHR_C1202, "1 +012.34 mm = <", Query(), 12.34, 0.01, False),
        (MAHR_C1202, "1 +000.50 inch", Query(unit=INCH), 12.7, 0.254, False),
        (MAHR_MARCATOR, "+012.345", Query(), 12.345, 1e-3, True),
        (MAHR_MARCATOR, " 12.345", Query(), 12.345, 1e-3, True),
        (MAHR_MARCATOR, "-0.001", Query(), -0.001, 1e-3, True),
        (MAHR_MARCATOR, "+012.345=", Query(), 12.345, 1e-3, True),
        (TESA, "+0012.34", Query(), 12.34, 0.01, True),
        (TESA, "-.001250", Query(unit=INCH), -0.03175, 25.4e-6, False),
        (TESA, "+000.125", Query(unit=UM), 0.000125, 1e-6, True),
        (HEIDENHAIN_ND28X, "-      5.23   =A", Query(), -5.23, 0.01, False),
        (HEIDENHAIN_ND28X, "-      .801    ", Query(), -0.801, 1e-3, False),
        (HEIDENHAIN_ND28X, "+   12.3456    ", Query(), 12.3456, 1e-4, False),
        (HEIDENHAIN_ND28X, "\x02+   12.3456    ", Query(), 12.3456, 1e-4, False),
        (HEIDENHAIN_ND28X, "\x06+   12.3456  < ", Query(), 12.3456, 1e-4, False),
        (HEIDENHAIN_ND28X, '+   0.50000 "  ', Query(unit=INCH), 12.7, 25.4e-5, False),
        (HEIDENHAIN_ND28X, '-      5.23  "=A', Query(unit=INCH), -132.842, 0.254, False),
    ],
)
def test_values(
    profile: Profile,
    line: str,
    query: Query,
    value_mm: float,
    resolution_mm: float,
    assumed: bool,
) -> None:
    reading = profile.parse(line, query)
    assert isinstance(reading, IndicatorReading)
    assert reading.value_mm == pytest.approx(value_mm, rel=1e-12)
    assert reading.resolution_mm == pytest.approx(resolution_mm, rel=1e-12)
    assert reading.unit_assumed is assumed
    assert reading.unit is query.unit
    assert reading.text == line


@pytest.mark.parametrize(
    ("profile", "line", "kind"),
    [
        (MITUTOYO_COUNTER, "GX01,+0016.2345", FAULTY),
        (MITUTOYO_COUNTER, "GM01,-0016.2345", FAULTY),
        (MITUTOYO_COUNTER, "GW01,+0016.2345", FAULTY),
        (MITUTOYO_COUNTER, "ER01,2", FAULTY),
        (MITUTOYO_COUNTER, "ER02,2", WRONG_CHANNEL),
        (MITUTOYO_COUNTER, "GN02,+0016.2345", WRONG_CHANNEL),
        (MITUTOYO_COUNTER, "GN01,0016.2345", STRANGE),
        (MITUTOYO_COUNTER, "GN01,+0016,2345", STRANGE),
        (MITUTOYO_COUNTER, "GN01,", STRANGE),
        (MITUTOYO_COUNTER, "GN01,+0016.2345 ", STRANGE),
        (MITUTOYO_COUNTER, "DH01,+0016.2345", STRANGE),
        (MITUTOYO_COUNTER, "DH01,+NG", STRANGE),
        (MITUTOYO_COUNTER, "CP01,+0016.2345", STRANGE),
        (MITUTOYO_VL50, "GX01,+0016.2345", FAULTY),
        (U_WAVE, "ST10006FFFFFFFFFF51", WRONG_CHANNEL),
        (U_WAVE, "ST10001FFFFFFFFFF51", FAULTY),
        (U_WAVE, "ST100FFFFFFFFFFFF50", FAULTY),
        (U_WAVE, "ST10001123456FFFF00", FaultKind.LOW_BATTERY),
        (U_WAVE, "ST10001FFFFFFFFFF77", FAULTY),
        (U_WAVE, "DT10005+00000020.06M", WRONG_CHANNEL),
        (U_WAVE, "DT10001+0000.12345I", WRONG_UNIT),
        (U_WAVE, "DT10001+00000020.06", STRANGE),
        (U_WAVE, "DT10001+00000020.06X", STRANGE),
        (U_WAVE, "0020.06M", STRANGE),
        (MAHR_OPTORSD, "12.345um", WRONG_UNIT),
        (MAHR_OPTORSD, "12.345\xb5m", WRONG_UNIT),
        (MAHR_OPTORSD, "0.12345in", WRONG_UNIT),
        (MAHR_OPTORSD, "12.345", STRANGE),
        (MAHR_OPTORSD, "12,345mm", STRANGE),
        (MAHR_OPTORSD, "mm ", STRANGE),
        (MAHR_OPTORSD, "-C1-C2", STRANGE),
        (MAHR_OPTORSD, "M1, 12.345", STRANGE),
        (MAHR_C1202, "1 ERR6", FAULTY),
        (MAHR_C1202, "ERR6", FAULTY),
        (MAHR_C1202, "2 ERR6", WRONG_CHANNEL),
        (MAHR_C1202, "2 +012.34 mm", WRONG_CHANNEL),
        (MAHR_C1202, "1 +012.34 um =", WRONG_UNIT),
        (MAHR_C1202, "1 +012.34 inch", WRONG_UNIT),
        (MAHR_C1202, "1 +012.34 deg", WRONG_UNIT),
        (MAHR_C1202, "1 -012:34:56 dms <", WRONG_UNIT),
        (MAHR_C1202, "1 +012.34 mm;2 +012.34 mm <", STRANGE),
        (MAHR_C1202, "1 +012.34", STRANGE),
        (MAHR_C1202, "1 +012.34 mm <=>", STRANGE),
        (MAHR_MARCATOR, "ERR0", FAULTY),
        (MAHR_MARCATOR, "ERR1", FAULTY),
        (MAHR_MARCATOR, "ERR3", FaultKind.OVER_RANGE),
        (TESA, "ERR23", FAULTY),
        (TESA, "-.001250", WRONG_UNIT),
        (TESA, "+012.34", STRANGE),
        (TESA, "0012.34", STRANGE),
        (TESA, "+......1", STRANGE),
        (TESA, "+000012.", STRANGE),
        (HEIDENHAIN_ND28X, "+   12.3456 ?  ", FAULTY),
        (HEIDENHAIN_ND28X, "+   12.3456  ? ", FAULTY),
        (HEIDENHAIN_ND28X, "-      5.23  ?=A", FAULTY),
        (HEIDENHAIN_ND28X, '+   0.50000 "  ', WRONG_UNIT),
        (HEIDENHAIN_ND28X, "\x15", FAULTY),
        (HEIDENHAIN_ND28X, "?", FAULTY),
        (HEIDENHAIN_ND28X, "\x02FORMAT.ERR.", FAULTY),
        (HEIDENHAIN_ND28X, "\x02+123456789", STRANGE),
        (HEIDENHAIN_ND28X, "\x02-12345.6789", STRANGE),
        (HEIDENHAIN_ND28X, "-      5.23", STRANGE),
        (HEIDENHAIN_ND28X, "-      5.2   =A", STRANGE),
        (HEIDENHAIN_ND28X, "-  1   5.23   =A", STRANGE),
        (HEIDENHAIN_ND28X, "X=+41.29 R", STRANGE),
    ],
)
def test_what_is_not_a_value(profile: Profile, line: str, kind: FaultKind) -> None:
    fault = profile.parse(line, Query())
    assert isinstance(fault, Fault)
    assert fault.kind is kind
    assert fault.text == line
    assert fault.words


@pytest.mark.parametrize(
    ("profile", "line"),
    [
        (MITUTOYO_COUNTER, "CH01"),
        (MITUTOYO_COUNTER, "GA01"),
        (MITUTOYO_VL50, "CH01"),
        (MAHR_OPTORSD, "?"),
        (MAHR_OPTORSD, "MAHR GMBH,C1208 "),
        (MAHR_C1202, "M1?"),
        (MAHR_MARCATOR, "?"),
        (MAHR_MARCATOR, "SY276"),
        (TESA, "?"),
        (HEIDENHAIN_ND28X, "\x02"),
        (HEIDENHAIN_ND28X, "\x06"),
    ],
)
def test_passed_over(profile: Profile, line: str) -> None:
    assert profile.parse(line, Query()) is None


@EVERY
@pytest.mark.parametrize(
    "line",
    [
        "911",
        "918",
        "999999.99",
        "3 TO 999999.99 mm",
        "1234",
        "0001,FOOTSWITCH, ,01",
        "3:+0012.46",
        "15052 ms 1.47 mm",
        "00-09.9999",
        "01A+0000.123",
        "1 MW+003.4665 inch",
        "nan",
        "1,25",
        "",
    ],
)
def test_strangers_are_not_understood(profile: Profile, line: str) -> None:
    fault = profile.parse(line, Query())
    assert isinstance(fault, Fault)
    assert fault.kind is STRANGE


def test_statuses_of_u_wave_have_words_of_their_own() -> None:
    codes = ("00", "01", "02", "03", "04", "05", "50", "51", "99", "77")
    outcomes = [U_WAVE.parse(f"ST10006FFFFFFFFFF{code}", Query(channel=6)) for code in codes]
    words = {outcome.words for outcome in outcomes if isinstance(outcome, Fault)}
    assert len(words) == len(codes)
    assert "battery" in min(words, key=lambda text: "battery" not in text)


@EVERY
def test_bad_replies_are_the_faults_that_they_claim_to_be(profile: Profile) -> None:
    assert profile.bad_replies
    for bad in profile.bad_replies.values():
        fault = profile.parse(bad.reply.strip(b"\r\n").decode("latin-1"), Query())
        assert isinstance(fault, Fault)
        assert fault.kind is bad.kind


def answer(profile: Profile, spindle: Spindle) -> bytes:
    """What the twin sends when asked, or of its own accord."""
    request = profile.request(Query(channel=spindle.channel)) if profile.request else b""
    return IndicatorTwin(profile, spindle).receive(request)


@pytest.mark.parametrize(
    ("profile", "expected"),
    [
        (MITUTOYO_COUNTER, b"GN01,-0001.2340\r\n"),
        (MITUTOYO_VL50, b"GN01,-0001.2340\r\n"),
        (U_WAVE, b"DT10001-00000001.2340M\r"),
        (MAHR_OPTORSD, b"-1.2340mm\r\n"),
        (MAHR_C1202, b"1 -001.2340 mm\r"),
        (MAHR_MARCATOR, b"-001.2340\r"),
        (TESA, b"-01.2340\r\n"),
        (HEIDENHAIN_ND28X, b"-    1.2340    \r\n"),
    ],
    ids=lambda value: value.name if isinstance(value, Profile) else "",
)
def test_bytes_of_the_twins(profile: Profile, expected: bytes) -> None:
    assert answer(profile, Spindle(lambda: -1.234, 1e-4)) == expected


@EVERY
@given(
    position_mm=st.floats(-99.0, 99.0),
    resolution_mm=st.sampled_from([0.1, 0.01, 0.005, 0.001, 0.0005, 0.0001]),
    channel=st.sampled_from([1, 3]),
)
@example(position_mm=-0.0, resolution_mm=0.001, channel=1)
@example(position_mm=-0.0004, resolution_mm=0.001, channel=1)
def test_round_trip(
    profile: Profile, position_mm: float, resolution_mm: float, channel: int
) -> None:
    reply = answer(profile, Spindle(lambda: position_mm, resolution_mm, channel))
    assert reply.endswith(b"\r\n") or reply.endswith(b"\r")
    reading = profile.parse(reply.rstrip(b"\r\n").decode("latin-1"), Query(channel=channel))
    assert isinstance(reading, IndicatorReading)
    assert abs(reading.value_mm - position_mm) <= resolution_mm / 2 + 1e-9
    assert reading.resolution_mm <= resolution_mm * (1 + 1e-9)


@EVERY
def test_twins_give_no_value_at_the_wrong_request(profile: Profile) -> None:
    twin = IndicatorTwin(profile, Spindle(lambda: 1.0, 0.001))
    assert twin.receive(b"IR1000000\r\n") in {b"", b"ERR1\r"}


def test_streaming_and_asking() -> None:
    for profile in PROFILES:
        assert (profile.request is None) == (profile.stream_s > 0.0)
        assert profile.timeout_s > profile.stream_s
        assert profile.hint
        assert profile.source


def test_other_features_and_numbers_of_the_twins() -> None:
    spindle = Spindle(lambda: 1.0, 0.001, channel=1)
    assert IndicatorTwin(MAHR_C1202, spindle).receive(b"M2?\r") == b"2 ERR6\r"
    assert (
        IndicatorTwin(MITUTOYO_COUNTER, spindle).receive(b"GA02\r\nGA00\r\n")
        == b"GN01,+00001.000\r\n"
    )
    assert IndicatorTwin(MITUTOYO_VL50, spindle).receive(b"CS\r\n") == b"CH01\r\n"


LIKELY = st.text('GNXMWADHRTSCEIP0159.,+-<=>? :;mniuµ"\x02\x06\x15\r\n', max_size=24)
ANYTHING = st.binary(max_size=40).map(lambda sent: sent.decode("latin-1"))


def assert_anchored(profile: Profile, line: str) -> None:
    """A typed outcome, and a value only from a line of the grammar and with its very digits."""
    outcome = profile.parse(line, Query())
    assert outcome is None or isinstance(outcome, IndicatorReading | Fault)
    if isinstance(outcome, IndicatorReading):
        assert re.fullmatch(A_VALUE[profile.name], line)
        numbers = re.findall(r"[+-]? *[0-9]*\.[0-9]+", line)
        assert len(numbers) == 1
        number = numbers[0].replace(" ", "")
        if profile is U_WAVE and line.endswith("0"):
            number = number[:-1]
        assert outcome.value_mm == float(number)


@EVERY
@given(line=LIKELY | ANYTHING)
def test_no_value_outside_the_grammar(profile: Profile, line: str) -> None:
    assert_anchored(profile, line)


@EVERY
@given(
    position_mm=st.floats(-99.0, 99.0),
    at=st.integers(0, 24),
    dropped=st.integers(0, 2),
    put_in=LIKELY.map(lambda text: text[:2]) | ANYTHING.map(lambda text: text[:2]),
)
def test_no_value_from_a_damaged_frame(
    profile: Profile, position_mm: float, at: int, dropped: int, put_in: str
) -> None:
    frame = answer(profile, Spindle(lambda: position_mm, 0.001)).decode("latin-1").rstrip("\r\n")
    assert_anchored(profile, frame[:at] + put_in + frame[at + dropped :])
