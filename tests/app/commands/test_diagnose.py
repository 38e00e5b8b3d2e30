"""``glidecal diagnose`` and ``model`` as processes: documents, adopting, refusals."""

from __future__ import annotations

import csv
import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.report.text.tables import uncertain
from tests.app.cli import glidecal, refused
from tests.conftest import LONG

PROMISED = {
    "schema",
    "sessions",
    "held_out",
    "noise",
    "verdict",
    "missing",
    "something_else",
    "gap_before",
    "gap_after",
    "held_out_gap",
    "where",
    "effects",
    "candidates",
    "next_measurement",
    "smallest_detectable",
    "tool",
}


def simulated(folder: Path, name: str, *options: str, seed: int = 1) -> Path:
    path = folder / f"{name}.jsonl"
    protocol = ("--protocol", "two-station", "--seed", str(seed), "-o", path)
    run = glidecal("simulate", *protocol, *options)
    assert run.status == 0, run.err
    return path


def diagnosed(*arguments: str | Path) -> dict[str, Any]:
    run = glidecal("diagnose", *arguments, "--json")
    assert run.status == 0, run.err
    diagnosis: dict[str, Any] = json.loads(run.out)
    return diagnosis


EFFECT = ("--effect", "backlash:x", "--size", "0.03")


def test_find_adopt_and_see_the_gap_gone(tmp_path: Path) -> None:
    session = simulated(tmp_path, "s", *EFFECT)
    second = simulated(tmp_path, "other", *EFFECT, seed=2)
    adopted = tmp_path / "model.json"
    diagnosis = diagnosed(session, "--held-out", second, "--adopt", adopted)
    assert set(diagnosis) >= PROMISED
    assert diagnosis["schema"] == "glidecal.diagnosis/2"
    assert diagnosis["verdict"] == "explained"
    (effect,) = diagnosis["effects"]
    assert (effect["id"], effect["where"], effect["kind"]) == ("backlash", "x", "machine")
    assert diagnosis["gap_after"]["rms_mm"] < 0.5 * diagnosis["gap_before"]["rms_mm"]
    gap = diagnosis["held_out_gap"]
    assert gap["after_rms_mm"] < 0.5 * gap["before_rms_mm"]
    assert len(diagnosis["candidates"]) <= 20
    assert diagnosis["tool_adopted"]["frame"] == diagnosis["tool"]["frame"]
    assert "tool_adopted" not in diagnosed(session)
    again = diagnosed(session, "--model", adopted)
    assert again["verdict"] == "agrees"
    assert again["gap_before"]["rms_mm"] == pytest.approx(
        diagnosis["gap_after"]["rms_mm"], rel=0.05
    )
    run = glidecal("model", adopted)
    assert "backlash (x)" in run.out
    assert "found in s.jsonl, verdict explained" in " ".join(run.out.split())
    assert "no reason" in refused(2, "model", adopted, "--remove", "backlash")
    assert "--why: found no effect to remove" in refused(2, "model", adopted, "--why", "a screw")
    removed = glidecal("model", adopted, "--remove", "backlash:x", "--why", "screw replaced")
    assert "No effects." in removed.out
    assert "removed backlash (x): screw replaced" in removed.out
    assert diagnosed(session, "--model", adopted)["verdict"] == "explained"


def test_one_name_alone_leaves_the_same_gap_wherever_it_stands(tmp_path: Path) -> None:
    """Before: its row among the candidates was of another fit, 0.0009 beside 0.0008 mm."""
    diagnosis = diagnosed(simulated(tmp_path, "s", *EFFECT))
    (effect,), first = diagnosis["effects"], diagnosis["candidates"][0]
    assert (first["id"], first["where"]) == (effect["id"], effect["where"])
    assert first["gap_rms_after_mm"] == effect["gap_rms_after_mm"]


@LONG
def test_adopting_says_what_the_name_changes_at_the_tool(samples: Path, tmp_path: Path) -> None:
    """The figures of the sentence are those of the document; all models are those without it."""
    session = samples / "simulated_zero-max-min.jsonl"
    likely = diagnosed(session)["candidates"][0]
    name = f"{likely['id']}:{likely['where']}"
    arguments = (session, "--candidate", name, "--adopt")
    diagnosis = diagnosed(*arguments, tmp_path / "json.json")
    adopted_mm, all_mm = (
        diagnosis[key]["entered_mm"]["offsets"] for key in ("tool_adopted", "tool")
    )
    assert adopted_mm != pytest.approx(all_mm, rel=0.01)
    run = glidecal("diagnose", *arguments, tmp_path / "text.json")
    assert run.status == 0, run.err
    assert (
        f"Given {likely['id']} ({likely['where']}): tool over the workspace, r.m.s. (95 %), "
        f"for a touched-off workpiece, at most {uncertain(adopted_mm)} mm with joint offsets "
        f"entered (over all models {uncertain(all_mm)} mm)"
    ) in " ".join(run.out.split())


