"""Offsets for controllers: texts, signs, refusals."""

from __future__ import annotations

import csv
import errno
import json
import re
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from app.commands.results import export
from app.evaluating.solution import solve_files
from app.exports import FORMATS
from app.exports.linuxcnc import NOT_HOMED
from app.report.text.caveats import caveats
from app.report.text.correction import BOUND, correction_lines
from calib.errors import RecordError
from calib.posterior.correction import Holds
from protocols.data_table import csv_text
from protocols.files import write_files
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, ROOT, SAMPLES, first_quick

LINEAR = ("--method", "linear")


OFFSETS = ("--subset", "joint-offsets")


def csv_rows(path: Path) -> list[dict[str, str]]:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def cautions_of(session: Path, kind: str) -> list[str]:
    """What a file of this kind says of its correction and of the readings, each as one line."""
    result = solve_files([session])
    holds: dict[str, Holds] = {"model": "kinematics", "linuxcnc": "tables"}
    absent = dict.fromkeys(("play", "table"), NOT_HOMED) if kind == "linuxcnc" else None
    correction = result.corrections.of(holds.get(kind, "offsets"), absent)
    return [*correction_lines(result, correction), *caveats(result)]


def in_file(path: Path, kind: str) -> str:
    """Everything in a file that is there for people to read, as one line."""
    if kind in ("json", "model"):
        return " ".join(json.loads(path.read_text())["cautions"])
    return comments(path)


def comments(path: Path) -> str:
    lines = path.read_text().splitlines()
    return " ".join(line.removeprefix("# ") for line in lines if line.startswith("# "))


@pytest.fixture
def session(samples: Path) -> Path:
    return samples / "experiment_2_twelve.jsonl"


DAY = "measured not stated, imported"
MADE = f"{DAY} 2026-01-01 00:00 +0000, digest 0123456789abcdef, glidecal VERSION"


def without_version(text: str) -> str:
    """The text with its first comment on one line, and no date, digest and version in it."""
    head, entries = text.split("\n# old ", 1)
    provenance = DAY + r" [\d-]{10} [\d:]{5} \+0000, digest [\da-f]{16}, glidecal \S+$"
    return f"{re.sub(provenance, MADE, ' '.join(head.split(chr(10) + '# ')))}\n# old {entries}"


def test_linuxcnc_includes_as_golden_text(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "inc"
    run = glidecal(
        "export", session, "--format", "linuxcnc", *LINEAR, "--home-offset", "10,-2.5,0", "-o", out
    )
    assert run.status == 0, run.err
    assert "the present HOME_OFFSET is not stated" not in run.err
    golden = ROOT / "tests" / "golden" / "linuxcnc"
    names = sorted(p.name for p in out.iterdir())
    assert names == ["calib_joint0.inc", "calib_joint1.inc", "calib_joint2.inc"]
    for name in names:
        assert without_version((out / name).read_text()) == (golden / name).read_text()


def test_sign_new_is_old_plus_offset(session: Path, tmp_path: Path) -> None:
    """True = believed + offset, so the switch sits at old + offset (LinuxCNC HOME_OFFSET)."""
    ini = tmp_path / "m.ini"
    joints = "".join(f"[JOINT_{n}]\nTYPE = LINEAR\nHOME_OFFSET = {n}.5\n" for n in range(3))
    ini.write_text("[TRAJ]\nLINEAR_UNITS = mm\n" + joints)
    run = glidecal("export", session, "--format", "linuxcnc", *LINEAR, "--ini", ini, "-o", tmp_path)
    assert run.status == 0, run.err
    path = [(tmp_path / f"calib_joint{n}.inc").read_text() for n in range(3)]
    numbers = [float(text.rsplit("=", 1)[1]) for text in path]
    assert numbers == pytest.approx([0.5 - 0.4856, 1.5 + 0.4990, 2.5 - 1.6712], abs=1e-4)
    for text in path:
        (last,) = [line for line in text.splitlines() if not line.startswith("#")]
        assert last.startswith("HOME_OFFSET = ")


def test_an_unknown_home_offset_gives_no_value_to_enter(session: Path, tmp_path: Path) -> None:
    """Nothing that could undo a calibration: only what to add to the value that is there."""
    run = glidecal("export", session, "--format", "linuxcnc", *LINEAR, "-o", tmp_path)
    assert run.status == 0
    assert "the present HOME_OFFSET is not stated" in run.err
    for n, change in enumerate(("-0.485579", "+0.49", "-1.67")):
        text = (tmp_path / f"calib_joint{n}.inc").read_text()
        assert not [line for line in text.splitlines() if not line.startswith("#")]
        assert f"add {change}" in comments(tmp_path / f"calib_joint{n}.inc")


def test_lengths_do_not_fit_into_home_offset(session: Path, tmp_path: Path) -> None:
    message = refused(
        2, "export", session, "--format", "linuxcnc", "--subset", "both", "-o", tmp_path / "x"
    )
    assert "HOME_OFFSET cannot hold a length" in message
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("HOME_OFFSET = 12.3 # note", "no comment behind it"),
        ("HOME_OFFSET = 0,04", "decimal point"),
        ("HOME_OFFSET =", "found nothing"),
        ("HOME_OFFSET = 1e999", "found '1e999'"),
        ("HOME_OFFSET = 1", "no section [JOINT_1]"),
    ],
)
def test_bad_ini(session: Path, tmp_path: Path, line: str, message: str) -> None:
    ini = tmp_path / "m.ini"
    ini.write_text(f"[TRAJ]\nLINEAR_UNITS = mm\n[JOINT_0]\n{line}\n")
    out = tmp_path / "x"
    assert message in refused(3, "export", session, "--format", "linuxcnc", "--ini", ini, "-o", out)
    assert not out.exists()


