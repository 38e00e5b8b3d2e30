"""The verbs identifiability, postures and plan, as a person runs them."""

from __future__ import annotations

import json
import re
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.evaluating.loading import load_sessions
from app.planning.tripod import next_measurement, tripod_planning
from app.report.text.planning import further_text
from app.report.text.preparing import procedure_sentence
from calib.arrays import conditions, descending
from calib.design.criteria import Criterion
from calib.design.identifiability import seen_by
from calib.posterior.planning import FurtherSetUp, Reach
from calib.tripod.geometry import Geometry
from calib.tripod.optimum import optimum_postures, visiting_order
from calib.tripod.pipeline import derivatives
from calib.tripod.planning import TripodPlanning
from calib.tripod.pool import leg_pool, levels_mm
from protocols.machine import load_machine
from protocols.machine_files import machine_files
from protocols.procedure import load_procedure
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, first_quick
from tests.hidden_sessions import write_session


def orthoglide(procedure: str, noise_mm: float) -> TripodPlanning:
    machine = load_machine("orthoglide")
    return tripod_planning(machine, load_procedure(procedure, machine.geometry()), noise_mm)


MAX_MIN = """schema = "glidecal.procedure/1"
name = "max-min"
title = "Six differences"
cycles = 1
levels = ["max", "min"]
return_to_zero = false
"""


@pytest.fixture
def six(tmp_path: Path) -> Path:
    path = tmp_path / "six.toml"
    path.write_text(MAX_MIN, encoding="utf-8")
    return path


def document(*arguments: str | Path) -> dict[str, Any]:
    run = glidecal(*arguments, "--json")
    assert run.status == 0, run.err
    report: dict[str, Any] = json.loads(run.out)
    return report


def test_six_differences_see_three_combinations(six: Path) -> None:
    report = document("identifiability", "orthoglide", "--procedure", six, "--noise", "0.02")
    assert report["schema"] == "glidecal.identifiability/1"
    assert (report["rank"], report["parameter_count"]) == (3, 6)
    assert report["independent_row_count"] == 6
    assert report["limited_by"] == "nothing"
    assert report["individually_identifiable"] == []
    assert sorted(direction["name"] for direction in report["lost_directions"]) == [
        "d_rho_x + d_L_x",
        "d_rho_y + d_L_y",
        "d_rho_z + d_L_z",
    ]
    assert report["condition_number"] == pytest.approx(1.43 / 0.90, rel=0.02)  # theory, section 3
    for direction in report["lost_directions"]:
        assert direction["standard_uncertainty_mm"] is None
        assert 0.0 < direction["cure"]["standard_uncertainty_mm"] < 5.0


def test_zero_max_min_sees_everything_three_weakly() -> None:
    report = document("identifiability", "orthoglide", "--procedure", "zero-max-min")
    assert report["rank"] == 6
    assert report["lost_directions"] == []
    assert len(report["weak_directions"]) == 3
    assert report["classical_qr"]["flagged"] == []
    assert sorted(report["measured"]) == ["x_y", "x_z", "y_x", "y_z", "z_x", "z_y"]
    for weak in report["weak_directions"]:
        assert weak["cure"]["standard_uncertainty_mm"] < weak["standard_uncertainty_mm"]
        assert weak["tool_mm"] > 0.0


def test_too_few_postures_are_named(tmp_path: Path) -> None:
    path = tmp_path / "one_leg.toml"
    path.write_text(MAX_MIN + 'legs = ["x"]\n', encoding="utf-8")
    report = document("identifiability", "orthoglide", "--procedure", path)
    assert report["limited_by"] == "too-few-postures"
    assert report["independent_row_count"] == 2
    assert "measure more postures" in glidecal(
        "identifiability", "orthoglide", "--procedure", path
    ).out.replace("\n", " ")