def test_the_first_line_is_the_verdict(tmp_path: Path) -> None:
    run = glidecal("diagnose", simulated(tmp_path, "s", *EFFECT))
    assert run.out.splitlines()[0].startswith("EXPLAINED. What was missing is:")
    quiet = glidecal("diagnose", simulated(tmp_path, "q"))
    assert quiet.out.splitlines()[0].startswith("AGREES.")


@LONG
def test_no_size_that_no_machine_has_would_have_been_found(tmp_path: Path) -> None:
    """At a leg of a delta the bar hardly moves across the indicator: nothing shows its tilt."""
    session = tmp_path / "bars.jsonl"
    words = ("--machine", "linear-delta", "--protocol", "bars", "-o", session)
    assert glidecal("simulate", *words).status == 0
    sizes = {effect["id"]: effect["size"] for effect in diagnosed(session)["smallest_detectable"]}
    assert "gauge_tilt" not in sizes
    assert sizes["axis_lean"] == pytest.approx(1.0)  # mrad: two tolerances of the machine file
    text = glidecal("diagnose", session).out
    assert re.search(r"gauge_tilt +not shown", text)


@LONG
def test_the_bound_at_the_tool_and_what_lowers_it(tmp_path: Path, samples: Path) -> None:
    """`plan` proposes the same set-ups from the readings; each lowers the bound by a tenth."""
    session = samples / "experiment_1_six.jsonl"
    run = glidecal("diagnose", session, "--next", tmp_path / "next.toml", "--json")
    assert run.status == 0, run.err
    diagnosis = json.loads(run.out)
    planned = json.loads(glidecal("plan", session, "--json").out)
    assert [set_up["legs"] for set_up in diagnosis["further"]] == [
        set_up["legs"] for set_up in planned["further"]
    ]
    bounds = [set_up["bound_mm"] for set_up in planned["further"]]
    assert [set_up["bound_mm"] for set_up in diagnosis["further"]] == pytest.approx(
        bounds, rel=1e-6
    )
    after = [planned["bound_mm"], *bounds]
    assert len(bounds) > 1
    assert diagnosis["noise"]["standard_deviation_mm"] == pytest.approx(
        planned["noise_mm"], rel=1e-6
    )
    assert all(b < 0.9 * a for a, b in pairwise(after))
    tool = diagnosis["tool"]
    assert tool["frame"] == planned["frame"]
    assert tool["entered_mm"][planned["holds"]] == pytest.approx(planned["bound_mm"], rel=1e-6)
    assert tool["entered_mm"]["offsets"] < tool["now_mm"]
    assert "further" not in diagnosed(session)
    text = " ".join(glidecal("diagnose", session).out.split())
    assert re.search(
        r"Tool over the workspace, r\.m\.s\. \(95 %\), for a touched-off workpiece: at most "
        r"[\d.]+ mm now\. With joint offsets entered: [\d.]+ mm\.",
        text,
    )


@LONG
def test_what_the_fit_has_already_is_no_contradiction_to_its_gap(tmp_path: Path) -> None:
    """Before: named at a gap that "would happen by chance in most sessions", without a word."""
    session = tmp_path / "s.jsonl"
    words = ("--machine", "linear-delta", "--protocol", "bars", "--effect", "actuator_scale:y")
    assert glidecal("simulate", *words, "--seed", "3", "-o", session).status == 0
    text = " ".join(glidecal("diagnose", session).out.split())
    assert text.startswith("EXPLAINED. What was missing is: a carriage travels too far")
    assert "happen by chance in most sessions. The fit has such parameters of the machine" in text


def test_a_session_on_both_sides_is_refused(tmp_path: Path, samples: Path) -> None:
    session = samples / "simulated_sweep.jsonl"
    assert "also diagnosed" in refused(2, "diagnose", session, "--held-out", session)
    copy = tmp_path / "copy.jsonl"
    copy.write_bytes(session.read_bytes())
    assert "also diagnosed" in refused(2, "diagnose", session, "--held-out", copy)


