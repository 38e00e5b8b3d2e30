"""``glidecal diagnose`` and ``model`` as processes: documents, adopting, refusals."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from tests.app.cli import glidecal, refused

PROMISED = {
    "schema",
    "sessions",
    "held_out",
    "noise",
    "verdict",
    "gap_before",
    "gap_after",
    "held_out_gap",
    "where",
    "effects",
    "candidates",
    "next_measurement",
    "smallest_detectable",
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
    found: dict[str, Any] = json.loads(run.out)
    return found


EFFECT = ("--effect", "backlash:x", "--size", "0.03")


def test_find_adopt_and_see_the_gap_gone(tmp_path: Path) -> None:
    session = simulated(tmp_path, "s", *EFFECT)
    other = simulated(tmp_path, "other", *EFFECT, seed=2)
    adopted = tmp_path / "model.json"
    found = diagnosed(session, "--held-out", other, "--adopt", adopted)
    assert set(found) >= PROMISED
    assert found["schema"] == "glidecal.diagnosis/1"
    assert found["verdict"] == "explained"
    (effect,) = found["effects"]
    assert (effect["id"], effect["where"], effect["kind"]) == ("backlash", "x", "machine")
    assert found["gap_after"]["rms_mm"] < 0.5 * found["gap_before"]["rms_mm"]
    held = found["held_out_gap"]
    assert held["after_rms_mm"] < 0.5 * held["before_rms_mm"]
    assert len(found["candidates"]) <= 20
    again = diagnosed(session, "--model", adopted)
    assert again["verdict"] == "agrees"
    assert again["gap_before"]["rms_mm"] == pytest.approx(found["gap_after"]["rms_mm"], rel=0.05)
    shown = glidecal("model", adopted)
    assert "backlash (x)" in shown.out
    assert "found in s.jsonl, verdict explained" in " ".join(shown.out.split())
    assert "no reason" in refused(2, "model", adopted, "--remove", "backlash")
    removed = glidecal("model", adopted, "--remove", "backlash:x", "--why", "screw replaced")
    assert "No effects." in removed.out
    assert "removed backlash (x): screw replaced" in removed.out
    assert diagnosed(session, "--model", adopted)["verdict"] == "explained"


def test_the_first_line_is_the_verdict(tmp_path: Path) -> None:
    run = glidecal("diagnose", simulated(tmp_path, "s", *EFFECT))
    assert run.out.splitlines()[0].startswith("EXPLAINED. What was missing is:")
    quiet = glidecal("diagnose", simulated(tmp_path, "q"))
    assert quiet.out.splitlines()[0].startswith("AGREES.")


def test_a_session_on_both_sides_is_refused(tmp_path: Path, samples: Path) -> None:
    session = samples / "simulated_sweep.jsonl"
    assert "also diagnosed" in refused(2, "diagnose", session, "--held-out", session)
    copy = tmp_path / "copy.jsonl"
    copy.write_bytes(session.read_bytes())
    assert "also diagnosed" in refused(2, "diagnose", session, "--held-out", copy)


def test_nothing_to_adopt_and_unknown_candidates(tmp_path: Path, samples: Path) -> None:
    session = samples / "simulated_sweep.jsonl"
    target = tmp_path / "m.json"
    assert "names no effect" in refused(2, "diagnose", session, "--adopt", target)
    asked = ("--adopt", target, "--candidate", "nonsense")
    assert "nonsense" in refused(2, "diagnose", session, *asked)
    assert not target.exists()
    run = glidecal("diagnose", session, "--adopt", target, "--candidate", "backlash:y")
    assert run.status == 0
    assert "backlash" in target.read_text(encoding="utf-8")


def test_published_experiments_claim_no_single_name(samples: Path) -> None:
    found = diagnosed(
        samples / "experiment_2_twelve.jsonl",
        "--held-out",
        samples / "experiment_3_twelve.jsonl",
    )
    assert found["verdict"] == "cannot-tell"
    assert found["effects"] == []
    assert found["gap_before"]["degrees_of_freedom"] == 6
    held = [c["held_out_gap_rms_mm"] for c in found["candidates"]]
    assert any(value is not None for value in held)


def test_several_sessions_keep_their_own_offsets(samples: Path) -> None:
    found = diagnosed(samples / "experiment_2_twelve.jsonl", samples / "experiment_3_twelve.jsonl")
    assert found["gap_before"]["degrees_of_freedom"] == 12


def test_one_leg_and_one_posture(tmp_path: Path, samples: Path) -> None:
    with (samples / "tables" / "experiment_2_twelve.csv").open(encoding="utf-8") as table:
        rows = list(csv.DictReader(table))
    for name, kept in (
        ("leg", [r for r in rows if r["leg"] == "x"]),
        ("posture", [r for r in rows if float(r["displacement_mm"]) == 0.0]),
    ):
        path = tmp_path / f"{name}.csv"
        with path.open("w", encoding="utf-8", newline="") as out:
            writer = csv.DictWriter(out, rows[0].keys())
            writer.writeheader()
            writer.writerows(kept)
        session = tmp_path / f"{name}.jsonl"
        figures = ("--resolution", "0.01", "--repeatability", "0.02")
        assert glidecal("import", path, "-o", session, *figures).status == 0
        assert diagnosed(session)["verdict"] == "cannot-tell"


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