@pytest.mark.parametrize("of_a_set", [(), OFFSETS], ids=["correction", "set"])
def test_json_and_csv_agree(session: Path, tmp_path: Path, of_a_set: tuple[str, ...]) -> None:
    for kind in ("json", "csv"):
        arguments = ("--format", kind, *of_a_set, "-o", tmp_path / kind)
        assert glidecal("export", session, *arguments).status == 0
    document = json.loads((tmp_path / "json").read_text(encoding="utf-8"))
    assert document["schema"] == "glidecal.offsets/1"
    rows = csv_rows(tmp_path / "csv")
    assert [row["parameter"] for row in rows] == list(document["parameters"])
    for row in rows:
        entry = document["parameters"][row["parameter"]]
        assert float(row["value_mm"]) == pytest.approx(entry["value"], abs=1e-6)
        for column, key in (
            ("standard_uncertainty_mm", "standard_uncertainty"),
            ("expanded_uncertainty_mm", "expanded_uncertainty"),
            ("expanded_with_lack_of_fit_mm", "expanded_with_lack_of_fit"),
        ):
            value = float(row[column]) if row[column] else None
            assert value == (entry[key] and pytest.approx(entry[key], abs=1e-6))


@pytest.mark.parametrize("name", ["simulated_plane.jsonl", "experiment_2_twelve.jsonl"])
def test_a_csv_says_why_an_interval_is_narrower_than_a_deviation(name: str, tmp_path: Path) -> None:
    """Of a mixture of models the ratio of both may be any; a file where it is usual is silent."""
    run = glidecal("export", SAMPLES / name, "--format", "csv", "-o", tmp_path / "o.csv")
    assert run.status == 0, run.err
    rows = csv_rows(tmp_path / "o.csv")
    is_less = any(
        float(row["expanded_uncertainty_mm"]) < float(row["standard_uncertainty_mm"])
        for row in rows
    )
    assert is_less == name.startswith("simulated")
    assert is_less == ("less than the standard one" in (tmp_path / "o.csv").read_text("utf-8"))


def test_export_of_a_model(tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    offsets = {"d_rho_x": 0.0, "d_rho_y": 0.5, "d_rho_z": 0.0}
    text = json.dumps({"schema": "glidecal.model/1", "parameters_mm": offsets})
    model.write_text(text)
    run = glidecal(
        "export", model, "--format", "linuxcnc", "--home-offset", "1,1,1", "-o", tmp_path
    )
    assert run.status == 0, run.err
    assert "HOME_OFFSET = 1.500000" in (tmp_path / "calib_joint1.inc").read_text()


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "nan,0,0", ""])
def test_bad_home_offset(session: Path, tmp_path: Path, text: str) -> None:
    message = refused(
        2, "export", session, "--format", "linuxcnc", "--home-offset", text, "-o", tmp_path
    )
    assert "three numbers" in message