def test_options_that_do_nothing_here_are_refused(samples: Path) -> None:
    session = samples / "simulated_sweep.jsonl"
    assert "--adopt" in refused(2, "diagnose", session, "--candidate", "backlash")
    message = refused(2, "diagnose", session, "--procedure", "sweep", "--machine", "linear-delta")
    assert "--procedure and --machine: found no --aliases" in message
    assert "no session" in refused(2, "diagnose", session, "--aliases")


def test_nothing_to_adopt_and_unknown_candidates(tmp_path: Path, samples: Path) -> None:
    session = samples / "simulated_sweep.jsonl"
    target = tmp_path / "m.json"
    assert "names no effect" in refused(2, "diagnose", session, "--adopt", target)
    arguments = ("--adopt", target, "--candidate", "nonsense")
    assert "nonsense" in refused(2, "diagnose", session, *arguments)
    assert not target.exists()
    candidate = diagnosed(session)["candidates"][-1]
    candidate_name = f"{candidate['id']}:{candidate['where']}"
    run = glidecal("diagnose", session, "--adopt", target, "--candidate", candidate_name)
    assert run.status == 0
    assert candidate["id"] in target.read_text(encoding="utf-8")


@LONG
def test_published_experiments_claim_no_single_name(samples: Path) -> None:
    diagnosis = diagnosed(
        samples / "experiment_2_twelve.jsonl",
        "--held-out",
        samples / "experiment_3_twelve.jsonl",
    )
    assert diagnosis["verdict"] == "unexplained"
    assert diagnosis["effects"] == []
    assert diagnosis["gap_before"]["degrees_of_freedom"] == 9
    gaps = [c["held_out_gap_rms_mm"] for c in diagnosis["candidates"]]
    assert any(value is not None for value in gaps)


@LONG
def test_what_table_1_leaves_in_experiment_2_it_leaves_in_3(samples: Path) -> None:
    """Whatever its name is: bars of their tolerance cannot do it, and it is there again."""
    diagnosis = diagnosed(
        samples / "experiment_2_six.jsonl", "--held-out", samples / "experiment_3_six.jsonl"
    )
    assert diagnosis["verdict"] == "cannot-tell"
    assert diagnosis["gap_before"]["degrees_of_freedom"] == 3
    gap = diagnosis["held_out_gap"]
    assert gap["before_rms_mm"] > 0.09
    assert gap["after_rms_mm"] < 0.02


@LONG
def test_three_sessions_leave_one_pattern(samples: Path) -> None:
    """As docs/published.md says: share 0.987, by chance once in 2000 times or rarer."""
    diagnosis = diagnosed(*(samples / f"experiment_{k}_six.jsonl" for k in (1, 2, 3)))
    assert diagnosis["gap_before"]["degrees_of_freedom"] == 9
    assert diagnosis["pattern"]["common_share"] == pytest.approx(0.987, abs=5e-4)
    assert diagnosis["pattern"]["reproducible"] is True


@LONG
def test_several_sessions_keep_their_own_offsets(samples: Path) -> None:
    diagnosis = diagnosed(
        samples / "experiment_2_twelve.jsonl", samples / "experiment_3_twelve.jsonl"
    )
    assert diagnosis["gap_before"]["degrees_of_freedom"] == 18


def part_of_experiment_2(folder: Path, samples: Path, column: str, value: str) -> Path:
    """One leg or one posture of it."""
    with (samples / "tables" / "experiment_2_twelve.csv").open(encoding="utf-8") as table:
        rows = list(csv.DictReader(table))
    path = folder / f"{column}.csv"
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, rows[0].keys())
        writer.writeheader()
        writer.writerows(row for row in rows if row[column] == value)
    session = path.with_suffix(".jsonl")
    figures = ("--resolution", "0.01", "--repeatability", "0.02")
    assert glidecal("import", path, "-o", session, *figures).status == 0
    return session


def test_one_leg_is_too_little(tmp_path: Path, samples: Path) -> None:
    diagnosis = diagnosed(part_of_experiment_2(tmp_path, samples, "leg", "x"))
    assert diagnosis["verdict"] == "cannot-tell"


def test_one_posture_is_refused(tmp_path: Path, samples: Path) -> None:
    session = part_of_experiment_2(tmp_path, samples, "displacement_mm", "0")
    message = refused(5, "diagnose", session)
    assert "no two postures of one mounting" in message
    assert "Move the machine and measure again" in message


