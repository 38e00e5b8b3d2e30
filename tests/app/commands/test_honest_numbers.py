"""Sessions with too little, too equal or unequal data: what can be given, and a sentence."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.screens.interface import Glidecal
from app.screens.result import result_of
from calib.arrays import conditions
from calib.tripod.pipeline import Model
from tests.app.cli import Run, glidecal
from tests.conftest import LONG, SAMPLES, first_quick
from tests.screens.driving import SIZE, said, text, until

LEVELS = (0.0, 60.0, -100.0)
Row = dict[str, Any]


def rows(
    truth: tuple[float, ...] = (0.5, -0.8, 0.3, 0.0, 0.0, 0.0),
    *,
    cycles: int = 3,
    scatter_mm: float = 0.002,
    digits: int = 3,
    legs: str = "xyz",
    levels: tuple[float, ...] = LEVELS,
    seed: int = 0,
) -> list[Row]:
    """A table of readings: leg after leg, cycle after cycle."""
    generator = np.random.default_rng(seed)
    lines = []
    for leg in legs:
        for cycle in range(1, cycles + 1):
            for level in levels:
                for axis in "xyz".replace(leg, ""):
                    place = conditions(["xyz".index(leg)], ["xyz".index(axis)], [level])
                    exact = float(Model(parameters_mm=truth).readings(place)[0])
                    value = exact + scatter_mm * generator.normal() + 0.1
                    lines.append(
                        {
                            "leg": leg,
                            "axis": axis,
                            "displacement_mm": level,
                            "value_mm": f"{value:.{digits}f}",
                            "cycle": cycle,
                        }
                    )
    return lines


def solved(folder: Path, table: list[Row], *options: str, figures: tuple[str, ...] = ()) -> Run:
    path = folder / "t.csv"
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, table[0].keys())
        writer.writeheader()
        writer.writerows(table)
    session = folder / "t.jsonl"
    session.unlink(missing_ok=True)
    assert glidecal("import", path, "-o", session, *figures).status == 0
    return glidecal("solve", session, *options)


def document(
    folder: Path, table: list[Row], *options: str, figures: tuple[str, ...] = ()
) -> dict[str, Any]:
    run = solved(folder, table, "--json", *options, figures=figures)
    assert run.status == 0, run.err
    solution: dict[str, Any] = json.loads(run.out)
    return solution


def below_the_view(text: str) -> list[str]:
    """How well the parameters of the view are known, their table, and its cautions."""
    parts = text.split("\n\n")
    (heading,) = [number for number, part in enumerate(parts) if part.startswith("View: ")]
    return parts[heading + 1 : heading + 4]


def test_weak_direction_is_told(tmp_path: Path) -> None:
    """Residual at the noise, lengths wrong by many times their worth: nobody must overlook it.

    With 0.04 mm of noise the lengths are known to ±12 mm only, 18 mm off being no surprise; the
    residual shows nothing of it. A set that is known worse than its tolerance is refused, and where
    it is just accepted the view says so.
    """
    table = rows(scatter_mm=0.02, digits=4)
    run = solved(tmp_path, table, "--subset", "both")
    assert run.status == 0
    verdict, _, cautions = below_the_view(run.out)
    assert "known to ±" in verdict
    assert cautions.count("WEAK: d_rho_") == 3
    solution = document(tmp_path, table, "--subset", "both")
    error = max(abs(solution["parameters"][f"d_L_{leg}"]["value"]) for leg in "xyz")
    residual = solution["rms_after_mm"]
    assert error > 20.0 * residual, "the lengths are wrong, and the residual does not show it"
    far = rows(scatter_mm=0.2, digits=4)
    refused = solved(tmp_path, far, "--subset", "both")
    assert refused.status == 5
    assert "d_rho_x + d_L_x" in refused.err


@LONG
def test_lengths_that_hide_behind_the_noise_are_told(tmp_path: Path) -> None:
    """Lengths 18 mm off, joint offsets asked for: residual at the noise, tool off by 2 mm."""
    table = rows((18.0, -18.0, 18.0, 18.0, -18.0, 18.0), scatter_mm=0.3, digits=4, seed=2)
    solution = document(tmp_path, table, "--subset", "joint-offsets")
    assert solution["lack_of_fit"]["p_value"] > 0.01, "the residual says nothing"
    run = solved(tmp_path, table, "--subset", "joint-offsets")
    head = " ".join(below_the_view(run.out)[2].split())
    assert "LEFT OUT: joint offsets and leg lengths: 3 of 6 combinations not identifiable" in head
    assert "Identified parameters are valid within ± U only if parts are within" in head


def test_a_table_of_values_without_uncertainty_has_no_column_for_it() -> None:
    """Before: ± U over nothing."""

    def heading(*options: str) -> str:
        run = glidecal("solve", SAMPLES / "experiment_1_six.jsonl", *options)
        return next(line for line in run.out.splitlines() if line.strip().startswith("value"))

    assert "± U (95 %)" in heading()
    assert "± U" not in heading("--holds", "kinematics")


def test_displacements_in_metres_get_an_answer_with_a_warning(tmp_path: Path) -> None:
    """Tenths of a millimetre show no law of the drives, so nothing of them is in the model."""
    with (SAMPLES / "tables" / "experiment_1_six.csv").open(encoding="utf-8") as sample:
        table: list[Row] = list(csv.DictReader(sample))
    for row in table:
        row["displacement_mm"] = float(row["displacement_mm"]) / 1000.0
    run = solved(tmp_path, table, figures=("--resolution", "0.01", "--repeatability", "0.02"))
    assert run.status == 0, run.err
    assert "these values are not expected to make the tool more accurate" in " ".join(
        run.out.split()
    )


@LONG
def test_a_leg_in_micrometres_has_values_though_no_set_fits(tmp_path: Path) -> None:
    """What is entered is that of the likeliest labels, in every answer; the sets know no labels."""
    table = rows(scatter_mm=0.002, digits=4)
    for row in table:
        if row["leg"] == "z":
            row["value_mm"] = f"{1000.0 * float(row['value_mm']):g}"
    run = solved(tmp_path, table)
    assert run.status == 0, run.err
    words = " ".join(run.out.split())
    assert "µm recorded as mm (z)" in words
    assert "View: none. exact identification: found no optimum within reach" in words
    out = tmp_path / "offsets.csv"
    assert glidecal("export", tmp_path / "t.jsonl", "--format", "csv", "-o", out).status == 0
    report = glidecal("report", tmp_path / "t.jsonl", "-o", "-")
    page = " ".join(re.sub("<[^>]*>", " ", report.out).split())
    assert "View: none. exact identification: found no optimum within reach" in page
    for line in out.read_text("utf-8").splitlines():
        if line.startswith("d_rho"):
            name, value, *_ = line.split(",")
            assert f"{name} {float(value):+.4f} mm" in words
            assert f"{name} {float(value):+.4f} mm" in page
    document = json.loads(glidecal("solve", tmp_path / "t.jsonl", "--json").out)
    assert document["subset"] is document["parameters"] is document["differences"] is None
    for name, entry in document["correction"]["values"].items():
        assert f"{name} {entry['value']:+.4f} mm" in words


async def test_a_result_without_a_view_has_its_page(tmp_path: Path) -> None:
    """The screen shows what ``solve`` writes; there is nothing to draw, and no key fails."""
    table = rows(scatter_mm=0.002, digits=4)
    for row in table:
        if row["leg"] == "z":
            row["value_mm"] = f"{1000.0 * float(row['value_mm']):g}"
    assert solved(tmp_path, table).status == 0
    interface = Glidecal(result_of([tmp_path / "t.jsonl"]))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "the result", lambda: "d_rho" in text(interface, "#result-text"))
        await until(pilot, "details", lambda: "View: none." in text(interface, "#details-text"))
        await pilot.press("3", "4", "plus", "w")
        await until(pilot, "refusal", lambda: "no optimum within reach" in said(interface))


def test_a_reading_of_a_metre_gets_no_advice_that_fails_too(tmp_path: Path) -> None:
    table = rows(cycles=1)
    table[2]["value_mm"] = "900"
    run = solved(tmp_path, table)
    assert run.status == 5
    assert " ".join(run.err.split()).endswith(
        "Look for a wrong reading or unit, first at leg X along Y, +60 mm: 900 mm."
    )
    for options in (("--subset", "joint-offsets"), ("--method", "linear")):
        assert solved(tmp_path, table, *options).status == 5


def test_one_repeat_only(tmp_path: Path) -> None:
    table = rows(cycles=1)
    bare = document(tmp_path, table)
    assert bare["noise"]["source"] == "residuals"
    stated = document(tmp_path, table, figures=("--repeatability", "0.002"))
    assert stated["noise"]["source"] == "instrument"
    assert stated["noise"]["degrees_of_freedom"] is None


def test_all_readings_identical(tmp_path: Path) -> None:
    table = [row | {"value_mm": "0.100"} for row in rows()]
    solution = document(tmp_path, table)
    assert solution["noise"]["source"] == "instrument"
    for parameter in solution["parameters"].values():
        assert parameter["standard_uncertainty"] > 1e-5, "the last digit is all that is known"
    step = 0.001 / 12**0.5
    assert solution["noise"]["standard_deviation_mm"] == pytest.approx(step)


@LONG
def test_the_step_of_the_display_is_found_where_nobody_states_it(tmp_path: Path) -> None:
    """1 µm readings written with six decimals: one that flickers is not wild."""
    table = rows(scatter_mm=0.0, digits=3)
    table = [row | {"value_mm": f"{row['value_mm']}000"} for row in table]
    flickering = {**table[4], "value_mm": f"{float(str(table[4]['value_mm'])) + 0.001:.6f}"}
    table[4] = flickering
    solution = document(tmp_path, table)
    assert solution["display_step_found_mm"] == 0.001
    assert solution["suspect_readings"] == []
    assert solution["noise"]["standard_deviation_mm"] == pytest.approx(0.001 / 12**0.5, rel=0.2)
    text = solved(tmp_path, table).out
    assert "display step 0.001 mm, found in the values" in " ".join(text.split())
    stated = document(tmp_path, table, figures=("--resolution", "0.001"))
    assert stated["display_step_found_mm"] is None
    assert stated["noise"] == solution["noise"]
    assert stated["parameters"] == solution["parameters"]


@LONG
def test_identical_repeats_of_a_coarse_display_do_not_average_down(tmp_path: Path) -> None:
    few = document(tmp_path, rows(cycles=2, scatter_mm=0.0, digits=2), "--subset", "joint-offsets")
    many = document(tmp_path, rows(cycles=9, scatter_mm=0.0, digits=2), "--subset", "joint-offsets")
    name = "d_rho_x"
    first = few["parameters"][name]["standard_uncertainty"]
    assert many["parameters"][name]["standard_uncertainty"] == pytest.approx(first)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (lambda: rows(levels=(0.0,)), "two postures"),
        (lambda: rows(legs="x"), "cannot be identified"),
        (lambda: rows(levels=(60.0, -100.0)), "cannot be identified"),
    ],
)
def test_what_determines_nothing_is_refused(
    tmp_path: Path, table: Callable[[], list[Row]], message: str
) -> None:
    run = solved(tmp_path, table(), "--subset", "both")
    assert run.status == 5
    assert message in run.err
    assert "Traceback" not in run.err


def test_two_legs_give_what_they_can(tmp_path: Path) -> None:
    solution = document(tmp_path, rows(legs="xy"), "--subset", "joint-offsets")
    truth = (0.5, -0.8, 0.3)
    for value, name in zip(truth, ("d_rho_x", "d_rho_y", "d_rho_z"), strict=True):
        parameter = solution["parameters"][name]
        assert abs(parameter["value"] - value) < 3.0 * parameter["expanded_uncertainty"]
    run = solved(tmp_path, rows(legs="xy"), "--subset", "both")
    assert run.status == 0
    assert "WEAK: d_rho_z" in run.out


def test_an_indicator_with_ten_times_the_noise(tmp_path: Path) -> None:
    generator = np.random.default_rng(5)
    table = rows()
    for row in table:
        if (row["leg"], row["axis"]) == ("x", "y"):
            row["value_mm"] = f"{float(row['value_mm']) + generator.normal(scale=0.05):.3f}"
    solution = document(tmp_path, table)
    assert solution["noise"]["pooled"] is False
    text = solved(tmp_path, table).out
    words = " ".join(text.split())
    assert "scatter differently: leg X along Y, set-up xy" in words, "the loud one has a name"
    assert words.split("NOTE: ", 1)[1].count(" mm; ") == 1, "the five quiet ones share one figure"
    truth = dict(zip(solution["parameters"], (0.5, -0.8, 0.3), strict=False))
    for name, value in truth.items():
        parameter = solution["parameters"][name]
        assert abs(parameter["value"] - value) < 2.0 * parameter["expanded_uncertainty"]


def test_repeats_in_place_are_one_reading(tmp_path: Path) -> None:
    table = [dict(row) for row in rows(cycles=1) for _ in range(3)]
    solution = document(tmp_path, table)
    assert solution["noise"]["source"] == "residuals", "readings in place are no repeats"


def test_zero_degrees_of_freedom(tmp_path: Path) -> None:
    """Six differences, six parameters: nothing is left to check with."""
    table = rows(cycles=1, levels=(60.0, -100.0))
    refused = solved(tmp_path, table, "--subset", "both")
    assert refused.status == 5
    offsets = document(tmp_path, table, "--subset", "joint-offsets")
    assert offsets["degrees_of_freedom"] == 3
    for parameter in offsets["parameters"].values():
        assert parameter["coverage_factor"] == pytest.approx(3.182, abs=1e-3)


def test_a_wild_reading_is_named(tmp_path: Path) -> None:
    table = rows()
    table[26]["value_mm"] = f"{float(table[26]['value_mm']) + 0.05:.3f}"
    solution = document(tmp_path, table)
    assert [s["reading"] for s in solution["suspect_readings"]] == [27]
    text = " ".join(solved(tmp_path, table).out.split())
    assert "SUSPECT: reading 27 of t.jsonl" in text
    assert "It is used. Measure it again." in text


@LONG
def test_nothing_is_ever_without_a_number(tmp_path: Path) -> None:
    """No NaN and no silent zero anywhere in the documents of the cases above."""
    cases = [rows(), rows(cycles=1), rows(digits=2, scatter_mm=0.0), rows(legs="xy")]
    for table in cases:
        run = solved(tmp_path, table, "--json", "--subset", "joint-offsets")
        assert run.status == 0
        assert "NaN" not in run.out
        assert "Infinity" not in run.out
        for parameter in json.loads(run.out)["parameters"].values():
            assert parameter["expanded_uncertainty"] > 0.0


@LONG
def test_a_reading_alone_between_two_breaks_is_said_to_be_lost(tmp_path: Path) -> None:
    """A mounting's only posture cannot be told from its zero; the numbers are those without it."""
    readings = [{**row, "mount": f"{row['leg']}{row['axis']}"} for row in rows()]
    lone = {**readings[26], "mount": "after the break"}
    solution = document(tmp_path, [*readings[:26], lone, *readings[27:]])
    without = document(tmp_path, [*readings[:26], *readings[27:]])
    assert [r["readings"] for r in solution["lost_readings"]] == [[27]]
    assert without["lost_readings"] == []
    for name, parameter in solution["parameters"].items():
        assert parameter["value"] == pytest.approx(without["parameters"][name]["value"], abs=1e-9)
    text = " ".join(solved(tmp_path, [*readings[:26], lone, *readings[27:]]).out.split())
    assert "NOT USED: reading 27 of t.jsonl" in text
    assert "it gives no difference" in text
    assert f"{len(readings) - 1} readings" in text
    page = tmp_path / "t.html"
    assert glidecal("report", tmp_path / "t.jsonl", "-o", page).status == 0
    assert f"{len(readings) - 1} of {len(readings)}" in page.read_text(encoding="utf-8")


