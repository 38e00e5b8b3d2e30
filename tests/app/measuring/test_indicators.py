"""Indicators named on the command line, in the machine file, and outside a session."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from app.measuring.demo import rehearsed
from app.measuring.indicators import (
    adapters,
    check_indicators,
    indicator_of,
    moved_adapters,
    parse_indicator,
    port_of,
    ports_to_choose,
    remember,
)
from app.report.text.questions import port_choices
from calib.arrays import conditions
from calib.errors import UsageError
from calib.tripod.geometry import Geometry
from calib.tripod.simulation import hidden_machine
from drivers.line import IndicatorLine
from drivers.profile import IndicatorReading
from drivers.profiles import profile_named
from drivers.twins import LineTrouble
from protocols.machine import Instrument
from protocols.procedure import axes_on_leg, load_procedure
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, first_quick


@pytest.mark.parametrize(
    ("text", "profile", "port", "axes"),
    [
        ("mitutoyo-01a:/dev/ttyUSB0", "mitutoyo-01a", "/dev/ttyUSB0", "xyz"),
        ("sylvac:COM5@xz", "sylvac", "COM5", "xz"),
        ("sylvac:socket://127.0.0.1:4000@y", "sylvac", "socket://127.0.0.1:4000", "y"),
    ],
)
def test_parse(text: str, profile: str, port: str, axes: str) -> None:
    instrument = parse_indicator(text)
    assert (instrument.profile, instrument.port, instrument.axes) == (profile, port, axes)


@pytest.mark.parametrize("text", ["sylvac", "sylvac:", ":COM5", "sylvac:COM5@xq", "sylvac:COM5@"])
def test_refused(text: str) -> None:
    with pytest.raises(UsageError, match="PROFILE:PORT"):
        parse_indicator(text)


@dataclass
class Port:
    """What the system says of a serial port."""

    device: str
    serial_number: str | None
    location: str | None = None
    description: str | None = "USB serial"
    hwid: str | None = "n/a"

    def __lt__(self, other: Port) -> bool:
        return self.device < other.device


def plugged(monkeypatch: pytest.MonkeyPatch, *ports: Port) -> None:
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: list(ports))


def test_what_the_system_does_not_say_of_a_port_is_null(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was the "n/a" of pyserial, twice in the text and in JSON."""
    plugged(monkeypatch, Port("/dev/ttyS0", None, description="n/a"))
    (document,) = json.loads(glidecal("ports", "--json").out)["ports"]
    assert document == {"port": "/dev/ttyS0", "description": None, "hardware": None}
    assert "Serial ports:\n  /dev/ttyS0\n" in glidecal("ports").out