@LONG
def test_many_readings_of_one_posture_are_refused(tmp_path: Path) -> None:
    """Their number teaches nothing of the machine: every exchange of labels is the same table."""
    table, session = tmp_path / "still.csv", tmp_path / "still.jsonl"
    scatter_mm = np.random.default_rng(3).normal(0.0, 0.002, 20_000)
    rows = [f"x,y,0,{0.17 + off_mm:.4f},{k + 1}" for k, off_mm in enumerate(scatter_mm)]
    table.write_text("leg,axis,displacement_mm,value_mm,cycle\n" + "\n".join(rows) + "\n")
    assert glidecal("import", table, "-o", session).status == 0
    assert "no two postures of one mounting" in refused(5, "diagnose", session)


@LONG
def test_an_indicator_that_reads_one_value_is_asked_about(tmp_path: Path, samples: Path) -> None:
    """Its readings fit a bar that leans and bows; no other set-up of that session is named."""
    with (samples / "tables" / "experiment_2_twelve.csv").open(encoding="utf-8") as table:
        rows = list(csv.DictReader(table))
    for row in rows:
        if (row["leg"], row["axis"]) == ("x", "y"):
            row["value_mm"] = "0.5"
    path, session = tmp_path / "still.csv", tmp_path / "still.jsonl"
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    assert glidecal("import", path, "-o", session).status == 0
    remarks = [r for r in diagnosed(session)["remarks"] if "plunger" in r]
    assert len(remarks) == 1
    assert remarks[0].startswith("all readings of xy are the same")
    text = " ".join(glidecal("solve", session).out.split())
    assert "STILL: all 3 readings of leg X along Y" in text
    assert text.count("STILL") == 1


@LONG
def test_without_any_noise_no_chance_is_told(tmp_path: Path, samples: Path) -> None:
    """One reading a posture, nothing stated: the weight that the fit needs is no noise.

    What the tool keeps then is judged by true machines in
    tests/calib/posterior/test_unknown_noise.py.
    """
    table = tmp_path / "bare.csv"
    with (samples / "tables" / "experiment_2_twelve.csv").open(encoding="utf-8") as lines:
        table.write_text("".join(line.rsplit(",", 1)[0] + "\n" for line in lines), encoding="utf-8")
    session = table.with_suffix(".jsonl")
    assert glidecal("import", table, "-o", session).status == 0
    diagnosis = diagnosed(session)
    assert diagnosis["verdict"] == "cannot-tell"
    assert diagnosis["noise"]["standard_deviation_mm"] is None
    assert diagnosis["effects"] == []
    text = " ".join(glidecal("diagnose", session).out.split())
    assert "a stated noise it may be chance" in text
    assert "by chance in" not in text


def nameless(folder: Path) -> tuple[Path, Path]:
    """A session of a machine with a law that no name of the catalogue has, and its model."""
    model = folder / "truth.json"
    cube = {"travel_cube_at_100mm": {"value": 1500.0, "unit": "µm"}}
    entry = {"id": "empirical", "where": "x", "parameters": cube}
    off = {"d_rho_x": 1.2, "d_rho_y": -0.9, "d_rho_z": 0.6, "d_L_x": 0.03}
    model.write_text(json.dumps({"parameters_mm": off, "effects": [entry]}), encoding="utf-8")
    return simulated(folder, "cube", "--model", str(model), seed=3), model


@LONG
def test_what_has_no_name_is_adopted_as_a_law(tmp_path: Path) -> None:
    session, truth = nameless(tmp_path)
    second = simulated(tmp_path, "other", "--model", str(truth), seed=4)
    target = tmp_path / "law.json"
    arguments = ("--held-out", second, "--adopt", target, "--candidate", "empirical")
    diagnosis = diagnosed(session, *arguments)
    effect = diagnosis["left_over"]
    assert (effect["id"], effect["kind"], effect["where"]) == ("empirical", "empirical", "x")
    assert effect["gap_rms_after_mm"] < 0.5 * effect["gap_rms_before_mm"]
    assert effect["held_out_gap"]["after_rms_mm"] < effect["held_out_gap"]["before_rms_mm"]
    assert "empirical" not in {
        candidate["id"] for candidate in (*diagnosis["effects"], *diagnosis["candidates"])
    }
    (entry,) = json.loads(target.read_text(encoding="utf-8"))["effects"]
    assert entry["id"] == "empirical"
    value = entry["parameters"]["travel_cube_at_100mm"]
    assert value["value"] == pytest.approx(1500.0, abs=5.0 * value["standard_uncertainty"])
    assert entry["provenance"]["sessions"] == ["cube.jsonl"]
    again = diagnosed(session, "--model", target)
    assert again["verdict"] == "agrees"
    assert again["left_over"] is None
    third = simulated(tmp_path, "again", "--model", str(target), seed=8)
    assert diagnosed(third, "--model", target)["verdict"] == "agrees"
    run = glidecal("model", target)
    words = " ".join(run.out.split())
    assert "added empirical (x): an unnamed effect: a carriage is off" in words
    removed = glidecal("model", target, "--remove", "empirical", "--why", "a screw was changed")
    assert "No effects." in removed.out


