"""Input and surroundings that want a traceback and get a paragraph."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from app.report.streams import PrintableStream
from calib.printable import HIDDEN, printable
from protocols.documents import is_deep
from tests.app.cli import glidecal, refused, run_here
from tests.app.commands.hostile_files import chained
from tests.conftest import LONG, ROOT, first_quick

EXPERIMENT = ROOT / "sample_sessions" / "experiment_2_twelve.jsonl"
TABLE = ROOT / "sample_sessions" / "tables" / "experiment_2_twelve.csv"


@pytest.mark.parametrize(
    "arguments",
    [
        ("import", TABLE, "--resolution", "inf"),
        ("import", TABLE, "--repeatability", "nan"),
        ("simulate", "--resolution", "inf"),
        ("simulate", "--scatter", "nan"),
        ("run", "--simulated", "--headless", "--temperature", "nan"),
        ("simulate", "--seed", "-1"),
    ],
)
def test_numbers_out_of_range(arguments: tuple[str | Path, ...], tmp_path: Path) -> None:
    run = glidecal(*arguments, "-o", tmp_path / "s.jsonl")
    assert run.status == 2
    assert "Traceback" not in run.err
    assert not list(tmp_path.iterdir())


def test_coarse_display_and_tiny_repeatability(tmp_path: Path) -> None:
    session = tmp_path / "s.jsonl"
    assert glidecal("simulate", "--resolution", "10", "-o", session).status == 0
    second = tmp_path / "t.jsonl"
    assert glidecal("import", TABLE, "-o", second, "--repeatability", "1e-9").status == 0
    assert glidecal("solve", second).status == 0
    never = glidecal("import", TABLE, "-o", tmp_path / "u.jsonl", "--repeatability", "1e-300")
    assert (never.status, never.out) == (2, "")


@pytest.mark.parametrize("output", ["", ".", "/"])
def test_output_that_is_no_file(output: str, tmp_path: Path) -> None:
    assert "ends with .jsonl" in refused(2, "simulate", "-o", output, cwd=tmp_path)


def test_output_that_is_a_folder(tmp_path: Path) -> None:
    (tmp_path / "s.jsonl").mkdir()
    refused(3, "simulate", "-o", tmp_path / "s.jsonl")


@pytest.mark.parametrize("text", ["x=" + "[" * 3000, "x=" + "9" * 5000, "x = 1\n" * 2])
def test_hostile_toml(text: str, tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text)
    message = refused(3, "run", "--dry-run", "--machine", path)
    assert len(message) < 900


def test_messages_stay_short(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text("".join(f"key{n} = {n}\n" for n in range(3000)))
    message = refused(3, "run", "--dry-run", "--machine", path)
    assert "and 2997 more" in message
    assert len(message) < 900
    assert len(refused(3, "simulate", "--model", EXPERIMENT, "-o", tmp_path / "s.jsonl")) < 900


def test_very_long_procedure_name(tmp_path: Path) -> None:
    refused(3, "run", "--dry-run", "--protocol", "p" * 5000 + ".toml", cwd=tmp_path)


def test_replay_without_a_terminal_opens_no_screen() -> None:
    assert "no terminal" in refused(2, "replay", EXPERIMENT)


def test_all_readings_zero_say_that_no_noise_is_seen(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    rows = [
        f"{leg},{axis},{level},0"
        for leg in "xyz"
        for axis in "xyz"
        if axis != leg
        for level in (0, 60, -100)
    ]
    table.write_text("leg,axis,displacement_mm,value_mm\n" + "\n".join(rows) + "\n")
    assert glidecal("import", table, "-o", tmp_path / "s.jsonl").status == 0
    run = glidecal("solve", tmp_path / "s.jsonl")
    assert run.status == 0
    assert "these readings show no noise" in run.out


def test_readings_of_another_world_are_refused(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text(TABLE.read_text().replace("0.08", "999"))
    assert glidecal("import", table, "-o", tmp_path / "s.jsonl").status == 0
    refused(5, "solve", tmp_path / "s.jsonl", "--method", "linear", "--subset", "both")


@LONG
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_standard_output_on_a_full_disk() -> None:
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "app", "replay", "--json", EXPERIMENT],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=600,
        )
    assert run.returncode == 3
    assert "standard output: No space left" in run.stderr
    assert "Traceback" not in run.stderr


def test_a_console_without_unicode_gets_plain_spellings() -> None:
    run = subprocess.run(
        [sys.executable, "-m", "app", "solve", EXPERIMENT],
        capture_output=True,
        encoding="ascii",
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        check=True,
        timeout=600,
    )
    assert "+- U (95 %)" in run.stdout
    assert "d_rho - d_L" in run.stdout
    assert "-----" in run.stdout
    assert "?" not in run.stdout


@LONG
@pytest.mark.skipif(os.name != "posix", reason="needs a POSIX shell")
@pytest.mark.parametrize("closed", first_quick([">&-", ">&- <&-", ">&- 2>&-"]))
def test_closed_streams(closed: str) -> None:
    program = f'exec "{sys.executable}" -m app replay --headless "{EXPERIMENT}" {closed}'
    run = subprocess.run(["sh", "-c", program], capture_output=True, text=True, check=False)
    assert run.returncode == 3
    assert "Traceback" not in run.stderr
    assert ("standard output: closed. Allowed: a terminal" in run.stderr) == ("2>&-" not in closed)


def test_a_stream_behind_may_be_closed_first() -> None:
    """As where both are collected, the one behind first: Python 3.13 tells of what fails then."""
    behind = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    stream = PrintableStream(behind)
    behind.close()
    stream.close()
    with pytest.raises(ValueError, match="closed"):
        PrintableStream(behind).write("lost")


@LONG
@pytest.mark.skipif(os.name != "posix", reason="needs a POSIX pipe")
def test_reader_of_the_output_goes_away() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    run = subprocess.run(
        [sys.executable, "-m", "app", "solve", EXPERIMENT],
        stdout=write_end,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=600,
    )
    os.close(write_end)
    assert run.returncode == 130
    assert "Traceback" not in run.stderr


@LONG
def test_thousands_of_readings_stay_cheap(tmp_path: Path) -> None:
    """The map from readings to differences is sparse; a dense one took 2 GB here."""
    table = tmp_path / "t.csv"
    levels = [k * 0.05 - 90.0 for k in range(1000)]
    rows = [
        f"{leg},{axis},{level:.2f},{0.001 * (k % 7)}"
        for leg in "xyz"
        for axis in "xyz"
        if axis != leg
        for k, level in enumerate(levels)
    ]
    table.write_text("leg,axis,displacement_mm,value_mm\n" + "\n".join(rows) + "\n")
    session = tmp_path / "s.jsonl"
    assert glidecal("import", table, "-o", session).status == 0
    run = glidecal("solve", session, "--method", "linear")
    assert run.status == 0, run.err


# records, machines and procedures of strangers


def record_with(folder: Path, line: int, **changed: object) -> Path:
    """An open simulated record with other keys in one line, its digests right."""
    source = ROOT / "sample_sessions" / "simulated_zero-max-min.jsonl"
    events = [json.loads(text) for text in source.read_text().splitlines()][:-1]
    events[line] |= changed
    path = folder / "s.jsonl"
    path.write_bytes(chained(events))
    return path


@pytest.mark.parametrize("name", ["/", ".", "..", "", "/etc/passwd", "../other.jsonl", "a\\b"])
def test_what_a_record_verifies_is_a_name_beside_it(name: str, tmp_path: Path) -> None:
    message = refused(3, "run", "--continue", record_with(tmp_path, 0, verifies=name), "--headless")
    assert "in the same folder" in message


@pytest.mark.parametrize(
    ("line", "changed"),
    [
        (2, {"value_mm": 1e300}),
        (2, {"displacement_mm": -1e300}),
        (2, {"resolution_mm": 1e300}),
        (2, {"time_s": 1e308}),
        (2, {"temperature_c": 1e9}),
        (2, {"leg": "z", "axis": "x", "mount": "other"}),
        (0, {"seed": -1}),
        (1, {"station": 1e300}),
    ],
)
def test_numbers_of_a_record_that_no_machine_gives(
    line: int, changed: dict[str, object], tmp_path: Path
) -> None:
    assert f"line {line + 1}" in refused(3, "solve", record_with(tmp_path, line, **changed))


@pytest.mark.parametrize(
    "text",
    [
        "offset_tolerance_mm = 1e-300",
        "length_tolerance_mm = 5e-324",
        "travel_min_mm = -1e300",
        "load = 1e-300",
        "[[indicator]]\nprofile = 'table'\nresolution_mm = 1e300",
        "[[indicator]]\nprofile = 'table'\nresolution_mm = 5e-324",
        "x = 0x" + "f" * 5000,
    ],
)
def test_numbers_of_a_machine_file_out_of_all_bounds(text: str, tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text + "\n")
    refused(3, "simulate", "--machine", path, "-o", tmp_path / "s.jsonl")
    assert not (tmp_path / "s.jsonl").exists()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("seconds_per_step = ", "seconds_per_step = 1e308 # "),
        ("cycles = ", "tolerance_mm = 1e-300\ncycles = "),
        ("levels = ", "levels = [" + "0.5, " * 100_000 + "] # "),
        ("cycles = ", "window_s = 1e-300\ncycles = "),
    ],
)
def test_numbers_of_a_procedure_out_of_all_bounds(old: str, new: str, tmp_path: Path) -> None:
    text = (ROOT / "protocols" / "procedures" / "zero-max-min.toml").read_text()
    assert old in text
    path = tmp_path / "p.toml"
    path.write_text(text.replace(old, new, 1))
    refused(3, "run", "--dry-run", "--protocol", path)


@pytest.mark.parametrize(
    "key",
    ["a" + ".a" * 3000, "a" + ".a" * 300_000, '"a b"' + ' . "a b"' * 3000, "'a'" + ".'a'" * 40],
)
@pytest.mark.parametrize("form", ["{} = 1", "[{}]", "x = {{ {} = 1 }}"])
def test_keys_of_very_many_parts(key: str, form: str, tmp_path: Path) -> None:
    """The time of tomllib grows with the square of the parts: it is not asked."""
    path = tmp_path / "m.toml"
    path.write_text(form.format(key) + "\n")
    assert "very many parts" in refused(3, "run", "--dry-run", "--machine", path)


def test_full_stops_are_not_parts_of_a_key() -> None:
    assert not is_deep('d = "' + "a." * 99 + '" # ' + "b." * 99 + "\nx = [" + "0.5, " * 99 + "]\n")


READERS = [
    ("machine file", ("run", "--dry-run", "--machine", "{}")),
    ("procedure file", ("run", "--dry-run", "--protocol", "{}")),
    ("model", ("model", "{}")),
    ("model", ("simulate", "--model", "{}", "-o", "out.jsonl")),
    ("table", ("import", "{}", "-o", "out.jsonl")),
    ("INI file", ("export", str(EXPERIMENT), "--format", "linuxcnc", "--ini", "{}", "-o", "out")),
    (
        "posture file",
        (
            "simulate",
            "--machine",
            "hexaslide",
            "--procedure",
            "position",
            "--posture-file",
            "{}",
            "-o",
            "out.json",
        ),
    ),
    (
        "machine file",
        (
            "identifiability",
            "hexaslide",
            "--procedure",
            "position",
            "--postures",
            "9",
            "--machine-file",
            "{}",
        ),
    ),
    ("truth file", ("solve", "--machine", "hexaslide", "{}")),
    ("effect file", ("diagnose", "--aliases")),
    ("settings file", ("settings",)),
]


@pytest.mark.parametrize("kind", ["pipe", "8 GB", "folder", "100,000 levels"])
@pytest.mark.parametrize(("what", "arguments"), READERS)
def test_only_ordinary_files_of_a_sensible_size_are_read(
    what: str,
    arguments: tuple[str, ...],
    kind: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "file.toml"
    if what == "effect file":
        path = tmp_path / "file.py"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GLIDECAL_EFFECTS", str(tmp_path))
    monkeypatch.setenv(
        "GLIDECAL_SETTINGS", str(path if what == "settings file" else tmp_path / "-")
    )
    if kind == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("needs a POSIX pipe")
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "8 GB":
        with path.open("wb") as file:
            file.truncate(8 << 30)
    else:
        path.write_text("[" * 100_000)
    status, out, err = run_here(*(part.format(path) for part in arguments))
    assert (status, out) == (3, "")
    assert err.startswith("glidecal: ")
    if kind == "pipe":
        assert "a pipe or a device" in err
    if kind == "8 GB":
        assert "bytes" in err
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


# terminal escapes

ESCAPES = "\x1b]0;owned\x07\x1b]52;c;cm0=\x07\x9b31m\u202e\u200b\x7f\nverdict: fine\r\n"


@LONG
def test_no_verb_prints_a_control_character(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.toml").write_text(f"name = {json.dumps(ESCAPES)}\n")
    procedure = (ROOT / "protocols" / "procedures" / "zero-max-min.toml").read_text()
    pattern = re.compile(r"(?m)^(name|title|description) = .*")
    spoilt = pattern.sub(lambda match: f"{match[1]} = {json.dumps(ESCAPES)}", procedure)
    (tmp_path / "p.toml").write_text(spoilt)
    evil = f"s{ESCAPES.splitlines()[0]}.jsonl"
    machine = json.loads(EXPERIMENT.read_text().splitlines()[0])["machine"] | {"name": ESCAPES}
    hostile = {"operator": ESCAPES, "remarks": [ESCAPES], "machine": machine}
    record = record_with(tmp_path, 0, **hostile)
    (tmp_path / evil).write_bytes(record.read_bytes())
    record.unlink()
    runs = [
        ("run", "--dry-run", "--machine", "m.toml", "--protocol", "p.toml"),
        ("simulate", "--machine", "m.toml", "--protocol", "p.toml", "-o", f"t{evil}"),
        *((verb, f"t{evil}") for verb in ("solve", "validate", "plan")),
        *((verb, evil) for verb in ("solve", "validate", "plan", "diagnose")),
        *((verb, evil, "--json") for verb in ("solve", "replay", "plan")),
        ("replay", "--headless", evil),
        ("replay", "--headless", f"none{evil}"),
        ("compare", evil, f"t{evil}"),
        ("export", f"t{evil}", "--format", "model", "-o", f"m{evil}"),
        ("model", f"m{evil}"),
        ("model", f"m{evil}", "--json"),
        ("export", f"t{evil}", "--format", "linuxcnc", "-o", f"inc{evil}"),
        (
            "simulate",
            "--machine",
            "hexaslide",
            "--procedure",
            ESCAPES,
            "--postures",
            "9",
            "-o",
            "h",
        ),
        ("identifiability", ESCAPES),
        ("run", "--protocol", ESCAPES),
        ("no-such-verb" + ESCAPES,),
        ("solve", "--no-such-option" + ESCAPES),
    ]
    for arguments in runs:
        _, out, err = run_here(*arguments)
        assert set(HIDDEN.findall(out + err)) <= {"\n"}, arguments
        assert not re.search("(?m)^verdict: fine", out), arguments
        if "--json" in arguments:
            json.loads(out)
    for include in (tmp_path / f"inc{evil}").iterdir():
        assert set(HIDDEN.findall(include.read_text())) == {"\n"}


def test_json_keeps_its_values_where_text_is_made_printable() -> None:
    assert json.loads(printable(json.dumps([ESCAPES, "\U000e0041"], ensure_ascii=False))) == [
        ESCAPES,
        "\U000e0041",
    ]