@pytest.mark.parametrize("kind", ["json", "csv", "model", "linuxcnc"])
def test_present_values_without_a_use_are_refused(kind: str, session: Path, tmp_path: Path) -> None:
    """Before: they were ignored in silence."""
    options = ("--steps",) if kind == "linuxcnc" else ("--home-offset", "--endstops", "--steps")
    for option in options:
        words = ("--format", kind, option, "1,2,3", "-o", tmp_path / "out")
        assert f"{option}: found --format {kind}. Allowed: " in refused(
            2, "export", session, *words
        )
    assert not list(tmp_path.iterdir())


def test_an_export_never_replaces_a_record(session: Path, tmp_path: Path) -> None:
    record = tmp_path / "s.jsonl"
    record.write_bytes(session.read_bytes())
    assert "a session" in refused(2, "export", record, "--format", "json", "-o", record)
    link = tmp_path / "link.json"
    link.symlink_to(record)
    assert "a link to" in refused(2, "export", record, "--format", "json", "-o", link)
    assert record.read_bytes() == session.read_bytes()


def test_an_export_replaces_no_folder_and_no_device(session: Path, tmp_path: Path) -> None:
    assert "ordinary file" in refused(2, "export", session, "--format", "csv", "-o", tmp_path)
    assert "ordinary file" in refused(2, "export", session, "--format", "csv", "-o", "/dev/null")


def test_second_calibration_starts_from_the_included_value(session: Path, tmp_path: Path) -> None:
    """The include stands before the old key and wins, as in the controller."""
    for n in range(3):
        (tmp_path / f"calib_joint{n}.inc").write_text(f"# note\nHOME_OFFSET = {n + 1}.5\n")
    ini = tmp_path / "m.ini"
    ini.write_text(
        "[TRAJ]\nLINEAR_UNITS = mm\n"
        + "".join(
            f"[JOINT_{n}]\n#INCLUDE calib_joint{n}.inc\nHOME_OFFSET = 0.0\n" for n in range(3)
        )
    )
    run = glidecal(
        *("export", session, "--format", "linuxcnc", *LINEAR, "--ini", ini, "-o", tmp_path / "new")
    )
    assert run.status == 0, run.err
    text = (tmp_path / "new" / "calib_joint0.inc").read_text()
    assert "HOME_OFFSET = 1.014421" in text


def test_a_session_becomes_a_model_that_simulates_it(samples: Path, tmp_path: Path) -> None:
    """Solve, export the model, simulate without noise, solve again: the same parameters."""
    session, model = samples / "simulated_zero-max-min.jsonl", tmp_path / "model.json"
    subset = ("--subset", "both")
    assert glidecal("export", session, "--format", "model", *subset, "-o", model).status == 0
    simulation = tmp_path / "s.jsonl"
    quiet = ("--scatter", "0", "--resolution", "0")
    assert glidecal("simulate", "--model", model, *quiet, "-o", simulation).status == 0
    first, second = (
        json.loads(glidecal("solve", path, *subset, "--json").out)["parameters"]
        for path in (session, simulation)
    )
    for name, parameter in first.items():
        assert second[name]["value"] == pytest.approx(parameter["value"], abs=1e-6)


@pytest.mark.parametrize("kind", first_quick(["json", "csv", "model", "linuxcnc"]))
@pytest.mark.parametrize("name", first_quick(["experiment_2_twelve", "simulated_zero-max-min"]))
def test_every_file_says_what_is_known_of_it(
    samples: Path, tmp_path: Path, kind: str, name: str
) -> None:
    """The bound of what it holds, what is left out, what others would gain; remarks of solve."""
    session = samples / f"{name}.jsonl"
    cautions = cautions_of(session, kind)
    assert [line for line in cautions if line.startswith(BOUND)] == cautions[:1]
    assert sum("for this controller would leave clearly less" in line for line in cautions) == 1
    out = tmp_path / kind
    run = glidecal("export", session, "--format", kind, "-o", out)
    assert run.status == 0, run.err
    files = sorted(out.iterdir()) if kind == "linuxcnc" else [out]
    assert len(files) == (3 if kind == "linuxcnc" else 1)
    for path in files:
        for caution in cautions:
            assert caution in in_file(path, kind)
    for caution in cautions:
        assert caution in run.err


