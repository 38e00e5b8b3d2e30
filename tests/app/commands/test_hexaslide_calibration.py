"""A simulated calibration of a Hexa Slide on the command line."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli import cli
from app.evaluating.hexaslide_calibration import calibrate_file
from app.exit_codes import exit_code
from app.machines.hexaslide import reads
from app.planning.hexaslide import Request, write_simulated
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_calibration import calibration_text, caveats
from calib.errors import GlidecalError, NotIdentifiable, RecordError, UsageError
from calib.hexaslide.geometry import forward
from protocols.hexaslide import load_hexaslide, read_measurements, read_truth
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, ROOT

H60_FILE = ROOT / "protocols" / "machines" / "hexaslide-h60.toml"
SIMULATE = ("simulate", "--machine", "hexaslide", "--procedure")


class Other(TypedDict, total=False):
    """What a test asks for beyond procedure and count."""

    seed: int
    measured: tuple[str, ...]
    machine_file: Path


def written(
    folder: Path,
    procedure: str,
    postures: int,
    noise_mm: float = 0.01,
    angle_noise_mrad: float | None = None,
    **changes: Unpack[Other],
) -> tuple[Path, Path]:
    """Measurements and truth, in new files."""
    path, truth = folder / f"{procedure}.json", folder / f"{procedure}-truth.json"
    request = replace(Request(procedure, postures=postures, seed=1), **changes)
    write_simulated(request, path, truth, noise_mm=noise_mm, angle_noise_mrad=angle_noise_mrad)
    return path, truth


def told(status: int, *arguments: str | Path) -> str:
    """The error of a command that ends with this status, without a process of its own."""
    run = CliRunner().invoke(cli, [*map(str, arguments)])
    problem = run.exception
    assert isinstance(problem, GlidecalError), run.output
    assert (exit_code(problem), run.output) == (status, "")
    return str(problem)


def document(path: Path, truth: Path | None = None, share: float = 0.2) -> dict[str, Any]:
    result = calibrate_file(path, truth, share)
    return HexaSlideCalibrationReport.of(result).model_dump(mode="json")


def test_simulate_and_solve_as_a_person_would(tmp_path: Path) -> None:
    path, truth = tmp_path / "m.json", tmp_path / "truth.json"
    simulation = glidecal(
        *SIMULATE, "position", "--postures", "40", "--noise", "0.01", "--seed", "3",
        "-o", path, "--truth", truth,
    )  # fmt: skip
    assert (simulation.status, simulation.out) == (0, "")
    assert "40 simulated postures of hexaslide-h60, position" in simulation.err
    run = glidecal("solve", path, "--truth", truth, "--json")
    assert run.status == 0, run.err
    report = json.loads(run.out)
    assert report["schema"] == "glidecal.hexaslide-calibration/1"
    assert (report["rank"], report["parameter_count"], report["lost_count"]) == (46, 49, 3)
    assert report == document(path, truth)
    printout = glidecal("solve", path, "--machine", "hexaslide")
    assert printout.status == 0
    assert "46 of 49 combinations of the parameters identified" in printout.out.replace("\n", " ")
    assert max(map(len, printout.out.splitlines())) <= 80


PLACES = {"B": ("joint_mm", "joint"), "A": ("start_mm", "start"), "a": ("rail", "rail")}
"""Of the letter of a parameter its key in the machine file and its pin; ``l`` is a number alone."""


@pytest.mark.parametrize(("procedure", "postures", "count"), [("position", 40, 31)])
def test_what_is_printed_is_what_is_written(
    procedure: str, postures: int, count: int, tmp_path: Path
) -> None:
    """Each printed value against machine.toml and calib.hal, to the last digit that is printed."""
    path, _ = written(tmp_path, procedure, postures)
    folder = tmp_path / "out"
    run = glidecal("solve", path, "--corrected", folder)
    assert run.status == 0, run.err
    chains = tomllib.loads((folder / "machine.toml").read_text())["chain"]
    hal = (folder / "calib.hal").read_text()
    pins = dict(re.findall(r"^setp hexaslidekins\.(\S+) (\S+)", hal, re.MULTILINE))
    rows = re.findall(r"^ *([BAal])([xyz]?)([1-6]) +(-?[\d.]+) ", run.out, re.MULTILINE)
    assert len(rows) == count
    for letter, axis, chain, figure in rows:
        file = chains[int(chain) - 1]
        key, pin = PLACES.get(letter, ("link_mm", "link"))
        value = file[key] if letter == "l" else file[key]["xyz".index(axis)]
        in_thousandths = 1000.0 if letter == "a" else 1.0  # directions have no unit
        assert in_thousandths * value == pytest.approx(float(figure), abs=5.01e-5)
        pinned = float(pins["-".join(filter(None, (pin, str(int(chain) - 1), axis)))])
        assert pinned == pytest.approx(value, rel=1e-12)


@LONG
@pytest.mark.parametrize(
    ("procedure", "postures", "rank", "known_count"),
    [
        ("pose-inverse", 30, 49, 49),
        ("pose-forward", 30, 49, 49),
        ("position", 40, 46, 31),
        ("constraint-link", 120, 48, 18),
    ],
)
def test_every_procedure_end_to_end(
    procedure: str, postures: int, rank: int, known_count: int, tmp_path: Path
) -> None:
    path, truth = written(tmp_path, procedure, postures)
    report = document(path, truth)
    assert (report["rank"], len(report["individually_known"])) == (rank, known_count)
    assert report["converged"]
    assert report["steps"] <= 12
    assert report["rms_after"]["length_mm"] < 0.015
    assert report["rms_before"]["length_mm"] > 0.3
    check = report["held_out"]
    assert check["rms_after"]["length_mm"] < 0.05
    assert check["rms_before"]["length_mm"] > 0.3
    assert report["postures"]["fitted"] + len(report["postures"]["held_out"]) == postures
    assert len(report["postures"]["held_out"]) == postures // 5
    true = report["truth"]
    gain = 0.6 if procedure == "constraint-link" else 0.1
    assert true["after"]["position_rms_mm"] < gain * true["before"]["position_rms_mm"]
    assert 0.7 * known_count <= true["individually_known_within_95_percent"] <= known_count
    assert report["lack_of_fit"]["p_value"] > 0.001
    for name, row in report["parameters"].items():
        certain = row["expanded_uncertainty"]
        assert (certain is None) == (name not in report["individually_known"])


def test_the_file_says_nothing_of_the_truth(tmp_path: Path) -> None:
    path, truth = written(tmp_path, "pose-forward", 12)
    measured = read_measurements(path)
    assert measured.machine == load_hexaslide()
    true = read_truth(truth, measured)
    text = path.read_text(encoding="utf-8")
    for chain, nominal in zip(true.chain, measured.machine.chain, strict=True):
        assert chain.link_mm != nominal.link_mm
        assert repr(chain.link_mm) not in text
    header = json.loads(text)
    assert header["units"] == {"length": "m", "angle": "rad"}
    assert header["noise"] == {"length_mm": 0.01, "angle_mrad": 0.01}
    assert (header["procedure"], header["machine_file"]) == ("pose-forward", "hexaslide-h60.toml")


def test_readings_are_of_the_true_machine_with_the_stated_noise(tmp_path: Path) -> None:
    path, truth = written(tmp_path, "pose-forward", 200, angle_noise_mrad=0.05)
    measured = read_measurements(path)
    true = read_truth(truth, measured)
    readings = measured.readings()
    stands = forward(true.whole().geometry, readings.sliders, true.whole().box)
    noise = readings.measured - stands
    assert noise[:, :3].std() == pytest.approx(1e-5, rel=0.15)
    assert noise[:, 3:].std() == pytest.approx(5e-5, rel=0.15)
    nominal = forward(measured.machine.whole().geometry, readings.sliders, true.whole().box)
    assert np.abs(readings.measured - nominal).max() > 1e-3


def test_without_noise_the_truth_comes_back_through_the_files(tmp_path: Path) -> None:
    path, truth = written(tmp_path, "pose-inverse", 30, noise_mm=0.0)
    report = document(path, truth)
    assert report["noise"]["source"] == "residuals"
    assert report["truth"]["individually_known_worst"] < 1e-11
    chain = read_truth(truth, read_measurements(path)).chain[2]
    assert report["parameters"]["l3"]["value"] == pytest.approx(chain.link_mm / 1000.0, abs=1e-11)


def test_words_of_what_is_lost_left_and_checked(tmp_path: Path) -> None:
    path, truth = written(tmp_path, "position", 40)
    result = calibrate_file(path, truth, 0.25)
    text = calibration_text(result).replace("\n", " ")
    fit = HexaSlideCalibrationReport.of(result).model_dump(mode="json")
    assert (
        "NOT IDENTIFIABLE, left as the machine file has it: platform frame turned about its X; "
        "platform frame turned about its Y; platform frame turned about its Z." in text
    )
    assert (
        f"Condition number {fit['condition_number']:.4g} of the identifiable combinations (metres"
        in text
    )
    assert "Check on 10 of 40 postures (25 %), kept out of the fit:" in text
    assert "glidecal diagnose looks for what the parameters do not have" in text
    assert f"platform frame turned by {fit['truth']['after']['platform_frame_turned_mrad']:.3g}"\
        in text  # fmt: skip
    assert fit["residuals"]["effects"] == []
    assert sum(row["share"] for row in fit["residuals"]["by_component"]) == pytest.approx(1.0)
    assert sum(row["share"] for row in fit["residuals"]["by_posture"]) == pytest.approx(1.0)
    assert [row["component"] for row in fit["residuals"]["by_component"]] == ["x", "y", "z"]


def test_what_was_said_without_noise_or_check(tmp_path: Path) -> None:
    path, _ = written(tmp_path, "constraint-link", 48, noise_mm=0.0)
    text = calibration_text(calibrate_file(path, None, 0.2)).replace("\n", " ")
    assert "WARNING: no noise is stated and nothing is left over to show it" in text
    assert "No posture was kept out of the fit as a check." in text
    assert "± U" in text
    assert "unknown" in text
    assert "Against the truth" not in text


def test_values_and_lengths_are_of_all_postures_also_without_a_stated_noise(tmp_path: Path) -> None:
    path, _ = written(tmp_path, "position", 40)
    content = json.loads(path.read_text(encoding="utf-8"))
    content["noise"] = {"length_mm": 0.0, "angle_mrad": 0.0}
    path.write_text(json.dumps(content), encoding="utf-8")
    checked, whole = document(path, None, 0.25), document(path, None, 0.0)
    assert (checked["postures"]["fitted"], whole["postures"]["fitted"]) == (30, 40)
    for name, parameter in checked["parameters"].items():
        if name.startswith("l"):
            assert checked["inner_lengths"][name]["value_m"] == parameter["value"]
    assert checked["parameters"] == whole["parameters"]
    assert checked["inner_lengths"] == whole["inner_lengths"]
    assert checked["platform"] == whole["platform"]
    text = calibration_text(calibrate_file(path, None, 0.25)).replace("\n", " ")
    assert "Values and bound above are of these postures, too." in text


@LONG
def test_lengths_to_enter_that_are_none_of_the_machine_are_said(tmp_path: Path) -> None:
    """A scale of a rail, which the machine file cannot hold, is in what is entered instead."""
    path, _ = written(tmp_path, "position", 60)
    assert "are not lengths of the machine" not in calibration_text(calibrate_file(path, None, 0.0))
    content = json.loads(path.read_text(encoding="utf-8"))
    for posture in content["postures"]:
        posture["sliders"][2] /= 1.0005
    path.write_text(json.dumps(content), encoding="utf-8")
    report = document(path, None, 0.0)
    text = calibration_text(calibrate_file(path, None, 0.0)).replace("\n", " ")
    words = re.search(r"\(glidecal diagnose\), so (.*?) are not lengths of the machine", text)
    for k in range(1, 7):
        entered, length = report["parameters"][f"l{k}"], report["inner_lengths"][f"l{k}"]
        far = abs(entered["value"] - length["value_m"]) > length["expanded_uncertainty_m"]
        assert words is not None
        assert far == (f"l{k}" in words[1])


def test_a_wrong_reading_is_located_and_left_out(tmp_path: Path) -> None:
    path, _ = written(tmp_path, "pose-inverse", 30)
    content = json.loads(path.read_text(encoding="utf-8"))
    content["postures"][6]["sliders"][3] += 0.002
    path.write_text(json.dumps(content), encoding="utf-8")
    report = document(path, None, 0.0)
    assert report["postures"]["left_out"] == [7]
    assert report["lack_of_fit"]["p_value"] > 0.001
    del content["postures"][6]
    path.write_text(json.dumps(content), encoding="utf-8")
    alone = document(path, None, 0.0)
    assert alone["postures"]["left_out"] == []
    for name, parameter in report["parameters"].items():
        assert parameter["value"] == pytest.approx(alone["parameters"][name]["value"], abs=1e-9)


@LONG
def test_many_wrong_readings_are_warned_of(tmp_path: Path) -> None:
    """More than can be told apart: none is left out, and what is left says so."""
    path, _ = written(tmp_path, "pose-inverse", 30)
    content = json.loads(path.read_text(encoding="utf-8"))
    for row in range(0, 30, 3):
        content["postures"][row]["sliders"][row % 6] += 0.002
    path.write_text(json.dumps(content), encoding="utf-8")
    report = document(path, None, 0.0)
    assert report["lack_of_fit"]["p_value"] < 1e-6
    assert "WARNING: what is left is" in calibration_text(calibrate_file(path, None, 0.0))


@LONG
def test_a_measured_subset_and_a_machine_of_ones_own(tmp_path: Path) -> None:
    path, truth = written(tmp_path, "pose-forward", 40, measured=("x", "y", "z", "theta"))
    report = document(path, truth)
    assert (report["rank"], report["lost_motions"]) == (48, ["platform frame turned about its Z"])
    text = (ROOT / "protocols/machines/hexaslide-h60.toml").read_text("utf-8")
    machine_path = tmp_path / "own.toml"
    machine_path.write_text(text.replace("link_mm = 880.0", "link_mm = 900.0", 1), encoding="utf-8")
    path, _ = written(tmp_path, "pose-inverse", 30, machine_file=machine_path)
    assert read_measurements(path).machine_file == "own.toml"
    assert document(path)["parameters"]["l1"]["nominal"] == 0.9


def test_few_postures_are_all_fitted(tmp_path: Path) -> None:
    path, truth = written(tmp_path, "pose-inverse", 13)
    report = document(path, truth)
    assert report["postures"]["held_out"] == []
    assert (report["held_out"], report["truth"]["postures"]) == (None, "all")


Damage = Callable[[str], str]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: text[: len(text) // 2], "no JSON text: EOF"),
        (lambda text: text[:390], "no JSON text: EOF"),
        (lambda text: text.replace('"length": "m"', '"length": "mm"'), "must be 'm'"),
        (lambda text: text.replace('"position"', '"sideways"'), "'pose-inverse', 'pose-forward'"),
        (lambda text: text.replace('"values":[', '"values":[0.0,'), "has 4 values, 3 are measured"),
        (
            lambda text: text.replace('{"sliders":[0', '{"sliders":[NaN, 0'),
            "posture 1.sliders",
        ),
        (lambda text: text.replace('["x", "y", "z"]', '["x", "y", "y"]'), "different ones of x"),
        (lambda text: text.replace('"length_mm": 0.01', '"length_mm": 0.0'), "both 0 (not known)"),
        (lambda text: text.replace("measurements/1", "measurements/2"), "measurements/1'"),
        (lambda text: text.replace('"seed"', '"sead"'), "sead: no such key"),
    ],
    ids=["half", "head", "unit", "procedure", "extra", "nan", "twice", "noise", "schema", "key"],
)
def test_a_damaged_file_is_one_paragraph(damage: Damage, message: str, tmp_path: Path) -> None:
    path, _ = written(tmp_path, "position", 20)
    path.write_text(damage(path.read_text(encoding="utf-8")), encoding="utf-8")
    assert reads(path)
    with pytest.raises(RecordError) as caught:
        calibrate_file(path, None, 0.2)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


def test_a_value_that_is_no_number_is_named_by_its_place(tmp_path: Path) -> None:
    path, _ = written(tmp_path, "position", 20)
    lines = path.read_text(encoding="utf-8").split('{"sliders":[')
    lines[3] = "NaN" + lines[3][lines[3].index(",") :]
    path.write_text('{"sliders":['.join(lines), encoding="utf-8")
    message = refused(3, "solve", path)
    assert "posture 3.sliders.0: must be a finite number (found nan)" in message


def test_too_few_and_impossible_postures_are_exit_5(tmp_path: Path) -> None:
    path, _ = written(tmp_path, "position", 15)
    assert "found 15. Allowed: 16 or more" in told(5, "solve", path)
    path, _ = written(tmp_path, "pose-forward", 20)
    content = json.loads(path.read_text(encoding="utf-8"))
    content["postures"][4]["sliders"][0] = 3.0
    path.write_text(json.dumps(content), encoding="utf-8")
    message = refused(5, "solve", path)
    assert "posture 5" in message
    assert "metres and radians" in message


def test_postures_all_alike_are_refused(tmp_path: Path) -> None:
    """Twenty times the same posture shows six combinations of 49."""
    path, _ = written(tmp_path, "pose-forward", 20)
    content = json.loads(path.read_text(encoding="utf-8"))
    content["postures"] = content["postures"][:1] * 20
    path.write_text(json.dumps(content), encoding="utf-8")
    message = refused(5, "solve", path)
    assert "different postures for pose-forward: found 1. Allowed: 9 or more" in message


def test_combinations_that_are_no_motion_of_a_frame_are_told(tmp_path: Path) -> None:
    result = calibrate_file(written(tmp_path, "position", 24)[0], None, 0.0)
    frames = HexaSlideCalibrationReport.of(result)
    more = frames.model_copy(update={"lost_count": 5})
    assert "NOT IDENTIFIABLE: 2 more combinations" in "\n".join(caveats(more))
    assert "more combinations" not in "\n".join(caveats(frames))


@LONG
def test_postures_of_a_file_are_measured(tmp_path: Path) -> None:
    """The best postures show more than as many random ones, and those of a file are taken."""
    box = load_hexaslide(None).whole().box
    corners = box.lower + (box.upper - box.lower) * (np.arange(64)[:, None] >> np.arange(6) & 1)
    subset = np.random.default_rng(4).permutation(corners)[:24]
    subset[:, 3:] = np.degrees(subset[:, 3:])
    table = tmp_path / "corners.csv"
    header = "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg"
    np.savetxt(table, subset, fmt="%.17g", delimiter=",", header=header, comments="")
    file, truth = tmp_path / "m.json", tmp_path / "t.json"
    write_simulated(Request("position", posture_file=table, seed=1), file, truth, errors_mm=0.5)
    values = np.array([posture.values for posture in read_measurements(file).postures])
    assert np.abs(values - subset[:, :3]).max() < 0.05, "where the true machine stands, metres"
    with_random = document(*written(tmp_path, "position", 24), share=0.0)
    report = document(file, truth, share=0.0)
    assert report["condition_number"] < 0.7 * with_random["condition_number"]


def test_postures_that_cannot_be_measured_are_refused(tmp_path: Path) -> None:
    table, out = tmp_path / "far.csv", tmp_path / "out.json"
    header = "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg\n"
    table.write_text(f"{header}0,-0.8,-1.15,0,0,0\n9,0,0,0,0,0\n", encoding="utf-8")
    options = ("--posture-file", table, "-o", out)
    assert "posture 2, x_m: found 9" in told(3, *SIMULATE, "position", *options)
    assert "--posture-file" in told(2, *SIMULATE, "position", "--postures", "20", *options)
    table.write_text(f"{header}0.29,-0.55,-1.15,0,0,0\n", encoding="utf-8")
    short = tmp_path / "short.toml"
    text = H60_FILE.read_text(encoding="utf-8")
    short.write_text(text.replace("length_mm = 550.0", "length_mm = 300.0"), encoding="utf-8")
    link = ("constraint-link", *options, "--machine-file", short)
    assert "posture 1: found a constraint link of 300 mm" in told(5, *SIMULATE, *link)
    assert not out.exists()


def test_minus_zero_is_zero(tmp_path: Path) -> None:
    """Before: a traceback."""
    names = ("plus.json", "minus.json")
    for name, errors in zip(names, ("0", "-0"), strict=True):
        options = ("--postures", "20", f"--errors={errors}", "-o", tmp_path / name)
        assert glidecal(*SIMULATE, "position", *options).status == 0
    assert len({(tmp_path / name).read_bytes() for name in names}) == 1


def test_options_of_the_wrong_machine_are_exit_2(tmp_path: Path) -> None:
    path, truth = written(tmp_path, "position", 20)
    out = tmp_path / "out.json"
    arguments = ("position", "--postures", "20", "-o", out)
    assert "--procedure, --postures" in told(2, *SIMULATE, "position", "-o", out)
    assert "--scatter" in told(2, *SIMULATE, *arguments, "--scatter", "0.1")
    assert "'sideways'" in told(2, *SIMULATE, "sideways", "--postures", "9", "-o", out)
    assert "--angle-noise" in told(2, *SIMULATE, *arguments, "--noise", "0", "--angle-noise", "1")
    assert "--noise: found the machine orthoglide. Allowed: the machine hexaslide" in told(
        2, "simulate", "--noise", "1", "-o", out
    )
    assert "--subset" in told(2, "solve", path, "--subset", "both")
    assert "2 files" in told(2, "solve", path, truth, "--machine", "hexaslide")
    for name in ("tripod", "linear-delta"):  # before: a session of an Orthoglide took it, in vain
        session = "sample_sessions/experiment_1_six.jsonl"
        message = told(2, "solve", session, "--machine", name)
        assert f"'{name}'. Allowed: hexaslide, or none: a session names its machine" in message
    assert "--truth" in told(2, "solve", "sample_sessions/experiment_1_six.jsonl", "--truth", truth)
    assert not out.exists()


def test_files_are_neither_overwritten_nor_mixed_up(tmp_path: Path) -> None:
    path, truth = written(tmp_path, "position", 20)
    before = path.read_bytes()
    arguments = ("position", "--postures", "20", "--seed", "9")
    assert "is there already" in told(2, *SIMULATE, *arguments, "-o", path)
    second = tmp_path / "other.json"
    assert "is there already" in told(2, *SIMULATE, *arguments, "-o", second, "--truth", truth)
    assert "two files" in told(2, *SIMULATE, *arguments, "-o", second, "--truth", second)
    assert path.read_bytes() == before
    assert not second.exists()
    write_simulated(Request("position", postures=20, seed=9), second, None)
    with pytest.raises(RecordError, match="the truth of other measurements"):
        calibrate_file(second, truth, 0.2)
    with pytest.raises(RecordError, match="truth file"):
        calibrate_file(path, second, 0.2)
    missing = tmp_path / "missing.json"
    assert "No such file" in told(3, "solve", missing, "--machine", "hexaslide")


def test_the_seed_decides_everything(tmp_path: Path) -> None:
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
    first, _ = written(tmp_path / "first", "constraint-link", 60, seed=4)
    second, _ = written(tmp_path / "second", "constraint-link", 60, seed=4)
    assert first.read_bytes() == second.read_bytes()
    third, _ = written(tmp_path, "constraint-link", 60, seed=5)
    assert third.read_bytes() != first.read_bytes()


def test_simulating_what_cannot_be_is_told(tmp_path: Path) -> None:
    text = (ROOT / "protocols/machines/hexaslide-h60.toml").read_text("utf-8")
    machine_path = tmp_path / "own.toml"
    machine_path.write_text(text[: text.index("[constraint_link]")], encoding="utf-8")
    with pytest.raises(UsageError, match="constraint_link"):
        written(tmp_path, "constraint-link", 60, machine_file=machine_path)
    path, _ = written(tmp_path, "position", 8)
    with pytest.raises(NotIdentifiable, match="16 or more"):
        calibrate_file(path, None, 0.0)