def test_the_text_tells_combination_cost_cure_and_the_classical_view(six: Path) -> None:
    text = glidecal("identifiability", "orthoglide", "--procedure", six, "--noise", "0.02").out
    assert "3 of 6 combinations of the parameters are identifiable, 3 not." in text
    assert "NOT IDENTIFIABLE: d_rho_x + d_L_x." in text
    weak = glidecal("identifiability", "orthoglide", "--procedure", "zero-max-min").out
    assert "WEAK: d_rho_x + d_L_x known only to ±" in weak
    of_tool = r"\(95 %\), in the machine's own frame ±[\d.]+ mm at the tool\."
    assert re.search(of_tool, " ".join(weak.split()))
    assert "Best single addition: leg" in weak
    assert "WARNING: that test" in weak
    assert max(map(len, (text + weak).splitlines())) <= 80


def test_zero_added_to_the_six_differences_lets_everything_be_seen(six: Path) -> None:
    text = MAX_MIN.replace('["max", "min"]', '["max", "min", "zero"]')
    six.write_text(text, encoding="utf-8")
    analysis = seen_by(orthoglide(str(six), 0.02))
    assert analysis.identifiability.rank == 6


def test_a_cure_keeps_its_promise() -> None:
    """The promised uncertainty from the readings with those of the cure appended."""
    analysis = seen_by(orthoglide("zero-max-min", 0.02))
    weak = next(direction for direction in analysis.weak if direction.name == "d_rho_x + d_L_x")
    assert weak.cure is not None
    match = re.fullmatch(
        r"leg (.) at (\S+) mm and at Zero \(station (\S+), a new mounting\)", weak.cure.posture
    )
    assert match is not None
    leg, level, station = "xyz".index(match[1]), float(match[2]), float(match[3])
    axes = [axis for axis in range(3) if axis != leg]
    added = conditions([leg] * 4, axes * 2, [level] * 2 + [0.0] * 2, station=station)
    rows = derivatives(Geometry(), np.zeros(6), added)
    differences = (rows[:2] - rows[2:]) / np.sqrt(2.0) / 0.02
    whitened = np.vstack([analysis.examined.sensitivity.jacobian, differences])
    covariance = np.linalg.inv(whitened.T @ whitened + np.eye(6) / 5.0**2)
    vector = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    expected = float(np.sqrt(vector @ covariance @ vector))
    assert weak.cure.standard_uncertainty_mm == pytest.approx(expected, rel=1e-3)


def test_postures_as_json() -> None:
    report = document("postures", "orthoglide", "--procedure", "zero-max-min", "--count", "12")
    assert report["schema"] == "glidecal.postures/1"
    assert report["count"] == len(report["postures"]) == 12
    assert report["criterion"] == "determinant"
    places = {tuple(posture.values()) for posture in report["postures"]}
    assert len(places) == 12
    assert set(report["postures"][0]) == {"leg", "station", "displacement_mm", "approach"}
    on_limit = [p["displacement_mm"] in (-100.0, 60.0) for p in report["postures"]]
    on_end = [p["station"] in (0.2, 0.8) for p in report["postures"]]
    assert report["coordinates_on_bound"] == sum(on_limit) + sum(on_end)


@pytest.mark.parametrize("criterion", first_quick(Criterion))
def test_twelve_chosen_postures_beat_the_twelve_of_a_procedure(
    tmp_path: Path, criterion: Criterion
) -> None:
    path = tmp_path / "twelve.toml"
    text = MAX_MIN.replace('["max", "min"]', '["zero", "max", "min", 30.0]')
    path.write_text(text, encoding="utf-8")
    optimum = optimum_postures(orthoglide(str(path), 0.02), 12, criterion=criterion)
    before, after = optimum.before.value, optimum.after.value
    assert before is not None
    assert after is not None
    assert after > before if criterion.larger_is_better else after < before


def test_common_postures_are_one_procedure_that_runs(tmp_path: Path) -> None:
    path = tmp_path / "optimum.toml"
    run = glidecal(
        *("postures", "orthoglide", "--procedure", "zero-max-min", "--count", "12"),
        *("--common", "-o", path),
    )
    assert run.status == 0, run.err
    assert path.exists()
    dry = glidecal("run", "--dry-run", "--protocol", path)
    assert dry.status == 0, dry.err
    session = tmp_path / "s.jsonl"
    assert glidecal("simulate", "--protocol", path, "-o", session).status == 0
    assert glidecal("solve", session, "--subset", "both").status == 0