@LONG
def test_beside_names_the_law_is_asked_for(tmp_path: Path) -> None:
    session, _ = nameless(tmp_path)
    target = tmp_path / "named.json"
    run = glidecal("diagnose", session, "--adopt", target)
    text = " ".join(run.out.split())
    assert "a carriage is off along its way with the cube of travel" in text
    ids = [effect["id"] for effect in json.loads(target.read_text(encoding="utf-8"))["effects"]]
    if run.out.startswith("PARTLY-EXPLAINED"):
        assert "empirical" not in ids
        assert "there is an unnamed effect too: --candidate empirical" in run.err
    else:
        assert run.out.startswith("UNEXPLAINED")
        assert ids == ["empirical"]


@LONG
def test_sessions_with_another_load_on_the_tool(tmp_path: Path) -> None:
    """A sag doubles with the load: a session with twice the load counts four times."""
    off = {"d_rho_x": 1.2, "d_rho_y": -0.9, "d_rho_z": 0.6, "d_L_x": 0.03}
    sag = {"shortening": {"value": 0.4, "unit": "mm"}}
    truth = {
        "parameters_mm": off,
        "effects": [{"id": "gravity_sag", "where": "all", "parameters": sag}],
    }
    sessions = []
    for load in (1.0, 2.0):
        model = tmp_path / f"load_{load:g}.json"
        model.write_text(json.dumps(truth | {"machine": {"load": load}}), encoding="utf-8")
        sessions.append(simulated(tmp_path, model.stem, "--model", str(model), seed=int(load)))
    alone, together = diagnosed(sessions[0]), diagnosed(*sessions)
    for diagnosis in (alone, together):
        assert [(effect["id"], effect["where"]) for effect in diagnosis["effects"]] == [
            ("gravity_sag", "all")
        ]
        assert diagnosis["verdict"] == "explained"
    (little,), (value,) = alone["effects"][0]["parameters"], together["effects"][0]["parameters"]
    assert value["value"] == pytest.approx(0.4, abs=4.0 * value["standard_uncertainty"])
    assert value["standard_uncertainty"] < 0.6 * little["standard_uncertainty"]


def test_where_nothing_is_open_no_measurement_is_proposed(tmp_path: Path, samples: Path) -> None:
    session, target = samples / "simulated_sweep.jsonl", tmp_path / "next.toml"
    assert diagnosed(session)["next_measurement"] is None
    message = refused(2, "diagnose", session, "--next", target)
    assert "no two effects that a measurement would decide between" in message
    assert "glidecal plan SESSION" in message
    assert not target.exists()


@LONG
def test_a_best_guess_is_not_called_named(samples: Path) -> None:
    run = glidecal("diagnose", samples / "experiment_3_six.jsonl")
    assert run.out.startswith("CANNOT-TELL.")
    assert "With the best guess: 0.0021 mm" in run.out
    assert "named" not in run.out
    assert "best guess" in run.out.split("Candidates, the likeliest first")[1]


def test_what_would_have_been_found_in_two_figures(samples: Path) -> None:
    run = glidecal("diagnose", samples / "simulated_sweep.jsonl")
    table = run.out.split("would have been found")[1]
    sizes = dict(re.findall(r"^ (\w+) +([\d.]+) ", table, flags=re.MULTILINE))
    assert {"thermal_drift", "backlash", "gauge_gain"} <= set(sizes)
    for size in sizes.values():
        digits = size.replace(".", "").strip("0")
        assert 1 <= len(digits) <= 2
    assert re.search(r"thermal_drift +\d+ +µm/h", table)


@LONG
def test_aliases_and_next_measurement(tmp_path: Path) -> None:
    aliases = json.loads(glidecal("diagnose", "--aliases", "--procedure", "sweep", "--json").out)
    assert aliases["schema"] == "glidecal.aliases/1"
    assert aliases["imitations"]
    session = simulated(tmp_path, "s", "--effect", "actuator_scale:x", "--size", "0.5")
    procedure = tmp_path / "next.toml"
    run = glidecal("diagnose", session, "--next", procedure, "--json")
    assert run.status == 0, run.err
    assert json.loads(run.out)["verdict"] == "ambiguous"
    dry = glidecal("run", "--dry-run", "--protocol", procedure)
    assert dry.status == 0, dry.err
    assert "no session" in refused(2, "diagnose")
