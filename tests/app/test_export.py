"""Offsets for controllers: texts, signs, refusals."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from tests.app.cli import glidecal, refused

LINEAR = ("--method", "linear")


@pytest.fixture
def session(samples: Path) -> Path:
    return samples / "experiment_2_twelve.jsonl"


def test_linuxcnc_includes_as_golden_text(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "inc"
    run = glidecal(
        "export", session, "--format", "linuxcnc", *LINEAR, "--home-offset", "10,-2.5,0", "-o", out
    )
    assert run.status == 0, run.err
    assert "WARNING" not in run.err
    golden = Path(__file__).parent.parent / "golden" / "linuxcnc"
    names = sorted(p.name for p in out.iterdir())
    assert names == ["calib_joint0.inc", "calib_joint1.inc", "calib_joint2.inc"]
    for name in names:
        assert (out / name).read_text() == (golden / name).read_text()


def test_sign_new_is_old_plus_offset(session: Path, tmp_path: Path) -> None:
    """True = believed + offset, so the switch sits at old + offset (LinuxCNC HOME_OFFSET)."""
    ini = tmp_path / "m.ini"
    ini.write_text("".join(f"[JOINT_{n}]\nTYPE = LINEAR\nHOME_OFFSET = {n}.5\n" for n in range(3)))
    run = glidecal("export", session, "--format", "linuxcnc", *LINEAR, "--ini", ini, "-o", tmp_path)
    assert run.status == 0, run.err
    written = [(tmp_path / f"calib_joint{n}.inc").read_text() for n in range(3)]
    numbers = [float(text.rsplit("=", 1)[1]) for text in written]
    assert numbers == pytest.approx([0.5 - 0.4856, 1.5 + 0.4990, 2.5 - 1.6712], abs=1e-4)
    for text in written:
        (last,) = [line for line in text.splitlines() if not line.startswith("#")]
        assert last.startswith("HOME_OFFSET = ")


def test_unknown_home_offset_is_said(session: Path, tmp_path: Path) -> None:
    run = glidecal("export", session, "--format", "linuxcnc", "-o", tmp_path)
    assert run.status == 0
    assert "nobody stated the present HOME_OFFSET" in run.err


def test_lengths_do_not_fit_into_home_offset(session: Path, tmp_path: Path) -> None:
    said = refused(
        2, "export", session, "--format", "linuxcnc", "--subset", "both", "-o", tmp_path / "x"
    )
    assert "HOME_OFFSET cannot hold a length" in said
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("HOME_OFFSET = 12.3 # note", "no comment behind it"),
        ("HOME_OFFSET = 0,04", "decimal point"),
        ("", "found nothing"),
    ],
)
def test_bad_ini(session: Path, tmp_path: Path, line: str, said: str) -> None:
    ini = tmp_path / "m.ini"
    ini.write_text(f"[JOINT_0]\n{line}\n")
    assert said in refused(
        3, "export", session, "--format", "linuxcnc", "--ini", ini, "-o", tmp_path
    )


def test_json_and_csv_agree(session: Path, tmp_path: Path) -> None:
    for kind in ("json", "csv"):
        assert glidecal("export", session, "--format", kind, "-o", tmp_path / kind).status == 0
    document = json.loads((tmp_path / "json").read_text(encoding="utf-8"))
    assert document["schema"] == "glidecal.offsets/1"
    with (tmp_path / "csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["parameter"] for row in rows] == list(document["parameters"])
    for row in rows:
        entry = document["parameters"][row["parameter"]]
        assert float(row["value_mm"]) == pytest.approx(entry["value"], abs=1e-6)
        assert float(row["standard_uncertainty_mm"]) == pytest.approx(
            entry["standard_uncertainty"], abs=1e-6
        )


def test_export_of_a_model(tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    text = '{"schema": "glidecal.model/1", "parameters_mm": {"d_rho_y": 0.5}}'
    model.write_text(text)
    run = glidecal(
        "export", model, "--format", "linuxcnc", "--home-offset", "1,1,1", "-o", tmp_path
    )
    assert run.status == 0, run.err
    assert "HOME_OFFSET = 1.500000" in (tmp_path / "calib_joint1.inc").read_text()


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "nan,0,0", ""])
def test_bad_home_offset(session: Path, tmp_path: Path, text: str) -> None:
    said = refused(
        2, "export", session, "--format", "linuxcnc", "--home-offset", text, "-o", tmp_path
    )
    assert "three numbers" in said
