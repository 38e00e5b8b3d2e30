"""The bench judges rightly: a perfect answer, a liar and a silent one; files that can go on."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from protocols.record import read_record
from tests.blind.baselines import Problem as Baseline
from tests.blind.baselines import best_r2, lars_path, lasso_bic, named_by_all, stepwise_bic, stlsq
from tests.blind.bench_files import Folder, append, lines, seal, sealed_truths, write_session
from tests.blind.cases import Case, plan
from tests.blind.documents import row_of
from tests.blind.effects import EFFECT_IDS, candidates
from tests.blind.forward import FloatArray
from tests.blind.generator import Made, make
from tests.blind.noise import NOISES
from tests.blind.parameters import covered
from tests.blind.scoring import (
    Rate,
    Scored,
    at_best,
    blunder_named,
    called_explained,
    coverage,
    detectable,
    detection_ncp,
    exact,
    false_machine_name,
    false_name,
    placed_in_set,
    places,
    same_place,
    single_name,
    truth_in_set,
    wrong_confident,
    wrong_name_or_place,
)
from tests.blind.signatures import Columns, contained, named_by_a_judge, parts
from tests.blind.steps import PLANS, rows_of
from tests.blind.table import EARLIER, Told, page

Json = dict[str, Any]
SEED = 3


def single(effect: str, procedure: str = "sweep", noise: str = "gaussian") -> Case:
    return Case(f"test/{effect}/{procedure}", "single", procedure, noise, (effect,), (2.0,))


def document(verdict: str, *effects: Json) -> Json:
    return {
        "schema": "glidecal.diagnosis/2",
        "verdict": verdict,
        "noise": {"degrees_of_freedom": 60},
        "effects": list(effects),
        "candidates": [],
        "names": [],
        "held_out_gap": {"how": "", "before_rms_mm": 0.01, "after_rms_mm": 0.002},
    }


def effect(name: str, where: str, kind: str = "machine", *also: str) -> Json:
    partners = [{"id": rival, "where": where} for rival in also]
    return {
        "id": name,
        "kind": kind,
        "where": where,
        "parameters": [],
        "indistinguishable_from": partners,
    }


def scored(session: Made, answer: Json) -> Scored:
    row = row_of(lambda *_: answer, Path("unused"), ())
    return Scored(session.truth, {"session": "s", **row})


def test_an_ideal_judge_is_as_good_as_the_nearest_rival_allows() -> None:
    """Of two that are D apart and equally likely the right one wins with Φ(√D / 2)."""
    session = make(single("actuator_scale"), SEED)
    columns = Columns(session.rows, session.hidden)
    scale = next(c for c in candidates() if (c.id, c.where) == ("actuator_scale", "y"))
    sag = next(c for c in candidates() if (c.id, c.where) == ("gravity_sag", "y"))
    unit = columns.span(scale)[:, 0]
    for size in (5.0, 40.0, 160.0):
        apart = size**2 * (1.0 - contained(unit, columns.span(sag)))
        share = named_by_a_judge(columns, size * unit, "actuator_scale", [scale, sag], 1.0)
        assert share == pytest.approx(norm.cdf(np.sqrt(apart) / 2.0), abs=0.1)
    (hidden,) = session.truth["hidden"]
    assert at_best(Scored(session.truth, {})) == hidden["named_by_a_judge"] > 0.3


@pytest.mark.parametrize("name", EFFECT_IDS)
def test_every_effect_has_the_strength_asked_for(name: str) -> None:
    hidden = make(single(name), SEED).truth["hidden"][0]
    noise = make(single(name), SEED).truth["noise_rms_mm"]
    assert hidden["rms_mm"] / noise == pytest.approx(2.0, rel=0.02)
    assert hidden["ncp"] == pytest.approx(4 * 138, rel=0.05)
    assert 0 <= hidden["rival_share"] <= 1


@pytest.mark.parametrize("noise", NOISES)
def test_noise_has_the_size_it_says(noise: str) -> None:
    """Repeats of a clean session scatter as told; a kind that repeats share scatters less."""
    case = Case(f"size/{noise}", "none", "two-station", noise)
    session = make(case, SEED)
    assert session.truth["hidden"] == []
    problem = Baseline(session.rows, session.values_mm)
    estimate = float(np.sqrt(np.sum(problem.residual**2) / (len(session.rows) - problem.fixed)))
    assert estimate / session.truth["noise_rms_mm"] == pytest.approx(1.0, abs=0.35)
    assert session.resolution_mm == (0.001 if noise == "quantised" else None)


def test_sessions_are_the_same_for_the_same_seed_and_tell_nothing(tmp_path: Path) -> None:
    case = single("straightness")
    session, again, different = make(case, SEED), make(case, SEED), make(case, SEED + 1)
    assert session.table == again.table
    assert session.truth == again.truth
    assert session.table != different.table
    write_session(session, tmp_path / f"{case.session}.jsonl")
    assert [p.name for p in tmp_path.iterdir()] == [f"{case.session}.jsonl"]
    text = (tmp_path / f"{case.session}.jsonl").read_text(encoding="utf-8")
    for word in ("straightness", "single", "gaussian", "truth", "seed", case.key):
        assert word not in text
    record = read_record(tmp_path / f"{case.session}.jsonl")
    assert sum(event.event == "reading" for event in record.events) == 138


def test_the_plan_is_large_enough_and_its_names_are_its_own() -> None:
    cases = plan()
    assert len(cases) >= 5000
    assert sum(case.cell == "none" for case in cases) >= 1000
    assert len({case.session for case in cases}) == len(cases)
    assert {case.cell for case in plan(0.0)} == {case.cell for case in cases}


@pytest.mark.parametrize("blunder", ["gauge_sign", "gauge_swap", "unit_mixup", "stand_slip"])
def test_blunders_are_judged_by_name_and_place(blunder: str) -> None:
    session = make(Case(f"b/{blunder}", "blunder", "sweep", "gaussian", blunder=blunder), SEED)
    place = session.truth["blunder_where"][0]
    wrong = "y" if place == "x" else "x" if len(place) == 1 else place[::-1]
    assert blunder_named(scored(session, document("explained", effect(blunder, place, "blunder"))))
    assert not blunder_named(
        scored(session, document("explained", effect(blunder, wrong, "blunder")))
    )
    assert not blunder_named(scored(session, document("agrees")))


@pytest.mark.parametrize("number", range(4))
def test_a_label_error_is_one_row_under_another_leg_or_posture(number: int) -> None:
    case = Case(f"b/label/{number}", "blunder", "sweep", "gaussian", blunder="label_error")
    table_rows, driven = make(case, SEED).rows, rows_of(PLANS["sweep"], np.random.default_rng(0))
    legs = np.flatnonzero(table_rows.leg != driven.leg)
    postures = np.flatnonzero(table_rows.displacement_mm != driven.displacement_mm)
    assert len(legs) + len(postures) == 1
    assert table_rows.axis.tolist() == driven.axis.tolist()


def test_a_wild_reading_may_have_any_name_of_a_mistake() -> None:
    case = Case("b/wild", "blunder", "sweep", "gaussian", blunder="wild")
    session = make(case, SEED)
    place = session.truth["blunder_where"][0]
    answer = document("explained", effect("label_error", place, "blunder"))
    assert blunder_named(scored(session, answer))
    assert not wrong_confident(scored(session, answer))
    assert wrong_confident(scored(session, document("explained", effect("backlash", "x"))))


def test_an_alias_beside_a_mistake_names_it() -> None:
    """A first reading that is wrong is a first take that stands apart: nothing tells them apart."""
    session = make(Case("b/alias", "blunder", "sweep", "gaussian", blunder="label_error"), SEED)
    place = session.truth["blunder_where"][0]
    first = effect("first_take", place, "blunder", "label_error")
    assert blunder_named(scored(session, document("ambiguous", first)))
    assert not blunder_named(
        scored(session, document("ambiguous", effect("first_take", place, "blunder")))
    )


def test_right_wrong_and_silent_answers() -> None:
    session = make(single("actuator_scale"), SEED)
    where = session.truth["hidden"][0]["where"][0]
    right = scored(session, document("explained", effect("actuator_scale", where)))
    wrong = scored(session, document("explained", effect("leg_bow", where)))
    open_one = scored(
        session, document("ambiguous", effect("leg_bow", where, "machine", "actuator_scale"))
    )
    silent = scored(session, document("agrees"))
    assert [single_name(o) for o in (right, wrong, open_one, silent)] == [True] + [False] * 3
    assert [truth_in_set(o) for o in (right, wrong, open_one, silent)] == [True, False, True, False]
    assert [wrong_confident(o) for o in (right, wrong, open_one, silent)] == [False, True] + 2 * [
        False
    ]
    assert detectable(right)
    assert exact(right)


def test_a_wander_called_a_drift_is_no_lie_but_any_other_name_is() -> None:
    answer = document("explained", effect("thermal_drift", "all", "environment"))
    for noise, false in (("wander", False), ("gaussian", True)):
        session = make(Case(f"none/{noise}", "none", "sweep", noise), SEED)
        assert false_name(scored(session, answer)) is false
        assert false_name(scored(session, document("explained", effect("backlash", "x"))))


def test_an_unnamed_law_is_no_name_for_an_unknown_shape() -> None:
    case = Case("o/cubic", "outside", "sweep", "gaussian", (), (4.0,), shape="cubic")
    session = make(case, SEED)
    assert session.truth["hidden"][0]["id"] == "cubic"
    empirical = effect("law", "x", "empirical")
    assert not called_explained(scored(session, document("explained", empirical)))
    assert called_explained(scored(session, document("explained", effect("leg_bow", "x"))))


@pytest.mark.parametrize(
    ("place", "right"), [("xy", True), ("xy@0.35", True), ("yx", False), ("leg x", False)]
)
def test_places(place: str, right: bool) -> None:
    assert same_place(place, ["xy"]) is right


@pytest.mark.parametrize(
    ("unit", "value", "inside"),
    [("mm/m", 2.0, True), ("µm/m", 2000.0, True), ("%", 0.2, True), ("%", 0.3, False)],
)
def test_parameters_are_compared_whatever_their_unit(unit: str, value: float, inside: bool) -> None:
    parameter = {"name": "scale", "value": value, "unit": unit, "standard_uncertainty": value / 20}
    truth = {"parameters": [{"entry": "scale", "index": [0], "value": 0.0019}]}
    assert covered({"parameters": [parameter]}, truth, 60.0) == [inside]


def test_parameters_that_do_not_correspond_are_not_judged() -> None:
    parameter = {"name": "scale", "value": 1.0, "unit": "K", "standard_uncertainty": 1.0}
    truth = {"parameters": [{"entry": "scale", "index": [0], "value": 0.0019}]}
    assert covered({"parameters": [parameter]}, truth, None) == []


def test_bounds_of_clopper_and_pearson() -> None:
    assert Rate(5, 1000).bounds == pytest.approx((0.00163, 0.01163), abs=2e-5)
    assert Rate(0, 100).bounds == pytest.approx((0.0, 0.03622), abs=1e-5)
    assert Rate(100, 100).bounds == pytest.approx((0.96378, 1.0), abs=1e-5)


def test_detection_strength_grows_with_the_number_of_parameters() -> None:
    # One parameter: normal quantiles of 1e-4 two-sided and of nine in ten.
    assert detection_ncp(1) == pytest.approx((3.8906 + 1.2816) ** 2, abs=0.15)
    assert detection_ncp(6) > detection_ncp(2) > detection_ncp(1)


def test_files_go_on_after_a_kill_and_are_sealed(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    for name in ("b", "a", "left"):
        append(folder.truths, {"session": name, "truth": {"name": name}})
    with folder.truths.open("a", encoding="utf-8") as file:
        file.write('{"session": "torn", "tru')
    assert [line["session"] for line in lines(folder.truths)] == ["b", "a", "left"]
    truths, digest = seal(folder, ["a", "b"])
    assert sealed_truths(folder) == (truths, digest)
    assert list(json.loads(folder.sealed.read_text(encoding="utf-8"))) == ["a", "b"]


def answers(perfect: bool) -> Told:
    """A small run in which every answer is right, or every answer is a lie."""
    truths, rows = {}, []
    for case in (single("backlash"), single("gravity_sag"), Case("n", "none", "sweep", "gaussian")):
        session = make(case, SEED)
        truths[case.session] = session.truth
        right = [effect(h["id"], h["where"][0]) for h in session.truth["hidden"]]
        effects = right if perfect else [effect("leg_bow", "x")]
        verdict = "explained" if effects else "agrees"
        row = row_of(lambda *_, s=effects, v=verdict: document(v, *s), Path("unused"), ())
        rows.append({"session": case.session, **row})
    return Told(truths, rows, [], SEED, "0" * 64, 1.0)


def test_the_page_tells_a_perfect_diagnosis_from_a_liar() -> None:
    good, bad = page(answers(True)), page(answers(False))
    for text, share in ((good, " 0.0 ("), (bad, " 100.0 (")):
        line = next(
            line_text for line_text in text.splitlines() if line_text.startswith("| false name, no")
        )
        assert share in line.split("|")[3]
    assert "| wrong confident name | ≤ 1 | 0.0 (0.0–70.8), 0/3 |" in good
    assert "**no**" in bad
    assert all(f"\n| {what} |" in good for what in EARLIER)


def test_a_right_name_at_a_wrong_place_counts() -> None:
    session = make(single("backlash"), SEED)
    right = session.truth["hidden"][0]["where"][0]
    wrong = next(leg for leg in "xyz" if leg != right)
    for where, is_wrong in ((right, False), (wrong, True), ("x,y,z", False)):
        score = scored(session, document("explained", effect("backlash", where)))
        assert wrong_name_or_place(score) is is_wrong
        assert placed_in_set(score) is not is_wrong
        assert not wrong_confident(score)
    rival = {
        **effect("leg_bow", "xy"),
        "indistinguishable_from": [{"id": "backlash", "where": wrong}],
    }
    score = scored(session, document("ambiguous", rival))
    assert truth_in_set(score)
    assert not placed_in_set(score)


def test_a_second_value_too_small_to_show_makes_no_wrong_place() -> None:
    session = make(single("leg_taper"), SEED)
    hidden = {**session.truth["hidden"][0], "where": ["x"], "where_alike": ["xy"]}
    score = scored(session, document("explained", effect("leg_taper", "xy")))
    assert not wrong_name_or_place(Scored({**session.truth, "hidden": [hidden]}, score.row))
    hidden = {**hidden, "where_alike": []}
    assert wrong_name_or_place(Scored({**session.truth, "hidden": [hidden]}, score.row))


def test_bars_that_are_off_may_be_called_so() -> None:
    session = make(Case("bars", "bars", "sweep", "gaussian", bars=3.0), SEED)
    assert np.abs(session.truth["lengths_mm"]) == pytest.approx([0.3] * 3)
    for name, kind, false in (
        ("leg_length", "machine", False),
        ("backlash", "machine", True),
        ("gauge_gain", "indicator", False),
    ):
        score = scored(session, document("explained", effect(name, "x", kind)))
        assert false_machine_name(score) is false


def test_a_diagnosis_that_breaks_is_a_row_and_no_name() -> None:
    def broken(session: Path, without: tuple[str, ...], also: tuple[str, ...] = ()) -> Json:
        raise TypeError("no such thing")

    sample = make(Case("broken", "none", "sweep", "gaussian"), SEED)
    row = row_of(broken, Path("unused"), ())
    assert row["verdict"] == "error"
    assert row["error"] == "TypeError: no such thing"
    assert not false_name(Scored(sample.truth, row))


def test_coverage_counts_parameters_of_right_names_only() -> None:
    session = make(single("backlash"), SEED)
    hidden = session.truth["hidden"][0]
    amount = hidden["parameters"][0]["value"]
    named = effect("backlash", hidden["where"][0])
    named["parameters"] = [
        {"name": "play", "value": 1e3 * amount, "unit": "µm", "standard_uncertainty": 0.1}
    ]
    good = scored(session, document("explained", named))
    assert coverage([good]) == Rate(1, 1)
    assert coverage([scored(session, document("explained", {**named, "id": "leg_bow"}))]) == Rate(
        0, 0
    )


@pytest.fixture(scope="module")
def large_backlash() -> Made:
    case = Case("large", "single", "sweep", "gaussian", ("backlash",), (4.0,))
    return make(case, SEED)


@pytest.mark.parametrize("method", [best_r2, stepwise_bic, stlsq, lasso_bic])
def test_baselines_see_a_large_backlash(
    method: Callable[[Baseline], set[str]], large_backlash: Made
) -> None:
    problem = Baseline(large_backlash.rows, large_backlash.values_mm)
    assert "backlash" in method(problem)
    assert problem.noise_mm < 5 * large_backlash.truth["noise_rms_mm"]


def test_baselines_name_known_ids_only(large_backlash: Made) -> None:
    named = named_by_all(large_backlash.rows, large_backlash.values_mm)
    assert {name for names in named.values() for name in names} <= set(EFFECT_IDS)


def test_knots_of_the_lasso_path_meet_its_conditions() -> None:
    """At each knot active columns pull alike, with the sign of their weight, others no more."""
    rng = np.random.default_rng(4)
    columns: FloatArray = rng.normal(size=(40, 8)) + rng.normal(size=(40, 1))
    columns /= np.linalg.norm(columns, axis=0)
    values = columns[:, 2] * 3 - columns[:, 5] * 2 + 0.1 * rng.normal(size=40)
    path = lars_path(columns, values)
    assert len(path) >= 8
    for weights in path[1:]:
        pull = columns.T @ (values - columns @ weights)
        active = np.flatnonzero(weights)
        level = np.abs(pull).max()
        assert pull[active] == pytest.approx(level * np.sign(weights[active]), abs=1e-8)
    plain = np.linalg.lstsq(columns, values, rcond=None)[0]
    assert path[-1] == pytest.approx(plain, abs=1e-6)


def test_places_of_values_of_their_own() -> None:
    """Three rates of drift are "all" to the bench; the contract's "all" is one value."""

    def hidden(*amounts: float) -> Json:
        rates = [{"entry": "drift", "index": [k], "value": a} for k, a in enumerate(amounts)]
        return {"where": ["all"], "parameters": rates}

    assert places(hidden(1.0, 2.0, -3.0)) == ["all", "x,y,z"]
    assert places(hidden(1.0, 1.0, 1.0)) == ["all"]
    assert places({**hidden(1.0, 2.0, 3.0), "where": ["x"]}) == ["x"]


def test_a_place_within_its_place_is_another_one() -> None:
    leg = next(c for c in candidates() if (c.id, c.where) == ("leg_taper", "y"))
    mount = next(c for c in candidates() if (c.id, c.where) == ("gauge_gain", "yx"))
    assert [part.directions for part in parts(leg)] == [
        (direction,) for direction in leg.directions
    ]
    assert parts(mount) == []
