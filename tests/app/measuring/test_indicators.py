"""Indicators named on the command line, in the machine file, and outside a session."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from app.measuring.indicators import check_indicators, parse_indicator
from calib.errors import UsageError
from protocols.machine import Instrument
from protocols.procedure import axes_on_leg
from tests.app.cli import glidecal, refused


@pytest.mark.parametrize(
    ("text", "profile", "port", "axes"),
    [
        ("mitutoyo-01a:/dev/ttyUSB0", "mitutoyo-01a", "/dev/ttyUSB0", "xyz"),
        ("sylvac:COM5@xz", "sylvac", "COM5", "xz"),
        ("sylvac:socket://127.0.0.1:4000@y", "sylvac", "socket://127.0.0.1:4000", "y"),
    ],
)
def test_parse(text: str, profile: str, port: str, axes: str) -> None:
    found = parse_indicator(text)
    assert (found.profile, found.port, found.axes) == (profile, port, axes)


@pytest.mark.parametrize("text", ["sylvac", "sylvac:", ":COM5", "sylvac:COM5@xq", "sylvac:COM5@"])
def test_refused(text: str) -> None:
    with pytest.raises(UsageError, match="PROFILE:PORT"):
        parse_indicator(text)


def test_every_fault_in_one_message() -> None:
    with pytest.raises(UsageError) as caught:
        check_indicators(
            [
                Instrument(profile="sylvak", port="COM5", axes="x"),
                Instrument(profile="ascii-line", port="COM5", axes="x", pattern="(["),
            ]
        )
    said = str(caught.value)
    for part in ("sylvak", "pattern", "COM5 twice", "@x and @x do not fit leg"):
        assert part in said


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
        [*command, "--seconds", "30", *options], stdout=subprocess.PIPE, text=True
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
    assert "sylvac" in refused(4, "indicator", "read", "COM9", "--profile", "sylvak")
    assert "silence" in refused(2, "simulate-indicator", "sylvac", "--fault", "madness")
    assert "µm" in refused(2, "indicator", "read", "COM9", "--unit", "cubit")
    assert "over-range" in glidecal("simulate-indicator", "sylvac", "--fault", "list").out


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
    [("sylvac", "heidenhain-nd28x"), ("u-wave",), ("mahr-optorsd", "cdi"), ("mux", "metro-mux")],
)
def test_demo_with_other_indicators(profiles: tuple[str, ...], tmp_path: Path) -> None:
    named = [part for name in profiles for part in ("--profile", name)]
    run = glidecal("demo", "--headless", *named, cwd=tmp_path)
    assert run.status == 0, run.err
    assert "Leg deviations went from" in run.out
