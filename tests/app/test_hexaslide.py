"""The Hexa Slide on the command line."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import pytest

from tests.app.cli import glidecal, refused

VERB = ("identifiability", "hexaslide", "--procedure")


@pytest.mark.parametrize(
    ("procedure", "rank", "count", "published", "fewest"),
    [
        ("pose-inverse", 49, 49, 49, 9),
        ("position", 46, 49, 48, 16),
        ("constraint-link", 48, 55, 46, 48),
    ],
)
def test_ranks_beside_those_of_the_paper(
    procedure: str, rank: int, count: int, published: int, fewest: int
) -> None:
    run = glidecal(*VERB, procedure, "--json")
    assert run.status == 0, run.err
    found = json.loads(run.out)
    assert (found["rank"], found["parameter_count"]) == (rank, count)
    assert (found["published_rank"], found["fewest_postures"]) == (published, fewest)
    assert found["limited_by"] == "nothing"
    assert len(found["lost_directions"]) == count - rank
    assert bool(found["remark"]) == (rank != published)


def test_too_few_postures_say_the_minimum() -> None:
    found = json.loads(glidecal(*VERB, "position", "--postures", "15", "--json").out)
    assert (found["limited_by"], found["rank"]) == ("too-few-postures", 45)
    said = glidecal(*VERB, "position", "--postures", "15").out.replace("\n", " ")
    assert "16 or more are needed" in said


def test_a_measured_tilt_is_seen() -> None:
    said = glidecal(*VERB, "pose-forward", "--measured", "x,y,z,theta").out
    assert "48 of 49 combinations" in said
    assert "NOT SEEN: platform frame turned about its Z." in said


def test_postures_before_and_after() -> None:
    verb = ("postures", "hexaslide", "--procedure", "pose-inverse", "--count", "9")
    found = json.loads(glidecal(*verb, "--criterion", "condition", "--starts", "1", "--json").out)
    assert found["condition_number"] < 60.0 < found["start_condition_number"] / 10.0
    assert len(found["postures"]) == 9
    for name, bound in {"x_m": 0.3, "theta_deg": 15.0, "phi_deg": 30.0}.items():
        assert all(abs(posture[name]) <= bound + 1e-9 for posture in found["postures"])


def test_wrong_input_is_told(tmp_path: Path) -> None:
    few = ("postures", "hexaslide", "--procedure", "position", "--count", "15")
    assert "16 or more" in refused(5, *few)
    assert "different ones of x" in refused(2, *VERB, "position", "--measured", "x,roll")
    assert "pose-inverse" in refused(2, *VERB, "sideways")


def test_a_wrong_machine_file_is_told(tmp_path: Path) -> None:
    text = (resources.files("protocols") / "machines" / "hexaslide-h60.toml").read_text("utf-8")
    path = tmp_path / "own.toml"
    path.write_text(text.replace("rail = [0.0, -0.5", "rail = [0.0, -0.6", 1), encoding="utf-8")
    said = refused(3, *VERB, "position", "--machine-file", path)
    assert "a unit vector" in said
    assert "line " in said
    path.write_text(text.replace("x_m = [-0.3, 0.3]", "x_m = [-2.0, 0.3]"), encoding="utf-8")
    assert "does not reach its rail" in refused(3, *VERB, "position", "--machine-file", path)