def test_noise_that_the_fit_left_cannot_be_simulated(tmp_path: Path) -> None:
    run = solved(tmp_path, rows(cycles=1), "--monte-carlo", "100")
    assert run.status == 2
    assert "noise from residuals" in run.err


@pytest.mark.parametrize(
    ("table", "message"),
    first_quick(
        [
            (lambda: rows(cycles=1), "cannot show whether the model fits"),
            (lambda: rows(cycles=1), "95 %, residual taken as noise"),
            (
                lambda: rows(scatter_mm=0.0, digits=2),
                "all repeats agree within a step of the display, 0.01 mm",
            ),
            (lambda: rows(scatter_mm=0.0, digits=2), "as stated or seen in the digits"),
            (lambda: rows(legs="xy"), "leg Z was not measured"),
            (lambda: rows(legs="x"), "legs Y, Z were not measured"),
            (
                lambda: [row for row in rows() for _ in range(2)],
                "54 readings were taken without leaving",
            ),
            (lambda: rows(levels=(60.0, -100.0)), "LEFT OUT: joint offsets and leg lengths: "),
            (lambda: rows(levels=(60.0, -100.0)), "these readings show neither a larger error"),
        ],
        several=True,
    ),
)
def test_what_cannot_be_given_has_a_sentence(
    tmp_path: Path, table: Callable[[], list[Row]], message: str
) -> None:
    run = solved(tmp_path, table(), "--subset", "joint-offsets")
    assert run.status == 0, run.err
    assert message in " ".join(run.out.split())