def test_an_adapter_is_known_under_another_name_by_its_serial_number(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    first = Instrument(profile="mitutoyo-01a", port="/dev/ttyGONE0")
    plain = Instrument(profile="sylvac", port="/dev/ttyGONE1")
    plugged(monkeypatch, Port("/dev/ttyGONE0", "A1"), Port("/dev/ttyGONE1", None))
    remember("test machine", [first, plain])
    assert moved_adapters([first, plain]) == {}
    plugged(monkeypatch, Port("/dev/ttyGONE2", None), Port("/dev/ttyGONE7", "A1"))
    assert moved_adapters([first, plain]) == {0: "/dev/ttyGONE7"}
    assert [port for port, *_ in ports_to_choose("A1", ["/dev/ttyGONE2"])] == ["/dev/ttyGONE7"]
    assert [port for port, *_ in ports_to_choose("A1", [])] == ["/dev/ttyGONE7", "/dev/ttyGONE2"]
    assert [port for port, *_ in ports_to_choose("", [])] == ["/dev/ttyGONE2", "/dev/ttyGONE7"]
    choices = port_choices(ports_to_choose("A1", []), "A1")
    assert choices[0][1] == "/dev/ttyGONE7  USB serial, the same adapter, no. A1"
    assert choices[1][1] == "/dev/ttyGONE2  USB serial"


def test_two_ports_of_one_adapter_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both have its serial number."""
    ports = [Port("/dev/ttyUSB3", "F7", "1-2:1.0"), Port("/dev/ttyUSB4", "F7", "1-2:1.1")]
    plugged(monkeypatch, *ports)
    assert adapters() == {"/dev/ttyUSB3": "F7 1.0", "/dev/ttyUSB4": "F7 1.1"}
    assert port_of("F7 1.1", "/dev/ttyUSB0") == "/dev/ttyUSB4"
    assert port_of("F7 1.1", "/dev/ttyUSB4") is None
    assert port_of("", "/dev/ttyUSB0") is None


def test_a_form_without_a_profile_says_what_is_missing() -> None:
    with pytest.raises(UsageError, match="found none"):
        indicator_of({"port": "socket://127.0.0.1:1"})


def test_every_fault_in_one_message() -> None:
    with pytest.raises(UsageError) as caught:
        check_indicators(
            [
                Instrument(profile="sylvak", port="COM5", axes="x"),
                Instrument(profile="ascii-line", port="COM5", axes="x", pattern="(["),
            ]
        )
    message = str(caught.value)
    for part in ("sylvak", "pattern", "COM5 twice", "@x and @x do not fit leg"):
        assert part in message


def test_axes_follow_preferences() -> None:
    assert axes_on_leg("x", ("xyz", "xyz")) == [("y", "z")]
    assert axes_on_leg("x", ("zyx", "yxz")) == [("z", "y")]
    assert axes_on_leg("z", ("yx", "xz")) == [("y", "x")]
    assert axes_on_leg("y", ("xyz",)) == [("x",), ("z",)]
    with pytest.raises(UsageError, match="leg x"):
        axes_on_leg("x", ("x", "x"))


@contextmanager
def simulated(profile: str, *options: str) -> Iterator[str]:
    """A device in a process of its own; gives its port."""
    command = [sys.executable, "-m", "app", "simulate-indicator", profile, "--tcp", "0"]
    with subprocess.Popen(
        [*command, "--seconds", "600", *options], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.terminate()
            process.stdout.close()


@pytest.mark.parametrize("profile", ["mitutoyo-01a", "sylvac", "u-wave", "heidenhain-nd28x"])
def test_read_one_indicator(profile: str) -> None:
    with simulated(profile) as port:
        run = glidecal("indicator", "read", port, "--profile", profile, "--json")
    assert run.status == 0, run.err
    document = json.loads(run.out)
    assert document["profile"] == profile
    assert document["status"] == "value"
    assert abs(document["value_mm"]) <= 0.5
    assert document["resolution_mm"] == pytest.approx(0.001)


def test_a_fault_is_exit_4_and_no_value() -> None:
    with simulated("sylvac", "--fault", "over-range") as port:
        run = glidecal("indicator", "read", port, "--profile", "sylvac", "--json")
        doctor = glidecal("indicator", "doctor", port, "--profile", "sylvac")
    assert run.status == 4
    document = json.loads(run.out)
    assert document["status"] == "over range"
    assert "value_mm" not in document
    assert doctor.status == 4
    assert "outside the measuring range" in doctor.out


def test_unknown_names_list_what_exists() -> None:
    assert "sylvac" in refused(2, "indicator", "read", "COM9", "--profile", "sylvak")
    assert "sylvac" in refused(2, "indicator", "doctor", "COM9", "--profile", "sylvak")
    assert "sylvac" in refused(2, "simulate-indicator", "sylvak")
    strange = refused(2, "run", "--simulated", "--dry-run", "--profile", "sylvak")
    assert "indicator profile 'sylvak'. Allowed" in strange
    assert "glidecal ports lists" in strange
    assert "silence" in refused(2, "simulate-indicator", "sylvac", "--fault", "madness")
    assert "µm" in refused(2, "indicator", "read", "COM9", "--unit", "cubit")
    listed = glidecal("simulate-indicator", "sylvac", "--fault", "list").out.splitlines()
    names = dict(line.split(maxsplit=1) for line in listed)
    assert names["over-range"] == "answers ERR3, over range"
    assert set(LineTrouble) < set(names), "each with its explanation"


def test_enter_goes_on_and_a_number_goes_there() -> None:
    steps = load_procedure("zero-max-min", Geometry()).steps(Geometry())
    typed = ("", "nonsense", "30", "", "1", "99999", "0")
    visits = [step.number for step in rehearsed(steps, typed)]
    assert visits == [1, 2, 3, 30, 30, 1, 30, 1]


@LONG
@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_a_rehearsal_goes_where_the_machine_would() -> None:
    """Both indicators follow the steps of the hidden machine, and come back."""
    command = [sys.executable, "-m", "app", "simulate-indicator", "sylvac", "--seed", "7"]
    command += ["--protocol", "zero-max-min", "--seconds", "100"]
    levels = [0.0, 0.0, 60.0, 60.0, -100.0, -100.0]
    expected = hidden_machine(Geometry(), 7).readings(conditions([0] * 6, [1, 2] * 3, levels))
    pipe = subprocess.PIPE
    with subprocess.Popen(command, text=True, stdin=pipe, stdout=pipe, stderr=pipe) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        ports = [process.stdout.readline().strip() for _ in range(2)]
        advice = process.stderr.readline()
        assert advice == (
            "Measure with: glidecal run --protocol zero-max-min "
            f"--indicator sylvac:{ports[0]} --indicator sylvac:{ports[1]}\n"
        )
        lines = [IndicatorLine(profile_named("sylvac"), port) for port in ports]
        for line in lines:
            line.start()
        places: list[list[float]] = []
        for typed, step in (("", 1), ("\n", 2), ("3\n", 3), ("1\n", 1)):
            process.stdin.write(typed)
            process.stdin.flush()
            while f"step {step}:" not in process.stderr.readline():
                pass
            places.append(_at_rest(lines))
        for line in lines:
            line.close()
        process.terminate()
    zero, highest, lowest, again = places
    for axis in range(2):
        assert again[axis] == pytest.approx(zero[axis], abs=0.02)
        for values, row in ((highest, 2), (lowest, 4)):
            moved_mm = expected[row + axis] - expected[axis]
            assert values[axis] - zero[axis] == pytest.approx(moved_mm, abs=0.02)


def _at_rest(lines: Sequence[IndicatorLine]) -> list[float]:
    """The values when they have not changed in eight readings."""
    values: list[list[float]] = []
    while len(values) < 8 or any(value != values[-1] for value in values[-8:]):
        outcomes = [answer.result(timeout=10.0) for answer in [line.ask() for line in lines]]
        values.append(
            [outcome.value_mm for outcome in outcomes if isinstance(outcome, IndicatorReading)]
        )
        if len(values[-1]) < len(lines):
            values.pop()
    return values[-1]


@pytest.mark.parametrize("option", [("--fault", "slow"), ("--tcp", "0"), ("--channel", "2")])
def test_a_rehearsal_is_of_two_sound_indicators(option: tuple[str, str]) -> None:
    command = ("simulate-indicator", "sylvac", "--protocol", "zero-max-min", *option)
    assert "--fault, --tcp or --channel" in refused(2, *command)


def test_indicators_of_the_machine_file(tmp_path: Path) -> None:
    machine = tmp_path / "m.toml"
    machine.write_text(
        '[[indicator]]\nprofile = "sylvac"\nport = "COM5"\naxes = "zx"\n'
        '[[indicator]]\nprofile = "cdi"\nport = "COM6"\naxes = "yz"\n'
    )
    run = glidecal("run", "--dry-run", "--machine", machine)
    assert run.status == 0, run.err
    assert "z y" in run.out
    machine.write_text('[[indicator]]\nprofile = "sylvac"\nport = "COM5"\naxes = "xw"\n')
    assert "axes" in refused(3, "run", "--dry-run", "--machine", machine)


@pytest.mark.parametrize(
    "profiles",
    first_quick(
        [("sylvac", "heidenhain-nd28x"), ("u-wave",), ("mahr-optorsd", "cdi"), ("mux", "metro-mux")]
    ),
)
def test_demo_with_other_indicators(profiles: tuple[str, ...], tmp_path: Path) -> None:
    options = [part for name in profiles for part in ("--profile", name)]
    run = glidecal("demo", "--headless", *options, cwd=tmp_path)
    assert run.status == 0, run.err
    assert "Leg deviations went from" in run.out


def test_a_number_that_two_adapters_have_names_neither(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Cheap adapters all have the number 0001: one that is pulled is not at the port of another."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    instruments = [Instrument(profile="sylvac", port=f"/dev/ttyGONE{k}") for k in (0, 1)]
    twins = [Port(instrument.port, "0001", "1-2:1.0") for instrument in instruments]
    plugged(monkeypatch, Port("/dev/ttyGONE0", "A1"))
    remember("test machine", instruments)
    plugged(monkeypatch, *twins)
    assert adapters() == {}
    remember("test machine", instruments)
    plugged(monkeypatch, twins[1])
    assert moved_adapters(instruments) == {}
    plugged(monkeypatch, twins[1], Port("/dev/ttyGONE7", "A1"))
    assert moved_adapters(instruments) == {}, "A1 was at the port of a twin before it"