def test_what_solve_remarks_of_readings_is_in_the_file(samples: Path, tmp_path: Path) -> None:
    """A reading 50 µm off its repeats: a line of the page, and of the file."""
    table = tmp_path / "t.csv"
    options = ("--table", "readings", "--format", "csv", "-o", table)
    assert glidecal("export", samples / "simulated_zero-max-min.jsonl", *options).status == 0
    rows = table.read_text().splitlines()
    column = rows[0].split(",").index("value_mm")
    cells = rows[5].split(",")
    cells[column] = f"{float(cells[column]) + 0.05:.4f}"
    table.write_text("\n".join([*rows[:5], ",".join(cells), *rows[6:]]) + "\n")
    session, out = tmp_path / "s.jsonl", tmp_path / "o.json"
    assert glidecal("import", table, "-o", session).status == 0
    text = " ".join(glidecal("solve", session).out.split())
    assert glidecal("export", session, "--format", "json", "-o", out).status == 0
    suspects = [
        caution
        for caution in json.loads(out.read_text())["cautions"]
        if caution.startswith("SUSPECT")
    ]
    assert suspects
    assert all(caution in text for caution in suspects)


def test_readings_that_stand_still_export_no_minus_before_zeros(tmp_path: Path) -> None:
    rows = [
        f"{leg},{axis},{at},0.5"
        for _ in range(3)
        for leg in "xyz"
        for at in (0, 60, -100)
        for axis in "xyz"
        if axis != leg
    ]
    table, session = tmp_path / "still.csv", tmp_path / "still.jsonl"
    table.write_text("\n".join(["leg,axis,displacement_mm,value_mm", *rows]) + "\n", "utf-8")
    stated = ("--resolution", "0.001", "--repeatability", "0.002")
    assert glidecal("import", table, "-o", session, *stated).status == 0
    text = glidecal("export", session, "--format", "csv", "-o", "-").out
    out, zero = tmp_path / "inc", ("--home-offset", "0,0,0")
    assert glidecal("export", session, "--format", "linuxcnc", *zero, "-o", out).status == 0
    for written in (text, *(path.read_text("utf-8") for path in out.iterdir())):
        assert "0.000000" in written
        assert "-0.000000" not in written


def test_weak_combinations_are_said_of_the_full_set(session: Path, tmp_path: Path) -> None:
    subset = ("--subset", "both")
    out = tmp_path / "o.json"
    assert glidecal("export", session, "--format", "json", *subset, "-o", out).status == 0
    cautions = json.loads(out.read_text())["cautions"]
    assert sum(line.startswith("WEAK") for line in cautions) == 3
    text = " ".join(glidecal("solve", session, *subset).out.split())
    assert all(line in text for line in cautions if not line.startswith((BOUND, "NOTE: the set")))


@LONG
def test_uncertainties_of_a_set_are_those_of_solve(session: Path, tmp_path: Path) -> None:
    result = json.loads(glidecal("solve", session, *OFFSETS, "--json").out)
    for kind in ("json", "linuxcnc"):
        arguments = ("--format", kind, *OFFSETS, "-o", tmp_path / kind)
        assert glidecal("export", session, *arguments).status == 0
    document = json.loads((tmp_path / "json").read_text())
    for number, (name, entry) in enumerate(result["parameters"].items()):
        written = document["parameters"][name]
        for key in ("value", "standard_uncertainty", "expanded_uncertainty", "coverage_factor"):
            assert written[key] == entry[key]
        larger = result["expanded_with_lack_of_fit_mm"][name]
        assert written["expanded_with_lack_of_fit"] == larger > 10 * entry["expanded_uncertainty"]
        text = comments(tmp_path / "linuxcnc" / f"calib_joint{number}.inc")
        assert f"{name} is known to ±{larger:.3f} mm (95 %, residual" in text


def test_without_lack_of_fit_the_include_tells_the_plain_figure(
    samples: Path, tmp_path: Path
) -> None:
    session = samples / "simulated_zero-max-min.jsonl"
    result = json.loads(glidecal("solve", session, *OFFSETS, "--json").out)
    arguments = ("--format", "linuxcnc", *OFFSETS, "-o", tmp_path)
    assert glidecal("export", session, *arguments).status == 0
    half = result["parameters"]["d_rho_x"]["expanded_uncertainty"]
    text = comments(tmp_path / "calib_joint0.inc")
    assert f"d_rho_x is known to ±{half:.4f} mm (95 %), u = " in text