@LONG
def test_free_postures_are_one_procedure_for_each_mounting(tmp_path: Path) -> None:
    run = glidecal(
        *("postures", "orthoglide", "--procedure", "sweep", "--count", "13"),
        *("-o", tmp_path / "best.toml"),
    )
    assert run.status == 0, run.err
    paths = sorted(tmp_path.glob("best-*.toml"))
    assert len(paths) >= 3
    sessions = [path.with_suffix(".jsonl") for path in paths]
    for path, session in zip(paths, sessions, strict=True):
        assert glidecal("run", "--dry-run", "--protocol", path).status == 0
        assert glidecal("simulate", "--protocol", path, "-o", session).status == 0
    solution = document("solve", *sessions, "--subset", "both")
    assert len(solution["parameters"]) == 6


@LONG
def test_a_budget_is_kept() -> None:
    free = document("postures", "orthoglide", "--procedure", "sweep", "--count", "13")
    budget = free["minutes"] - 1.0
    tight = document(
        *("postures", "orthoglide", "--procedure", "sweep", "--count", "13"),
        *("--budget", f"{budget}"),
    )
    assert tight["minutes"] <= budget
    assert len(tight["postures"]) == 13


def test_a_budget_that_leaves_one_station() -> None:
    """What has no neighbour on the grid stays where it is; the rest is refined."""
    arguments = ("postures", "orthoglide", "--procedure", "zero-max-min", "--count", "9")
    report = document(*arguments, "--budget", "8", "--starts", "2")
    assert len({posture["station"] for posture in report["postures"]}) == 1
    assert report["minutes"] <= 8.0
    assert report["grid_value"] is not None


TWELVE = ("postures", "orthoglide", "--procedure", "zero-max-min", "--count", "12")


@LONG
def test_postures_are_moved_off_the_grid_unless_it_is_to_be_kept() -> None:
    free, on_grid = document(*TWELVE), document(*TWELVE, "--no-refine")
    assert on_grid["grid_value"] is None
    assert all(posture["displacement_mm"] % 10.0 == 0.0 for posture in on_grid["postures"])
    assert free["grid_value"] == pytest.approx(on_grid["value"], rel=1e-9)
    assert 1.004 < free["value"] / on_grid["value"] < 1.1
    assert any(posture["displacement_mm"] % 10.0 for posture in free["postures"])
    moved, still = glidecal(*TWELVE).out, glidecal(*TWELVE, "--no-refine").out
    # the starts of the search end elsewhere on other processors, so no figure is pinned here
    assert f"Moved off the grid: criterion {on_grid['value']:.4g} → {free['value']:.4g}." in moved
    assert "The postures keep to the grid: --no-refine." in still


def test_the_figure_is_of_the_postures_that_are_printed() -> None:
    report = document(*TWELVE, "--noise", "0.02")
    readings = [
        ("xyz".index(posture["leg"]), axis, posture["displacement_mm"], posture["station"])
        for posture in report["postures"]
        for axis in range(3)
        if axis != "xyz".index(posture["leg"])
    ]
    legs, axes, levels, stations = (list(column) for column in zip(*readings, strict=True))
    conditions_read = conditions(legs, axes, levels, station=stations)
    rows = derivatives(Geometry(), np.zeros(6), conditions_read) / 0.02
    for mount in range(conditions_read.mount_count):
        rows[conditions_read.mount == mount] -= rows[conditions_read.mount == mount].mean(axis=0)
    value = np.prod(np.linalg.svd(rows, compute_uv=False)) ** (1 / 6)
    assert report["value"] == pytest.approx(value, rel=1e-7)


