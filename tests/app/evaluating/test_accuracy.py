"""Tolerance, maps and Monte Carlo behind ``glidecal solve``."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.solution import solve_files
from app.report.text.result import view_parts
from app.report.text.tables import paragraphs
from calib.identify.solution import SUBSETS
from protocols.record import read_record
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, ROOT


@LONG
def test_another_set_comes_from_the_choice_and_tells_what_a_solution_of_its_own_tells(
    samples: Path,
) -> None:
    session = samples / "experiment_2_twelve.jsonl"
    result = solve_files([session])
    for subset in SUBSETS:
        view, alone = result.with_subset(subset), solve_files([session], subset=subset)
        assert view.solution is result.choice.solutions[subset]
        assert paragraphs(*view_parts(view)) == paragraphs(*view_parts(alone))
        assert view.corrections is result.corrections


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


@LONG
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


@LONG
@pytest.mark.parametrize(("protocol", "repeats"), [("zero-max-min", True), ("one.toml", False)])
def test_repeats_that_all_agree_are_repeats(tmp_path: Path, protocol: str, repeats: bool) -> None:
    """A simulation without scatter and display. Before: it had "no repeats" in three cycles."""
    shipped = (ROOT / "protocols" / "procedures" / "zero-max-min.toml").read_text(encoding="utf-8")
    once = re.sub(r"(?m)^cycles = \d+", "cycles = 1", shipped)
    (tmp_path / "one.toml").write_text(once, encoding="utf-8")
    session, quiet = tmp_path / "s.jsonl", ("--scatter", "0", "--resolution", "0")
    run = glidecal("simulate", "--protocol", protocol, *quiet, "-o", session, cwd=tmp_path)
    assert run.status == 0, run.err
    solution = json.loads(glidecal("solve", session, "--json").out)
    assert solution["noise"]["repeats_show"] == ("equal" if repeats else "nothing")
    text = " ".join(glidecal("solve", session).out.split())
    assert ("NOTE: all repeats read the same, and there are no stated" in text) is repeats
    assert ("NOTE: there are no repeats, and there are no stated" in text) is not repeats
    text = " ".join(glidecal("diagnose", session).out.split())
    assert "Remark: no scatter of repeats and no stated noise" in text
    assert "no repeats" not in text


@LONG
def test_all_documents_state_one_noise(samples: Path) -> None:
    """Repeats less a steady drift of each set-up, by least squares of all in one.

    Before: solve had 0.00165 mm of 24 degrees of freedom, diagnose 0.00166 mm of 30.
    """
    session = samples / "simulated_zero-max-min.jsonl"
    readings = read_record(session).session.readings
    places: dict[tuple[object, ...], int] = {}
    before: dict[str, float] = {}
    rows = np.zeros((len(readings), 2 * len(readings)))
    mounts = list(dict.fromkeys(reading.mount for reading in readings))
    for number, reading in enumerate(readings):
        at = reading.displacement_mm
        came_from = before.get(reading.mount)  # None: nobody saw it
        upwards = came_from if came_from is None else came_from < at
        before[reading.mount] = at
        place = (reading.mount, at, upwards)
        rows[number, places.setdefault(place, len(places))] = 1.0
        rows[number, len(readings) + mounts.index(reading.mount)] = reading.time_s or 0.0
    values = np.array([reading.value_mm for reading in readings])
    residual = values - rows @ np.linalg.lstsq(rows, values, rcond=None)[0]
    free = len(readings) - np.linalg.matrix_rank(rows)
    expected = {
        "standard_deviation_mm": pytest.approx(np.sqrt(residual @ residual / free), rel=1e-3),
        "degrees_of_freedom": pytest.approx(free),
    }
    for verb in ("solve", "diagnose"):
        noise = json.loads(glidecal(verb, session, "--json").out)["noise"]
        assert {key: noise[key] for key in expected} == expected, verb
    planned = json.loads(glidecal("plan", session, "--json").out)
    assert planned["noise_mm"] == expected["standard_deviation_mm"]
    words = f"{noise['standard_deviation_mm']:.4f} mm"
    assert f"Noise of a single reading {words}" in glidecal("solve", session).out
    assert f"noise of a reading\n{words}" in glidecal("diagnose", session).out


@LONG
def test_sessions_of_one_indicator_are_not_indicators_that_differ(tmp_path: Path) -> None:
    """The posterior has an estimate for each session; both differ by chance alone."""
    sessions = [tmp_path / f"{seed}.jsonl" for seed in (8, 9)]
    for path in sessions:
        assert glidecal("simulate", "--seed", path.stem, "-o", path).status == 0
    alone = [json.loads(glidecal("solve", path, "--json").out)["noise"] for path in sessions]
    together = glidecal("solve", *sessions, "--json").out
    noise = json.loads(together)["noise"]
    squares = [each["standard_deviation_mm"] ** 2 for each in alone]
    assert noise["standard_deviation_mm"] == pytest.approx(np.sqrt(np.mean(squares)))
    freedoms = [each["degrees_of_freedom"] for each in alone]
    welch = np.sum(squares) ** 2 / np.sum(np.square(squares) / freedoms)  # GUM G.4.1
    assert noise["degrees_of_freedom"] == pytest.approx(welch)
    assert noise == {**noise, "pooled": True}
    assert "scatter differently" not in glidecal("solve", *sessions).out
    diagnosis = json.loads(glidecal("diagnose", *sessions, "--json").out)["noise"]
    assert diagnosis == {key: noise[key] for key in diagnosis}