def test_cautions_go_through_a_model_file(session: Path, tmp_path: Path) -> None:
    model, inc = tmp_path / "model.json", tmp_path / "inc"
    arguments = ("--format", "model", *OFFSETS, "-o", model)
    assert glidecal("export", session, *arguments).status == 0
    assert glidecal("export", model, "--format", "linuxcnc", "-o", inc).status == 0
    text = comments(inc / "calib_joint1.inc")
    assert "it does not contain how well they are known" in text
    assert "WARNING: the residual is 11.1 times the noise" in text
    assert " is known to ±" not in text
    assert glidecal("export", model, "--format", "csv", "-o", tmp_path / "c").status == 0
    rows = csv_rows(tmp_path / "c")
    assert {row["standard_uncertainty_mm"] for row in rows} == {""}


def test_an_unfinished_session_is_a_caution(session: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.jsonl"
    cut.write_text("".join(session.read_text().splitlines(keepends=True)[:-1]))
    assert glidecal("export", cut, "--format", "json", "-o", tmp_path / "o").status == 0
    cautions = json.loads((tmp_path / "o").read_text())["cautions"]
    (line,) = [
        caution for caution in cautions if caution.startswith("cut.jsonl: not closed after line")
    ]
    assert line.endswith("the session is not finished.")


def test_a_name_of_two_lines_breaks_no_file(session: Path, tmp_path: Path) -> None:
    lines = session.read_text().splitlines(keepends=True)
    cut = tmp_path / f"a\n{'b' * 200}.jsonl"
    cut.write_text("".join(lines[:-1]))
    assert glidecal("export", cut, "--format", "csv", "-o", tmp_path / "o.csv").status == 0
    assert {"d_rho_x", "d_rho_y"} <= {next(iter(r.values())) for r in csv_rows(tmp_path / "o.csv")}
    assert glidecal("export", cut, "--format", "linuxcnc", "-o", tmp_path / "i").status == 0
    for path in (tmp_path / "i").iterdir():
        assert max(map(len, path.read_text().splitlines())) < 120


def test_lines_of_an_include_are_short_and_hold_one_number(session: Path, tmp_path: Path) -> None:
    """LinuxCNC reads lines of 255 characters at most; a name cannot break out of its comment."""
    named = tmp_path / "a\nHOME_OFFSET = 9.jsonl"
    named.write_bytes(session.read_bytes())
    homing = ("--home-offset", "1,2,3")
    run = glidecal("export", named, "--format", "linuxcnc", *homing, "-o", tmp_path / "i")
    assert run.status == 0
    for path in (tmp_path / "i").iterdir():
        lines = path.read_text().splitlines()
        assert max(map(len, lines)) < 120
        assert sum(not line.startswith("# ") for line in lines) == 1


# strangers' models, and disks that refuse


def model_of(session: Path, folder: Path, **changed: object) -> Path:
    """A model file of this session with other keys."""
    path = folder / "m.json"
    if not path.exists():
        run = glidecal("export", session, "--format", "model", *OFFSETS, *LINEAR, "-o", path)
        assert run.status == 0, run.err
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))
    return path


def test_a_newline_in_a_caution_writes_no_row_and_no_formula(session: Path, tmp_path: Path) -> None:
    hostile = "x\n=1+1,2\r\nd_rho_x,9.9\u2028y, =cmd|' /C calc'!A0; \"@SUM(A1)\t\x1b]0;t\x07"
    model = model_of(session, tmp_path, cautions=[hostile])
    assert glidecal("export", model, "--format", "csv", "-o", tmp_path / "o.csv").status == 0
    *notes, heading, first = (tmp_path / "o.csv").read_text().splitlines()[:4]
    assert heading.startswith("parameter,")
    assert first.startswith("d_rho_x,")
    assert all(line.startswith("# ") for line in notes)
    assert "\x1b" not in notes[-1]
    cells = [cell.strip().strip("\"'") for cell in re.split("[,;]", notes[-1].replace("'", "!"))]
    assert not [cell for cell in cells if cell.startswith(("=", "@", "+", "-"))]
    out = tmp_path / "inc"
    homing = ("--home-offset", "1,2,3")
    assert glidecal("export", model, "--format", "linuxcnc", *homing, "-o", out).status == 0
    for path in out.iterdir():
        assert {line[:1] for line in path.read_text().splitlines()} == {"#", "H"}


