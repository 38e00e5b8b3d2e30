"""Tolerance, maps and Monte Carlo behind ``glidecal solve``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.evaluating.solution import solve_files
from app.report.text.result import view_parts
from app.report.text.tables import paragraphs
from calib.identify.solution import SUBSETS
from tests.app.cli import glidecal, refused
from tests.conftest import LONG


def test_another_set_comes_from_the_choice_and_tells_what_a_solution_of_its_own_tells(
    samples: Path,
) -> None:
    session = samples / "experiment_2_twelve.jsonl"
    solved = solve_files([session])
    for subset in SUBSETS:
        view, alone = solved.with_subset(subset), solve_files([session], subset=subset)
        assert view.solution is solved.choice.solutions[subset]
        assert paragraphs(*view_parts(view)) == paragraphs(*view_parts(alone))
        assert view.corrections is solved.corrections


@LONG
def test_everything_at_once(samples: Path) -> None:
    session = samples / "simulated_zero-max-min.jsonl"
    arguments = ("--tolerance", "0.08", "--map", "--monte-carlo", "3000")
    run = glidecal("solve", session, "--json", *arguments)
    assert run.status == 0, run.err
    solution = json.loads(run.out)
    assert solution["tolerance"] == {"tolerance_mm": 0.08, "before": "fail", "after": "pass"}
    assert [len(tool_map["error_mm"]) for tool_map in solution["tool_maps"]] == [5, 5, 5]
    centre = solution["tool_maps"][0]["error_mm"][2][2]
    assert 0.0 < centre < 0.05
    checked = solution["monte_carlo"]
    assert checked["failed"] == 0
    for parameter in checked["parameters"].values():
        assert 0.93 < parameter["covered"] < 0.97
        assert parameter["stated_mm"] == pytest.approx(parameter["true_mm"], rel=0.08)
    text = glidecal("solve", session, *arguments).out
    assert "pass with these values" in " ".join(text.split())
    assert "3000 simulated sessions" in text


@LONG
def test_a_guard_band_leaves_some_undecided(samples: Path) -> None:
    """Between what 95 of 100 machines exceed and what 95 of 100 keep nothing is decided."""
    session = samples / "experiment_2_twelve.jsonl"
    off = solve_files([session]).correction.off
    tolerance = str((off.least_mm["touched-off"] + off.bound_mm["touched-off"]) / 2.0)
    run = glidecal("solve", session, "--tolerance", tolerance)
    assert "undecided with these values" in " ".join(run.out.split())


def test_a_stated_noise_is_simulated_as_stated(samples: Path) -> None:
    session = samples / "experiment_2_twelve.jsonl"
    run = glidecal("solve", session, "--json", "--monte-carlo", "4000")
    solution = json.loads(run.out)
    for name, parameter in solution["monte_carlo"]["parameters"].items():
        stated = solution["parameters"][name]["standard_uncertainty"]
        assert parameter["stated_mm"] == pytest.approx(stated, rel=1e-3)
        assert parameter["true_mm"] == pytest.approx(stated, rel=0.04)
        assert 0.935 < parameter["covered"] < 0.965


def test_rounding_is_simulated_too(tmp_path: Path) -> None:
    """Repeats that agree on a coarse display: their scatter alone would promise far too much."""
    session = tmp_path / "s.jsonl"
    arguments = ("--protocol", "zero-max-min", "--resolution", "0.01", "--scatter", "0.001")
    assert glidecal("simulate", *arguments, "-o", session).status == 0
    solution = json.loads(glidecal("solve", session, "--json", "--monte-carlo", "4000").out)
    for name, parameter in solution["monte_carlo"]["parameters"].items():
        stated = solution["parameters"][name]["standard_uncertainty"]
        assert parameter["true_mm"] == pytest.approx(stated, rel=0.25)


def test_values_that_help_nobody_are_not_praised(tmp_path: Path) -> None:
    """A machine that has its offsets entered already: what is found is no larger than its worth."""
    needle = "not expected to make the tool more accurate"
    perfect, session = tmp_path / "m.json", tmp_path / "s.jsonl"
    for offset, warning in ((0.0, True), (0.5, False)):
        perfect.write_text(
            json.dumps({"schema": "glidecal.model/1", "parameters_mm": {"d_rho_x": offset}})
        )
        run = glidecal("simulate", "--model", perfect, "-o", session)
        assert run.status == 0, run.err
        text = " ".join(glidecal("solve", session).out.split())
        assert (needle in text) is warning
        session.unlink()


def test_a_tolerance_is_a_positive_length(samples: Path) -> None:
    for wrong in ("0", "-1"):
        message = refused(2, "solve", samples / "experiment_2_twelve.jsonl", f"--tolerance={wrong}")
        assert f"found {wrong} mm. Allowed: a positive length in mm" in " ".join(message.split())
