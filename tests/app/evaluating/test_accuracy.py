"""Tolerance, maps and Monte Carlo behind ``glidecal solve``."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from app.evaluating.solution import solve_files
from app.report.text.result import solution_text
from calib.identify.solution import SUBSETS
from tests.app.cli import glidecal, refused


def test_another_set_comes_from_the_choice_and_tells_what_a_solution_of_its_own_tells(
    samples: Path,
) -> None:
    session = samples / "experiment_2_twelve.jsonl"
    solved = solve_files([session])
    for subset in SUBSETS:
        shown, alone = solved.with_subset(subset), solve_files([session], subset=subset)
        assert shown.solution is solved.choice.solutions[subset]
        assert solution_text(shown) == solution_text(alone)


def test_everything_at_once(samples: Path) -> None:
    session = samples / "simulated_zero-max-min.jsonl"
    asked = ("--tolerance", "0.08", "--map", "--monte-carlo", "3000")
    run = glidecal("solve", session, "--json", *asked)
    assert run.status == 0, run.err
    found = json.loads(run.out)
    assert found["tolerance"] == {"tolerance_mm": 0.08, "before": "fail", "after": "pass"}
    assert [len(one["error_mm"]) for one in found["tool_maps"]] == [5, 5, 5]
    centre = found["tool_maps"][0]["error_mm"][2][2]
    assert 0.0 < centre < 0.05
    checked = found["monte_carlo"]
    assert checked["failed"] == 0
    for one in checked["parameters"].values():
        assert 0.93 < one["covered"] < 0.97
        assert one["stated_mm"] == pytest.approx(one["true_mm"], rel=0.08)
    said = glidecal("solve", session, *asked).out
    assert "with these values it passes" in " ".join(said.split())
    assert "3000 simulated sessions" in said


def test_a_guard_band_leaves_some_undecided(samples: Path) -> None:
    session = samples / "experiment_2_twelve.jsonl"
    found = json.loads(glidecal("solve", session, "--json").out)["tool_error"]["after"]
    tolerance = str(found["rms_mm"] + 0.5 * found["standard_uncertainty_mm"])
    run = glidecal("solve", session, "--tolerance", tolerance)
    assert "with these values it cannot be decided" in " ".join(run.out.split())


def test_a_stated_noise_is_simulated_as_stated(samples: Path) -> None:
    session = samples / "experiment_2_twelve.jsonl"
    run = glidecal("solve", session, "--json", "--monte-carlo", "4000")
    found = json.loads(run.out)
    for name, one in found["monte_carlo"]["parameters"].items():
        stated = found["parameters"][name]["standard_uncertainty"]
        assert one["stated_mm"] == pytest.approx(stated, rel=1e-3)
        assert one["true_mm"] == pytest.approx(stated, rel=0.04)
        assert 0.935 < one["covered"] < 0.965


def test_rounding_is_simulated_too(tmp_path: Path) -> None:
    """Repeats that agree on a coarse display: their scatter alone would promise far too much."""
    session = tmp_path / "s.jsonl"
    asked = ("--protocol", "zero-max-min", "--resolution", "0.01", "--scatter", "0.001")
    assert glidecal("simulate", *asked, "-o", session).status == 0
    found = json.loads(glidecal("solve", session, "--json", "--monte-carlo", "4000").out)
    for name, one in found["monte_carlo"]["parameters"].items():
        stated = found["parameters"][name]["standard_uncertainty"]
        assert one["true_mm"] == pytest.approx(stated, rel=0.25)


def test_the_certificate_says_one_thing_of_the_tool(samples: Path) -> None:
    """First lines, table and document promise the same bound at the tool; it is made of parts."""
    session = samples / "experiment_2_twelve.jsonl"
    found = json.loads(glidecal("solve", session, "--json").out)["tool_bound"]
    said = " ".join(glidecal("solve", session).out.split())
    after, worst = found["after_mm"], found["open"][0]
    assert f"at most {after:.3f} mm with these values" in said
    assert f"up to {after:.3f} mm if {worst['title']} ({worst['id']}, {worst['where']})" in said
    assert f"0.1383 {after:.3f} recommended" in said
    assert found["noise_mm"] < found["parameters_mm"] < after == worst["bound_mm"]


def test_values_that_help_nobody_are_not_praised(samples: Path) -> None:
    """Experiment 3 was measured after correction: its offsets are no larger than their worth."""
    needle = "not expected to make the tool more accurate"
    for name, told in (
        ("experiment_3_twelve", True),
        ("experiment_3_twelve_corrected", True),
        ("experiment_2_twelve", False),
    ):
        said = " ".join(glidecal("solve", samples / f"{name}.jsonl").out.split())
        assert (needle in said) is told
        bounds = re.search(r"at most ([\d.]+) mm now, at most ([\d.]+) mm with", said)
        assert bounds is not None
        assert float(bounds[2]) < float(bounds[1]) or told


def test_a_tolerance_is_a_positive_length(samples: Path) -> None:
    for wrong in ("0", "-1"):
        said = refused(2, "solve", samples / "experiment_2_twelve.jsonl", f"--tolerance={wrong}")
        assert f"found {wrong} mm. Allowed: a positive length in mm" in " ".join(said.split())