def test_cells_that_look_like_formulas_are_text() -> None:
    rows = [["=1+1", "-0.5", "+1e-3", "-1+cmd|' /C calc'!A0", "@A1", "a\nb", "\t=2"]]
    (row,) = csv.reader(csv_text(rows).splitlines())
    assert row == [
        "'=1+1'",
        "-0.5",
        "+1e-3",
        "'-1+cmd|' /C calc'!A0'",
        "'@A1'",
        r"a\u000ab",
        "\\u0009=2",
    ]


@pytest.mark.parametrize("kind", first_quick(["json", "csv", "model", "linuxcnc"]))
def test_an_offset_that_nobody_stated_is_not_zero(session: Path, tmp_path: Path, kind: str) -> None:
    model = model_of(session, tmp_path, parameters_mm={"d_rho_y": 0.1, "d_rho_z": 0.2})
    message = refused(3, "export", model, "--format", kind, "-o", tmp_path / "out")
    assert "no d_rho_x" in message
    assert not (tmp_path / "out").exists()


def test_home_offset_of_any_size_is_refused(session: Path, tmp_path: Path) -> None:
    export = ("export", session, "--format", "linuxcnc", "-o", tmp_path / "out")
    refused(2, *export, "--home-offset", "1e300,0,0")
    refused(2, *export, "--home-offset", "0,1e400,0")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("before", ["nothing", "old files"])
@pytest.mark.parametrize("failing", range(1, 7))
def test_includes_all_or_none_whichever_rename_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int, before: str
) -> None:
    names = [f"calib_joint{n}.inc" for n in range(3)]
    if before == "old files":
        for name in names:
            (tmp_path / name).write_text("old")
    (tmp_path / "other.ini").write_text("mine")
    stood = {path.name: path.read_text() for path in tmp_path.iterdir()}
    monkeypatch.setattr(Path, "replace", failing_replace({failing}))
    if before == "nothing" and failing > len(names):
        write_files(tmp_path, dict.fromkeys(names, "new"), replace=True)
        return
    with pytest.raises(RecordError, match="Input/output"):
        write_files(tmp_path, dict.fromkeys(names, "new"), replace=True)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == stood


@pytest.mark.parametrize("killed", range(1, 7))
def test_a_kill_leaves_old_includes_or_new_ones_never_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed: int
) -> None:
    """The controller does not start without an include; with a mixture it would."""
    names = [f"calib_joint{n}.inc" for n in range(3)]
    for name in names:
        (tmp_path / name).write_text("old")
    monkeypatch.setattr(Path, "replace", failing_replace({killed}, KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        write_files(tmp_path, dict.fromkeys(names, "new"), replace=True)
    assert len({(tmp_path / n).read_text() for n in names if (tmp_path / n).exists()}) <= 1


def test_what_cannot_be_put_back_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"calib_joint{n}.inc" for n in range(3)]
    for name in names:
        (tmp_path / name).write_text("old")
    monkeypatch.setattr(Path, "replace", failing_replace(set(range(5, 99))))
    with pytest.raises(RecordError) as error:
        write_files(tmp_path, dict.fromkeys(names, "new"), replace=True)
    assert "New: calib_joint0.inc. Old, under another name: calib_joint0.inc" in str(error.value)
    assert (tmp_path / names[0]).read_text() == "new"
    assert [path.read_text() for path in tmp_path.glob("*.old")] == ["old"] * 3


def failing_replace(
    failing: set[int], fault: type[BaseException] = OSError
) -> Callable[[Path, Path], Path]:
    """`Path.replace` whose calls of these numbers fail."""
    calls = count(1)
    plain = Path.replace

    def replace(self: Path, target: Path) -> Path:
        if next(calls) in failing:
            raise fault(errno.EIO, "Input/output error")
        return plain(self, target)

    return replace


def test_every_format_can_be_asked_for_and_is_on_the_page() -> None:
    """The command names its choices itself: what makes the files is imported where it is used."""
    names = {*get_args(get_args(get_type_hints(export, include_extras=True)["format_name"])[0])}
    assert names == {*FORMATS, "ros2", "xlsx", "parquet"}
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    assert [name for name in FORMATS if f"`{name}`" not in page] == []