def test_moved_postures_are_those_of_the_written_procedure(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    report = document(*TWELVE, "--common", "--criterion", "condition", "-o", path)
    levels = tomllib.loads(path.read_text())["levels"]
    assert {posture["displacement_mm"] for posture in report["postures"]} <= set(levels)
    assert any(level % 10.0 for level in levels)


@pytest.mark.parametrize("criterion", first_quick(list(Criterion)))
def test_nine_postures_do_for_every_criterion(criterion: Criterion) -> None:
    """Sets of nine that see next to nothing have fine condition numbers."""
    optimum = optimum_postures(orthoglide("zero-max-min", 0.02), 9, criterion=criterion)
    assert optimum.after.value is not None
    assert optimum.grid_value is not None
    assert optimum.after.condition_number is not None
    assert optimum.after.condition_number < 200.0


@LONG
def test_one_seed_gives_one_choice() -> None:
    first, second = (optimum_postures(orthoglide("sweep", 0.01), 9, seed=4) for _ in range(2))
    assert first.postures == second.postures
    assert first.after == second.after


ORTHOGLIDE = ("postures", "orthoglide", "--procedure", "sweep")


@pytest.mark.parametrize(
    ("status", "arguments", "message"),
    [
        (
            2,
            ("identifiability", "delta", "--procedure", "sweep"),
            "hexaslide, linear-delta, orthoglide",
        ),
        (2, ("identifiability", "orthoglide", "--procedure", "nothing"), "zero-max-min"),
        (2, ("identifiability", "orthoglide", "--procedure", "sweep", "--noise", "0"), "--noise"),
        (2, (*ORTHOGLIDE, "--count", "9", "--noise", "-1"), "--noise: found -1 mm"),
        (2, ("plan", "--noise", "-1"), "--noise: found -1 mm"),
        (
            2,
            ("postures", "delta", "--procedure", "sweep", "--count", "9"),
            "hexaslide, linear-delta, orthoglide",
        ),
        (2, (*ORTHOGLIDE, "--count", "0"), "--count"),
        (
            2,
            ("postures", "hexaslide", "--procedure", "position", "--count", "16", "--no-refine"),
            "--no-refine",
        ),
        (2, (*ORTHOGLIDE, "--count", "100000"), "--repeats"),
        (2, (*ORTHOGLIDE, "--count", "13", "--common"), "multiple of the number of legs"),
        (2, (*ORTHOGLIDE, "--count", "12", "--budget", "2"), "--budget"),
        (2, (*ORTHOGLIDE, "--count", "12", "-o", "best.txt"), ".toml"),
        (2, (*ORTHOGLIDE, "--count", "4"), "--count: found 4. Allowed: 5, the fewest"),
        (3, ("plan", "--session", "no.jsonl"), "no.jsonl"),
        (3, ("plan", "--machine", "no.toml"), "no.toml"),
        (2, ("plan", "--machine", "a.toml", "--model", "."), "both"),
    ],
)
def test_wrong_use_is_one_paragraph(
    status: int, arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    assert message in refused(status, *arguments, cwd=tmp_path)


@LONG
def test_plan_with_and_without_sessions(samples: Path) -> None:
    blank = document("plan")
    assert blank["schema"] == "glidecal.plan/1"
    after = document("plan", "--session", samples / "simulated_zero-max-min.jsonl")
    for plan in (blank, after):
        assert plan["next"]["bound_mm"] < plan["bound_mm"]
        assert plan["frame"] == "touched-off"
        assert plan["holds"] == "offsets"
        gains = [set_up["gain_mm_per_minute"] for set_up in (plan["next"], *plan["runners_up"])]
        assert gains == descending(gains, float)  # legs alike but for rounding: by name
        bounds = [plan["bound_mm"], *(set_up["bound_mm"] for set_up in plan["further"])]
        assert all(b < 0.9 * a for a, b in pairwise(bounds))
    assert after["bound_mm"] < 0.1 * blank["bound_mm"]
    text = " ".join(glidecal("plan", samples / "simulated_zero-max-min.jsonl").out.split())
    assert text.startswith("Next, after simulated_zero-max-min.jsonl: leg ")
    assert "this lowers the bound (95 %) of the tool error from " in text


def test_set_ups_in_turn_do_not_deny_the_proposal_above_them() -> None:
    """Before: "more readings of legs would not help" below three legs that lower the bound."""
    text = further_text(Reach(0.0044, ()))
    assert "No set-up there and back lowers the bound by a tenth" in text
    assert "would not help" not in text
    set_up = FurtherSetUp(("x", "z"), 0.35, (0.0, 60.0, 0.0), 6.0, 0.003)
    text = further_text(Reach(0.0044, (set_up,)))
    assert "legs X, Z, 35% from the tool end" in text  # as the proposal has it
    text = " ".join(text.split())  # levels of other stations are others
    assert "both axes; the first at Zero, +60, Zero mm. After that none lowers" in text


def test_a_procedure_without_a_description_leaves_no_gap_in_its_sentence() -> None:
    geometry = Geometry()
    plain = load_procedure("zero-max-min", geometry).model_copy(update={"description": ""})
    text = procedure_sentence(plain, geometry, ("yx", "zy"))
    assert "about 10 minutes. Every repeat" in text


@LONG
def test_plan_goes_to_the_legs_that_were_not_measured(tmp_path: Path) -> None:
    path, session = tmp_path / "p.toml", tmp_path / "s.jsonl"
    text = MAX_MIN.replace('["max", "min"]', '["zero", "max", "min"]')
    path.write_text(text.replace("cycles = 1", 'cycles = 3\nlegs = ["x", "y"]'), encoding="utf-8")
    assert glidecal("simulate", "--protocol", path, "-o", session).status == 0
    assert next_measurement(load_sessions([session])[0]).best.candidate.legs == ("z",)


@LONG
def test_plan_goes_by_the_frame_and_by_what_the_controller_holds(tmp_path: Path) -> None:
    session = write_session(tmp_path / "s.jsonl", "sweep", 3, "axis_squareness:xy", 2.0)
    bounds = {}
    for words in ((), ("--frame", "machine"), ("--holds", "kinematics")):
        plan = document("plan", session, *words)
        result = document("solve", session, *words)
        key = f"{plan['frame'].replace('-', '_')}_mm"
        assert plan["bound_mm"] == pytest.approx(result["correction"]["bound"][key])
        bounds[words] = plan["bound_mm"]
    assert len(set(bounds.values())) == 3


@LONG
def test_a_proposed_measurement_is_a_procedure(samples: Path, tmp_path: Path) -> None:
    best = document("plan", samples / "simulated_zero-max-min.jsonl")["next"]
    path = tmp_path / "next.toml"
    path.write_text(best["protocol"], encoding="utf-8")
    assert glidecal("run", "--dry-run", "--protocol", path, "-o", tmp_path / "s.jsonl").status == 0


@LONG
def test_bars_with_a_zero_each_are_planned_measured_and_planned_again(tmp_path: Path) -> None:
    """A linear delta, which stands above the Zero of a bar and hardly below it."""
    machine, path, session = load_machine("linear-delta"), tmp_path / "p.toml", tmp_path / "s.jsonl"
    blank = document("plan", "--machine", "linear-delta", "--noise", "0.002")
    best, further = blank["next"], blank["further"]
    assert [f["bound_mm"] for f in further] == sorted(f["bound_mm"] for f in further)[::-1]
    for leg in best["legs"]:
        for level in best["displacements_mm"]:
            assert machine.geometry().goes("xyz".index(leg), level)
    path.write_text(best["protocol"], encoding="utf-8")
    made = ("--machine", "linear-delta", "--protocol", path, "--seed", "4", "--scatter", "0.002")
    assert glidecal("simulate", *made, "-o", session).status == 0
    assert document("plan", session)["next"]["bound_mm"] < document("plan", session)["bound_mm"]
    glidecal(
        "simulate", "--machine", "linear-delta", "--protocol", "bars", "-o", tmp_path / "b.jsonl"
    )
    assert document("plan", tmp_path / "b.jsonl")["bound_mm"] < 0.01


@LONG
@pytest.mark.parametrize("machine", ["orthoglide", "linear-delta"])
def test_with_nothing_measured_the_promise_is_the_mean_of_what_is_kept(
    machine: str, tmp_path: Path
) -> None:
    """Six simulated machines measured as proposed: the median of their bounds is at most twice, at
    least a third of what was promised.

    A promise without effects, which single readings cannot exclude, was ten times too good.
    """
    path, bounds = tmp_path / "p.toml", []
    best = document("plan", "--machine", machine, "--noise", "0.002")["next"]
    path.write_text(best["protocol"], encoding="utf-8")
    for seed in range(6):
        session = tmp_path / f"{seed}.jsonl"
        made = ("--machine", machine, "--protocol", path, "--seed", str(seed), "-o", session)
        assert glidecal("simulate", *made).status == 0
        bounds.append(document("solve", session)["correction"]["bound"]["touched_off_mm"])
    assert 1 / 3 < np.median(bounds) / best["bound_mm"] < 2.0


def test_a_displacement_on_a_limit_is_reached_from_one_side_only() -> None:
    pool = leg_pool(Geometry())
    assert set(pool.approach.tolist()) == {1, -1}
    assert set(leg_pool(Geometry(), both_ways=False).approach.tolist()) == {1}
    assert set(pool.approach[pool.displacement_mm == 60.0].tolist()) == {1}
    assert set(pool.approach[pool.displacement_mm == -100.0].tolist()) == {-1}
    assert set(pool.approach[pool.displacement_mm == 0.0].tolist()) == {1, -1}


@pytest.mark.parametrize("seed", range(20))
def test_the_way_reaches_every_posture_from_its_side(seed: int) -> None:
    generator = np.random.default_rng(seed)
    geometry = Geometry()
    inner = levels_mm(geometry)[1:-1]
    visits = [
        (float(generator.choice(inner)), int(generator.choice([-1, 1])))
        for _ in range(int(generator.integers(1, 9)))
    ]
    walked = [0.0, *visiting_order(visits, (-100.0, 60.0))]
    moves = [
        (level, 1 if level > before else -1)
        for before, level in pairwise(walked)
        if level != before
    ]
    for visit in set(visits):
        assert moves.count(visit) >= visits.count(visit)


def test_workspace_in_words_and_as_a_document() -> None:
    text = " ".join(glidecal("workspace", "orthoglide").out.split())
    assert "0.66 … 2.21" in text
    assert "More than 99.9% of the workspace keeps" in text, "not all of it"
    assert "all that joint limits allow (carriages -100 … 60 mm from Zero)" in text
    assert "factors within 1/2 … 2: 139.0 mm" in text
    assert "at Zero 1.000, 1.000, 1.000" in text
    report = json.loads(glidecal("workspace", "linear-delta", "--limit", "1.6", "--json").out)
    assert report["stated"]
    assert (report["low_mm"], report["high_mm"]) == ([-60.0, -60.0, 0.0], [60.0, 60.0, 200.0])
    assert report["within_limit"] == 0.0  # upwards 0.577 at Zero, and never more: beyond 1/1.6
    assert report["largest_cube"] is None
    assert [len(factor_map["factor"]) for factor_map in report["maps"]] == [7, 7, 7]


AT = ("--at", "70", "40", "0")


def test_one_place_of_the_tool() -> None:
    report = json.loads(glidecal("workspace", "orthoglide", *AT, "--json").out)
    assert not report["stands"]
    assert report["working_modes"][0]["signs"] == [1, 1, 1]
    text = " ".join(glidecal("workspace", "orthoglide", *AT).out.split())
    assert "joint limits do NOT allow it" in text
    assert "glidecal.posture/1" in json.dumps(report)


def test_what_has_no_workspace_says_so(tmp_path: Path) -> None:
    assert "found 'hexaslide'. Allowed: linear-delta, orthoglide" in refused(
        2, "workspace", "hexaslide"
    )
    assert "tool at (900.000, 0.000, 0.000) mm" in refused(
        5, "workspace", "orthoglide", "--at", "900", "0", "0"
    )
    for wrong in (("--limit", "nan"), ("--limit", "0.5"), ("--at", "nan", "0", "0")):
        assert glidecal("workspace", "orthoglide", *wrong).status == 2
    path = tmp_path / "m.toml"
    path.write_text(
        'schema = "glidecal.machine/1"\nworkspace_mm = [[-50, -50, -50], [70, 50, 50]]\n',
        encoding="utf-8",
    )
    assert "carriage x at +61.835 mm from Zero" in refused(3, "workspace", path)


def test_what_to_expect_of_every_parameter_is_the_papers_covariance(tmp_path: Path) -> None:
    """[C] (12)-(14) with G written out, weighted by it: Zero, Max and Min read once, σ 0.01 mm."""
    once = MAX_MIN.replace('["max", "min"]', '["zero", "max", "min"]')
    path = tmp_path / "once.toml"
    path.write_text(once, encoding="utf-8")
    run = glidecal(
        "identifiability", "orthoglide", "--procedure", path, "--noise", "0.01", "--json"
    )
    report = json.loads(run.out)
    angles = [np.arcsin(60.0 / 310.25), np.arcsin(-100.0 / 310.25)]
    rows = []
    for i, j in ((0, 1), (1, 2), (0, 2)):
        for angle in angles:
            a, w = np.sin(angle), 0.5 + np.sin(angle)
            b, c = w * np.tan(angle), w / np.cos(angle) - 0.5
            for first, second in ((i, j), (j, i)):
                row = np.zeros(6)
                row[first], row[second] = a, b
                row[3 + first], row[3 + second] = -c, -b
                rows.append(row)
    matrix = np.array(rows)
    g = np.array([[2, 0, 1, 0], [0, 2, 0, 1], [1, 0, 2, 0], [0, 1, 0, 2]])
    weight = np.linalg.inv(1e-4 * np.kron(np.eye(3), g))
    for key, columns in (("all_mm", range(6)), ("alone_mm", range(3))):
        part = matrix[:, list(columns)]
        expected = 1.96 * np.sqrt(np.linalg.inv(part.T @ weight @ part).diagonal())
        values = [entry[key] for entry in report["expected"]][: len(expected)]
        assert values == pytest.approx(expected.tolist(), rel=1e-3)
    assert report["expected"][0]["all_mm"] / 1.96 == pytest.approx(0.726, abs=0.001)
    assert report["expected_tool_bound_mm"] > 0.0
    delta = json.loads(glidecal("identifiability", "linear-delta", "--json").out)
    assert delta["expected"][0]["all_mm"] is None  # a plate does not tell the sum of offsets


@LONG
def test_minutes_are_those_of_a_machine_that_moves_itself(tmp_path: Path) -> None:
    """At 50 mm/s a step of zero-max-min takes 1.97 s of way and 1 s of rest, by hand 20 s."""
    path = tmp_path / "moving.toml"
    path.write_text('schema = "glidecal.machine/1"\n[motion]\nfeed_mm_min = 3000.0\n')
    step_s = (3 * (10.0 + 3 * 320.0) + 2 * 10.0) / 50.0 / 30.0 + 1.0
    for words, expected_s in (((), 20.0), (("--machine", path), step_s)):
        best = document("plan", *words)["next"]
        steps = len(best["displacements_mm"])
        if best["cycles"] > 1:
            steps = best["cycles"] * (steps + 1) + 1
        set_up = len(best["legs"]) * (2.0 + steps * expected_s / 60.0)
        assert best["minutes"] == pytest.approx(set_up, abs=1e-9)


@LONG
@pytest.mark.parametrize("name", [*machine_files(), "hexaslide"])
def test_a_machine_file_to_begin_with_is_one_that_the_program_takes(
    tmp_path: Path, name: str
) -> None:
    copy = tmp_path / "mine.toml"
    assert glidecal("machine", name, "-o", str(copy)).status == 0
    assert copy.read_text(encoding="utf-8") == glidecal("machine", name).out
    hexaslide = "chain" in tomllib.loads(copy.read_text(encoding="utf-8"))
    if hexaslide:
        options = ("--procedure", "pose-inverse", "--postures", "16")
        assert glidecal("identifiability", str(copy), *options).status == 0
    else:
        assert glidecal("workspace", str(copy)).status == 0


def test_without_a_name_it_is_the_usual_machine(tmp_path: Path) -> None:
    assert tomllib.loads(glidecal("machine").out)["name"] == "orthoglide"
    assert "Allowed: gough-stewart" in refused(2, "machine", "delta")
    copy = tmp_path / "mine.toml"
    copy.write_text("mine", encoding="utf-8")
    assert "there already" in refused(2, "machine", "-o", str(copy))
    assert copy.read_text(encoding="utf-8") == "mine"
    assert glidecal("machine", "-o", str(copy), "--force").status == 0