def test_a_whole_session_has_none_of_these_sentences(tmp_path: Path) -> None:
    text = solved(tmp_path, rows()).out
    assert "NOTE" not in text
    assert "WARNING" not in text
    assert "LEFT OUT" not in text


def test_no_uncertainty_is_rounded_to_nothing(tmp_path: Path) -> None:
    """Readings in hundredths of a micrometre: what is uncertain has two digits, not ±0.000."""
    table = rows(scatter_mm=2e-5, digits=6)
    text = " ".join(solved(tmp_path, table, "--subset", "both").out.split())
    assert "±0.00 " not in text
    assert "±0.000 " not in text
    solution = document(tmp_path, table, "--subset", "both")
    first = solution["parameters"]["d_rho_x"]
    half = first["expanded_uncertainty"]
    decimals = max(4, 1 - int(np.floor(np.log10(half))))
    assert f"{first['value']:+.{decimals}f} {half:.{decimals}f}" in text


@LONG
def test_plan_goes_by_the_noise_of_the_readings_unless_another_is_asked_for(
    tmp_path: Path,
) -> None:
    solved(tmp_path, rows())
    session = tmp_path / "t.jsonl"
    plan = json.loads(glidecal("plan", session, "--json").out)
    noise = document(tmp_path, rows())["noise"]["standard_deviation_mm"]
    assert plan["noise_mm"] == pytest.approx(noise, rel=0.2)
    assert plan["noise"] == f"{plan['noise_mm']:.2g} mm, from the sessions"
    coarse = json.loads(glidecal("plan", session, "--json", "--noise", "0.05").out)
    assert (coarse["noise_mm"], coarse["bound_mm"]) == (0.05, plan["bound_mm"])
    assert coarse["next"]["bound_mm"] > plan["next"]["bound_mm"]


