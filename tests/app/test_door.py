"""``import glidecal``: eleven names, the verbs on paths and sessions, tables for pandas."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import glidecal
from app.report.schema.document import to_json
from app.report.schema.solution import SolutionReport
from tests.app.cli import glidecal as command
from tests.app.test_house import imported
from tests.conftest import LONG, ROOT, SAMPLES

SESSION = SAMPLES / "experiment_2_six.jsonl"
OTHER = SAMPLES / "experiment_1_six.jsonl"


def test_it_offers_eleven_names_at_most_and_each_is_there() -> None:
    assert len(glidecal.__all__) <= 11
    assert sorted(glidecal.__all__) == dir(glidecal)
    for name in glidecal.__all__:
        assert getattr(glidecal, name).__doc__
    with pytest.raises(AttributeError):
        glidecal.nothing  # type: ignore[attr-defined]  # noqa: B018


def test_importing_it_loads_nothing_heavy() -> None:
    heavy = {"numpy", "scipy", "pydantic", "pandas", "textual", "matplotlib", "typer", "rich"}
    assert not imported("import glidecal") & heavy
    screens = {"textual", "matplotlib", "pandas", "typer"}
    assert not imported(f"import glidecal; glidecal.solve({str(SESSION)!r})") & screens


def test_it_is_typed() -> None:
    assert all((ROOT / room / "py.typed").is_file() for room in glidecal.ROOMS)
    assert (ROOT / "glidecal/py.typed").is_file()


@LONG
def test_solving_a_path_or_a_session_is_what_the_command_says() -> None:
    document = json.loads(command("solve", SESSION, "--json").out)
    for source in (str(SESSION), glidecal.load(SESSION)):
        result = glidecal.solve(source)
        report = json.loads(to_json(SolutionReport.of(result, None, None, None)))
        assert report["parameters"] == document["parameters"]
    frame = result.to_frame()
    values = {name: parameter["value"] for name, parameter in document["parameters"].items()}
    assert dict(zip(frame["parameter"], frame["value"], strict=True)) == values


@LONG
def test_a_set_is_a_view_beside_the_same_correction() -> None:
    view, solution = glidecal.solve(SESSION, subset="leg-lengths"), glidecal.solve(SESSION)
    assert view.solution.subset == "leg-lengths"
    assert solution.solution.subset == solution.choice.usual
    assert (
        not view.corrections.is_worked_out
    )  # the correction takes time only where it is asked for
    assert view.correction.values == solution.correction.values  # whatever set is viewed


def test_tables_of_a_solution_are_its_numbers() -> None:
    result = glidecal.solve(SESSION)
    document = json.loads(command("solve", SESSION, "--json").out)["differences"]
    differences = result.to_frame("differences").set_index("difference")
    assert {name: row["value_mm"] for name, row in differences.iterrows()} == {
        name: entry["value"] for name, entry in document.items()
    }
    parameters = result.to_frame().set_index("parameter")
    text = command("solve", SESSION).out
    (shown,) = re.findall(r"d_rho_x +[-+]\S+ +(\d\S+) +(\d\S+)\n", text)  # ± U, and of noise
    stated = parameters.loc["d_rho_x", ["expanded_with_tolerances", "expanded_uncertainty"]]
    assert tuple(f"{mm:.4f}" for mm in stated) == shown
    assert ">± U (95 %)</th>" in result._repr_html_()
    residuals = result.to_frame("residuals")
    assert residuals["residual_mm"].tolist() == result.solution.residual_mm.tolist()
    assert residuals["value_mm"].tolist() == [visit.value_mm for _, visit in result.visits]


@LONG
def test_a_simulated_session_is_planned_for_and_diagnosed() -> None:
    session = glidecal.simulate("two-station", effect="backlash", size=0.2, seed=3)
    assert len(session.to_frame()) == len(session.readings)
    results = glidecal.diagnose(session)
    assert results.diagnosis.effects[0].id == "backlash"
    frame = results.to_frame()
    assert frame["effect"][0] == "backlash"
    assert frame["standing"][0] == "named"
    sizes = frame[["effect", "where", "parameter"]]
    assert not sizes.duplicated().any()  # what is named was there twice, as a candidate too
    assert "&gt; 0.99" in results._repr_html_()  # as in the text; it was 1.00
    planned = glidecal.plan(session)
    assert planned.to_frame()["bound_mm"].iloc[0] == planned.best.bound_mm


@pytest.mark.filterwarnings("ignore")
def test_a_result_at_a_prompt_is_no_book_of_arrays() -> None:
    """Before: 28 MB of a diagnosis, then every reading of its sessions."""
    session = glidecal.load(SESSION)
    assert repr(session) == f"Session('{SESSION.name}', {len(session.readings)} readings)"
    assert len(repr(glidecal.solve(session))) < 20_000
    diagnosed = glidecal.diagnose(session)
    assert len(repr(diagnosed)) < 60_000
    assert len(repr(diagnosed.tool)) < 4_000


def test_what_is_doubtful_is_a_warning_and_what_is_wrong_an_error(tmp_path: Path) -> None:
    torn = tmp_path / "torn.jsonl"
    torn.write_bytes(SESSION.read_bytes()[:-20])
    with pytest.warns(UserWarning, match=r"torn\.jsonl: cut inside line"):
        glidecal.load(torn)
    with pytest.raises(glidecal.GlidecalError, match="the same session twice"):
        glidecal.solve(SESSION, SESSION)
    with pytest.raises(glidecal.GlidecalError, match=r"nowhere\.jsonl"):
        glidecal.solve(tmp_path / "nowhere.jsonl")


@LONG
def test_sessions_count_once_and_in_the_order_of_measuring(tmp_path: Path) -> None:
    """The joint was moved, and no record says so: values are those of the later session."""
    session, other = glidecal.load(SESSION), glidecal.simulate(seed=2)
    for twice in ((session, session), (SESSION, session), (session, SESSION), (other, other)):
        with pytest.raises(glidecal.GlidecalError, match="the same session twice"):
            glidecal.solve(*twice)
    paths = tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    for path, offset_mm in zip(paths, (0.5, 0.0), strict=True):
        model = tmp_path / "model.json"
        offsets = {"d_rho_x": offset_mm, "d_rho_y": 0.0, "d_rho_z": 0.0}
        model.write_text(
            json.dumps({"schema": "glidecal.model/1", "parameters_mm": offsets}), "utf-8"
        )
        assert command("simulate", "--model", model, "-o", path).status == 0
    later, earlier = map(glidecal.load, reversed(paths))
    for pair in ((earlier, later), (later, earlier), (later, paths[0]), (*reversed(paths),)):
        offset = glidecal.solve(*pair).correction.values["d_rho_x"].value
        assert offset == pytest.approx(0.0, abs=0.05)


def test_a_word_that_is_none_of_the_choices_is_refused() -> None:
    for options in ({"frame": "aligend"}, {"subset": "all"}, {"method": "fast"}):
        with pytest.raises(glidecal.GlidecalError, match="Allowed: "):
            glidecal.solve(SESSION, **options)  # type: ignore[arg-type]
    with pytest.raises(glidecal.GlidecalError, match="parameters, differences, residuals"):
        glidecal.solve(SESSION).to_frame("residual")  # type: ignore[arg-type]
    for options in ({"frame": "aligend"}, {"holds": "all"}):
        with pytest.raises(glidecal.GlidecalError, match="Allowed: "):
            glidecal.plan(SESSION, **options)  # type: ignore[arg-type]
    with pytest.raises(glidecal.GlidecalError, match="at least one session"):
        glidecal.solve()


def test_a_table_is_loaded_as_the_import_does(tmp_path: Path) -> None:
    table = tmp_path / "readings.csv"
    table.write_text("leg,axis,displacement_mm,value_mm,who\nx,y,0,0.1,a\nx,y,60,0.2,a\n", "utf-8")
    with pytest.warns(UserWarning, match="not used: who"):
        session = glidecal.load(table, machine="orthoglide")
    assert session.to_frame()["value_mm"].tolist() == [0.1, 0.2]


def test_without_pandas_a_frame_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(glidecal.GlidecalError, match=r"-m pip install .*pandas>="):
        glidecal.load(SESSION).to_frame()


@LONG
def test_the_report_is_written_from_python(tmp_path: Path) -> None:
    page = glidecal.report(SESSION, output=tmp_path / "page.html")
    assert "Calibration report" in page.read_text("utf-8")
    with pytest.raises(glidecal.GlidecalError, match="there already"):
        glidecal.report(SESSION, output=page)


NAN, INFINITE = float("nan"), float("inf")
SAG = "gravity_sag:z"


@pytest.mark.parametrize("number", [NAN, INFINITE, -INFINITE, "1", None, True, 1e300, 1j])
def test_what_is_no_number_of_the_field_is_refused_by_its_name(number: float) -> None:
    """Before: NaN gave an unreachable posture, an infinite noise a plan, None a TypeError."""
    session = glidecal.load(SESSION)
    wrong: dict[str, Callable[[], object]] = {
        f"size of {SAG}": partial(glidecal.what_if, session, effect=SAG, size=number),
        "--size": partial(glidecal.simulate, effect=SAG, size=number),
        "--scatter": partial(glidecal.simulate, scatter_mm=number),
        "--resolution": partial(glidecal.simulate, resolution_mm=number),
        "--seed": partial(glidecal.simulate, seed=number),  # type: ignore[arg-type]
        "--noise": partial(glidecal.plan, session, noise_mm=number),
        "--tolerance": partial(glidecal.report, SESSION, output="r.html", tolerance_mm=number),
    }
    for thing, call in wrong.items():
        if number is None and thing in ("--size", "--noise", "--tolerance"):
            continue  # nothing is stated
        with pytest.raises(glidecal.GlidecalError) as refusal:
            call()
        assert str(refusal.value).startswith(thing)
        assert f"found {number!r}" in str(refusal.value)


@pytest.mark.parametrize("file", [3, None, b"s.jsonl", [SESSION], "a\0b"])
def test_what_is_no_file_is_refused(file: str) -> None:
    calls = {
        "session": (glidecal.load, glidecal.solve, glidecal.diagnose),
        "output": (lambda name: glidecal.report(SESSION, output=name),),
        "model": (lambda name: glidecal.solve(SESSION, model=name),),
    }
    for thing, doors in calls.items():
        for door in doors if file is not None or thing != "model" else ():
            with pytest.raises(
                glidecal.GlidecalError, match=f"^{thing}|^--{thing}|a name that no file"
            ):
                door(file)


@LONG
def test_a_session_that_is_held_out_may_stand_alone() -> None:
    alone, listed = (
        glidecal.diagnose(SESSION, held_out=held_out) for held_out in (str(OTHER), [OTHER])
    )
    assert alone.held_out == listed.held_out == (OTHER.name,)


def test_numbers_of_numpy_are_numbers() -> None:
    """Before: a step of the display as float32 ended in an error of pydantic."""
    step = np.float32(0.0009765625)  # the same in both widths
    session = glidecal.simulate(
        resolution_mm=step,  # type: ignore[arg-type]
        scatter_mm=np.float64(0.002),
        seed=np.int64(5),  # type: ignore[arg-type]
        effect=SAG,
        size=np.float64(0.02),
    )
    plain = glidecal.simulate(
        resolution_mm=float(step), scatter_mm=0.002, seed=5, effect=SAG, size=0.02
    )
    assert [r.value_mm for r in session.readings] == [r.value_mm for r in plain.readings]
    sizes: list[float] = list(np.array([0.02]))
    (size,) = glidecal.what_if(session, effect=SAG, size=sizes).values
    assert size == 0.02
