"""``glidecal postures hexaslide``: options, files, words and documents."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.planning.hexaslide import Request, asked_postures
from app.report.schema.hexaslide import HexaSlidePosturesReport
from app.report.text.hexaslide import PUBLISHED_WORDS, postures_text
from calib.design.criteria import Criterion
from calib.errors import NotIdentifiable, RecordError, UsageError
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.procedures import Procedure
from calib.hexaslide.search import Search
from protocols.hexaslide import load_hexaslide, load_postures
from tests.app.cli import glidecal, refused
from tests.conftest import LONG

VERB = ("postures", "hexaslide", "--procedure", "pose-inverse")
H60 = load_hexaslide()


def random_file(folder: Path, count: int, *, factor: float = 1.0) -> Path:
    box = H60.whole().box
    postures = box.random(count, np.random.default_rng(11))
    postures = box.centre + factor * (postures - box.centre)
    postures[:, 3:] = np.degrees(postures[:, 3:])
    path = folder / "given.csv"
    header = "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg"
    np.savetxt(path, postures, "%.15g", ",", header=header, comments="")
    return path


def condition(path: Path) -> float:
    rows = jacobian(Procedure.of("pose-inverse"), H60.whole().geometry, load_postures(path))
    return float(np.linalg.cond(rows.reshape(-1, 49)))


def test_found_postures_are_written_and_can_be_judged(tmp_path: Path) -> None:
    path = tmp_path / "found.csv"
    run = glidecal(*VERB, "--count", "9", "--starts", "1", "--seed", "2", "-o", path, "--json")
    assert run.status == 0, run.err
    assert f"postures written to {path}" in run.err
    report = json.loads(run.out)
    assert (report["criterion"], report["starts"], report["seed"]) == ("condition", 1, 2)
    assert report["source"] == "random"
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg"
    assert len(lines) == 1 + report["count"] == 10
    assert condition(path) == pytest.approx(report["condition_number"], rel=1e-6)
    run = glidecal(*VERB, "--posture-file", path, "--as-is", "--json")
    judged = json.loads(run.out)
    assert judged["condition_number"] == pytest.approx(report["condition_number"], rel=1e-6)
    assert (judged["starts"], judged["source"]) == (0, str(path))
    assert judged["coordinates_on_bound"] == report["coordinates_on_bound"]


@LONG
def test_a_file_is_the_first_start(tmp_path: Path) -> None:
    path = random_file(tmp_path, 10)
    request = Request("pose-inverse", posture_file=path)
    postures = asked_postures(request, None, Search(Criterion.SMALLEST_SINGULAR_VALUE, starts=2))
    assert len(postures.values) == 2
    assert postures.coordinates.shape == (10, 6)
    text = postures_text(postures).replace("\n", " ")
    assert f"Best of 2 starts, the first of them {path}" in text.replace("  ", " ")
    alone = asked_postures(request, 10, Search(starts=1))
    assert alone.start_condition_number == pytest.approx(condition(path), rel=1e-6)
    assert alone.condition_number < condition(path)
    assert f"One start, {path}, seed 0" in postures_text(alone).replace("\n", " ")


def test_words_tell_before_after_spread_bounds_and_seed() -> None:
    postures = asked_postures(
        Request("pose-inverse", seed=5), 9, Search(Criterion.DETERMINANT, starts=3)
    )
    text, document = (
        postures_text(postures).replace("\n", " "),
        HexaSlidePosturesReport.of(postures),
    )
    values = document.values_of_starts
    assert f"({min(values):.4g} to {max(values):.4g}, median {sorted(values)[1]:.4g})" in text
    assert "seed 5" in text
    share = 100.0 * document.coordinates_on_bound / 54
    assert f"{share:.0f} % of the coordinates are on a bound of the box, at the start 0 %" in text
    assert all(words in text for words in PUBLISHED_WORDS.values())
    assert f"at the start {document.start_condition_number:.4g}" in text
    before, after = document.start_published_criteria, document.published_criteria
    assert set(vars(before)) == set(vars(after)) == set(PUBLISHED_WORDS)
    assert after.log10_determinant > before.log10_determinant
    assert document.value == max(values) > document.start_value


@LONG
def test_what_is_measured_decides_what_is_seen(tmp_path: Path) -> None:
    verb = ("postures", "hexaslide", "--procedure", "pose-forward", "--starts", "1")
    run = glidecal(*verb, "--measured", "x,y,z,theta", "--count", "12", "--json")
    report = json.loads(run.out)
    assert (report["rank"], report["measured"]) == (48, ["x", "y", "z", "theta"])
    assert report["condition_number"] < report["start_condition_number"]
    few = refused(5, *verb, "--measured", "x,y,z,theta", "--count", "11")
    assert "found 11. Allowed: 12 or more" in few
    linked = ("postures", "hexaslide", "--procedure", "constraint-link")
    path = random_file(tmp_path, 60)
    run = glidecal(*linked, "--known", "none", "--posture-file", path, "--as-is")
    assert "of the 49 combinations that are identifiable" in run.out.replace("\n", " ")
    assert "Best of" not in run.out


def test_options_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path, request = random_file(tmp_path, 9), Request("pose-inverse")
    request_of_file = Request("pose-inverse", posture_file=path)
    with pytest.raises(UsageError, match="--as-is: found no --posture-file"):
        asked_postures(request, 9, as_is=True)
    with pytest.raises(UsageError, match="--count: found none"):
        asked_postures(request, None, Search(starts=1))
    with pytest.raises(UsageError, match=r"--count: found 10\. Allowed: 9 as in the posture file"):
        asked_postures(request_of_file, 10, Search(starts=1))
    with pytest.raises(UsageError, match="1000 postures at most"):
        asked_postures(request, 1001, Search(starts=1))
    with pytest.raises(UsageError, match=r"tool-variance\. Allowed: the other five"):
        asked_postures(request_of_file, None, Search(Criterion.TOOL_VARIANCE))
    with pytest.raises(NotIdentifiable, match="9 or more for pose-inverse"):
        asked_postures(request, 8, Search(starts=1))
    outside = Request("pose-inverse", posture_file=random_file(tmp_path, 9, factor=1.2))
    with pytest.raises(RecordError, match=r"posture \d+, \w+: found .* the machine's box.*--as-is"):
        asked_postures(outside, None, Search(starts=1))
    assert asked_postures(outside, None, as_is=True).values == ()


def test_refusals_on_the_command_line(tmp_path: Path) -> None:
    assert "determinant" in refused_by_typer(*VERB, "--count", "9", "--criterion", "speed")
    assert "the machine orthoglide" in refused(2, *VERB, "--count", "9", "--repeats")
    message = refused(2, *VERB, "--count", "9", "-o", "out.toml")
    assert "found out.toml. Allowed: a path that ends with .csv" in message
    missing = tmp_path / "missing.csv"
    assert "No such file" in refused(3, *VERB, "--posture-file", missing)
    arguments = ("postures", "orthoglide", "--procedure", "verify")
    assert "--count: found none" in refused(2, *arguments)
    assert "--as-is: found the machine orthoglide" in refused(
        2, *arguments, "--count", "9", "--as-is"
    )
    assert "the machine hexaslide" in refused(
        2, *arguments, "--count", "9", "--posture-file", missing
    )
    refusal = refused(2, *VERB, "--count", "9", "--mounting-seconds", "60")
    assert "--mounting-seconds: found the machine hexaslide" in refusal
    seed = ("identifiability", "orthoglide", "--seed", "3")
    assert "--seed: found the machine orthoglide. Allowed: the machine hexaslide" in refused(
        2, *seed
    )


def refused_by_typer(*arguments: str) -> str:
    run = glidecal(*arguments)
    assert run.status == 2
    assert "Traceback" not in run.err
    return run.err


def test_a_box_outside_the_workspace_is_refused(tmp_path: Path) -> None:
    from importlib import resources

    text = (resources.files("protocols") / "machines" / "hexaslide-h60.toml").read_text("utf-8")
    path = tmp_path / "own.toml"
    path.write_text(
        text.replace("x_mm = [-300.0, 300.0]", "x_mm = [-2000.0, 300.0]"), encoding="utf-8"
    )
    message = refused(3, *VERB, "--count", "9", "--machine-file", path)
    assert "does not reach its rail" in message