@LONG
def test_drift_is_said_although_it_is_no_noise(tmp_path: Path) -> None:
    """Steady drift of 0.01 mm a step: residual and noise may look well, the sentence is there."""
    table = rows()
    for k, row in enumerate(table):
        row["value_mm"] = f"{float(row['value_mm']) + 0.01 * (k % 18 // 2):.3f}"
    solution = document(tmp_path, table, "--subset", "both")
    assert solution["noise"]["standard_deviation_mm"] == pytest.approx(0.002, rel=0.5)
    assert solution["noise"]["wander_mm"] == pytest.approx(0.03, rel=0.1)
    text = " ".join(solved(tmp_path, table, "--subset", "both").out.split())
    assert f"drift from cycle to cycle by {solution['noise']['wander_mm']:.3f} mm r.m.s." in text


@LONG
def test_hundreds_of_suspects_are_counted_not_listed(tmp_path: Path) -> None:
    table = rows(cycles=60)
    for row in table[::90]:
        row["value_mm"] = f"{float(row['value_mm']) + 0.05:.3f}"
    solution = document(tmp_path, table)
    count = len(solution["suspect_readings"])
    assert count > 8
    text = " ".join(solved(tmp_path, table).out.split())
    assert text.count("SUSPECT: reading") == 8
    assert f"SUSPECT: {count - 8} more; --json names them all." in text
