"""Tolerance, maps and Monte Carlo behind ``glidecal solve``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.app.cli import glidecal, refused


def test_everything_at_once(samples: Path) -> None:
    session = samples / "simulated_zero-max-min.jsonl"
    asked = ("--tolerance", "0.05", "--map", "--monte-carlo", "3000")
    run = glidecal("solve", session, "--json", *asked)
    assert run.status == 0, run.err
    found = json.loads(run.out)
    assert found["tolerance"] == {"tolerance_mm": 0.05, "before": "fail", "after": "pass"}
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


def test_no_repeats_to_simulate_from(samples: Path) -> None:
    session = samples / "experiment_2_twelve.jsonl"
    assert "noise from instrument" in refused(2, "solve", session, "--monte-carlo", "100")
