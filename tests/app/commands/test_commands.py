"""The verbs: results on standard output, errors as one paragraph, documented exit codes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from app.cli import cli
from protocols.journal import write_whole
from protocols.record import read_record
from protocols.session import Noted, Opened, Reading
from tests.app.cli import as_process, glidecal, refused, run_here
from tests.conftest import LONG

EXPERIMENT_2 = "experiment_2_twelve.jsonl"


def solve(*arguments: str | Path) -> dict[str, Any]:
    run = glidecal("solve", *arguments, "--json")
    assert run.status == 0, run.err
    document: dict[str, Any] = json.loads(run.out)
    return document


@LONG
def test_solve_gives_the_published_table(samples: Path) -> None:
    solution = solve(samples / EXPERIMENT_2, "--subset", "joint-offsets", "--method", "linear")
    values = [p["value"] for p in solution["parameters"].values()]
    assert values == pytest.approx([-0.4856, 0.4990, -1.6712], abs=0.0005)
    assert solution["rms_after_mm"] == pytest.approx(0.1379, abs=0.0005)
    assert solution["recommended_subset"] == "joint-offsets"


@pytest.mark.parametrize(
    ("verb", "name", "status"),
    [("solve", EXPERIMENT_2, 0), ("validate", "none.jsonl", 3), ("no-verb", "", 2)],
)
def test_a_process_of_its_own_says_the_same(
    verb: str, name: str, status: int, samples: Path
) -> None:
    """Nearly all tests run the program in their own process."""
    alone = as_process(verb, samples / name)
    text = alone.err.replace("python -m app", "glidecal")
    assert replace(alone, err=text) == glidecal(verb, samples / name)
    assert alone.status == status


def test_solution_document_has_everything_promised(samples: Path) -> None:
    solution = solve(samples / EXPERIMENT_2, "--subset", "both", "--method", "linear")
    assert solution["schema"] == "glidecal.solution/1"
    assert solution["sessions"] == [EXPERIMENT_2]
    assert list(solution["parameters"]) == solution["covariance"]["names"]
    first = solution["parameters"]["d_rho_x"]
    assert first["expanded_uncertainty"] == pytest.approx(
        first["standard_uncertainty"] * first["coverage_factor"]
    )
    assert first["unit"] == "mm"
    assert first["standard_uncertainty"] ** 2 == pytest.approx(
        solution["covariance"]["matrix"][0][0]
    )
    assert len(solution["differences"]) == 12
    for difference in solution["differences"].values():
        assert difference["residual"] == pytest.approx(
            difference["value"] - difference["predicted"]
        )
    noise = solution["noise"]
    assert noise["standard_deviation_mm"] == pytest.approx((0.02**2 + 0.01**2 / 12) ** 0.5)
    assert (noise["degrees_of_freedom"], noise["source"]) == (None, "instrument")
    assert noise["pooled"] is True
    assert solution["suspect_readings"] == []
    correction = solution["correction"]
    assert (correction["frame"], correction["holds"]) == ("touched-off", "offsets")
    for frame in ("touched_off_mm", "aligned_mm", "machine_mm"):
        assert correction["bound"][frame] < correction["bound_now"][frame]
    assert [alternative["holds"] for alternative in correction["others"]] == [
        "play",
        "tables",
        "kinematics",
    ]
    assert solution["enlarged_by_lack_of_fit"] > 10.0
    assert solution["lack_of_fit"]["p_value"] < 1e-6
    assert solution["condition_number"] == pytest.approx(61.9, abs=0.05)
    assert solution["weak_directions"][0]["combination"] == "d_rho_x + d_L_x"
    assert solution["reasons"] == []
    assert solution["degrees_of_freedom"] == 6


def test_without_a_subset_joint_offsets_are_the_view(samples: Path) -> None:
    solution = solve(samples / EXPERIMENT_2)
    assert solution["subset"] == solution["recommended_subset"] == "joint-offsets"


def test_six_differences_do_not_give_both(samples: Path) -> None:
    path = samples / "experiment_1_six.jsonl"
    message = refused(5, "solve", path, "--subset", "both")
    assert "3 of 6 combinations not identifiable" in message
    solution = solve(path)
    assert solution["subset"] == "joint-offsets"
    assert [reason.split(":")[0] for reason in solution["reasons"]] == ["both left out"]


def test_import_keeps_everything_and_solves_the_same(samples: Path, tmp_path: Path) -> None:
    table = samples / "tables" / "experiment_2_twelve.csv"
    session = tmp_path / "s.jsonl"
    stated = ["--resolution", "0.01", "--repeatability", "0.02"]
    run = glidecal("import", table, "-o", session, *stated)
    assert (run.status, run.out) == (0, "")
    solution, sample = solve(session), solve(samples / EXPERIMENT_2)
    assert solution["parameters"] == sample["parameters"]
    replayed = json.loads(glidecal("replay", session, "--headless", "--json").out)
    assert len(replayed["readings"]) == 18
    assert replayed["readings"][1]["text"] == "0.08"
    assert glidecal("validate", session).status == 0


@LONG
def test_the_day_of_a_table_is_stated_or_not_made_up(samples: Path, tmp_path: Path) -> None:
    """A certificate once had the day of the import as that of the measurement."""
    table, with_day, silent = (
        samples / "tables" / "experiment_2_twelve.csv",
        tmp_path / "s.jsonl",
        tmp_path / "silent.jsonl",
    )
    assert glidecal("import", table, "--measured-on", "2008-05-12", "-o", with_day).status == 0
    assert glidecal("import", table, "-o", silent).status == 0
    assert "imported" in glidecal("solve", silent).out
    assert "measured on 2008-05-12" in glidecal("solve", with_day).out
    files = {session: session.with_suffix(".csv") for session in (with_day, silent)}
    for session, csv in files.items():
        assert glidecal("export", session, "--format", "csv", "-o", csv).status == 0
    assert "measured 2008-05-12, imported 20" in files[with_day].read_text()
    assert "measured not stated, imported 20" in files[silent].read_text()
    page = tmp_path / "p.html"
    assert glidecal("report", silent, "-o", page).status == 0
    assert "not stated, imported 20" in page.read_text()
    arguments = ("import", table, "--measured-on", "2999-01-01", "-o", tmp_path / "later.jsonl")
    assert "2999-01-01. Allowed: a day of the past" in refused(2, *arguments)
    first = ("--measured-on", "0001-01-01", "-o", tmp_path / "first.jsonl")
    assert glidecal("import", table, *first).status == 0  # a day that no time zone has


def test_a_history_is_shown_in_one_way(tmp_path: Path) -> None:
    """Before: a page was written, and --json ignored in silence."""
    page = tmp_path / "h.html"
    message = refused(2, "history", tmp_path, "-o", page, "--json")
    assert "--output and --json: found more than one. Allowed: one of them" in message
    assert not page.exists()


def test_a_history_is_written_as_a_page_alone(tmp_path: Path) -> None:
    """Before: HTML went into a file for text."""
    message = refused(2, "history", tmp_path, "-o", tmp_path / "h.txt")
    assert "h.txt. Allowed: a path that ends with .html" in message
    assert not (tmp_path / "h.txt").exists()
    assert "no session file" in refused(3, "history", tmp_path, "-o", "-")


def test_weights_of_the_linear_method_are_refused_with_the_exact_one(samples: Path) -> None:
    """Before: they were ignored in silence."""
    session = samples / "experiment_2_twelve.jsonl"
    weights = ("--weights", "covariance")
    message = refused(2, "solve", session, *weights)
    assert "covariance with --method exact. Allowed: --method linear" in message
    assert glidecal("solve", session, *weights, "--method", "linear").status == 0


def test_import_of_one_posture_is_kept_but_cannot_be_solved(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text("leg,axis,displacement_mm,value_mm,colour\nx,y,0,0.1,red\nx,y,0,0.2,blue\n")
    run = glidecal("import", table, "-o", tmp_path / "s.jsonl")
    assert run.status == 0
    assert "columns kept but not used: colour" in run.err
    assert "only one posture" in run.err
    assert "single posture" in refused(5, "solve", tmp_path / "s.jsonl")


def test_bad_table_leaves_no_session(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text("leg,axis,displacement_mm,value_mm\nx,y,0,nan\n")
    message = refused(3, "import", table, "-o", tmp_path / "s.jsonl")
    assert "line 2, column value_mm: found 'nan'" in message
    assert not (tmp_path / "s.jsonl").exists()


def test_simulate_is_reproducible_and_does_not_tell_the_truth(tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    model.write_text('{"parameters_mm": {"d_rho_x": 1.234567}}')
    readings = []
    for name in ("a.jsonl", "b.jsonl"):
        run = glidecal(
            *("simulate", "--protocol", "sweep", "--model", model, "--seed", "4"),
            *("-o", tmp_path / name),
        )
        assert run.status == 0
        document = json.loads(glidecal("replay", tmp_path / name, "--json").out)
        readings.append(document["readings"])
    assert readings[0] == readings[1]
    assert "1.234567" not in (tmp_path / "a.jsonl").read_text()
    assert solve(tmp_path / "a.jsonl")["parameters"]["d_rho_x"]["value"] == pytest.approx(
        1.2346, abs=0.01
    )


def test_noise_free_simulation_comes_back(tmp_path: Path) -> None:
    """Issue figure: offsets and lengths off by up to 3 mm come back to 1e-6 mm."""
    truth = {"d_rho_x": 2.9, "d_rho_y": -3.0, "d_rho_z": 1.1}
    truth |= {"d_L_x": -2.2, "d_L_y": 0.4, "d_L_z": 3.0}
    model = tmp_path / "model.json"
    model.write_text(json.dumps({"parameters_mm": truth}))
    session = tmp_path / "s.jsonl"
    quiet = ["--scatter", "0", "--resolution", "0"]
    assert glidecal("simulate", "--model", model, *quiet, "-o", session).status == 0
    parameters = solve(session, "--subset", "both")["parameters"]
    assert {k: v["value"] for k, v in parameters.items()} == pytest.approx(truth, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("damaged.jsonl", "line 9: found a content that does not fit"),
        ("none.jsonl", "No such file"),
    ],
)
def test_validate_names_the_first_broken_line(samples: Path, name: str, message: str) -> None:
    assert message in refused(3, "validate", samples / name)
    assert message in refused(3, "solve", samples / name)


def test_validate_all_samples(samples: Path) -> None:
    good = sorted(p for p in samples.glob("*.jsonl") if p.name != "damaged.jsonl")
    run = glidecal("validate", *good)
    assert run.status == 0
    assert run.out.count("unbroken and closed") == len(good) == 14


def test_a_cut_session_is_used_with_a_warning(samples: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.jsonl"
    content = (samples / "simulated_zero-max-min.jsonl").read_bytes()
    cut.write_bytes(content[: int(len(content) * 0.9)])
    assert "cut inside line" in refused(3, "validate", cut)
    run = glidecal("solve", cut)
    assert run.status == 0
    assert "cut inside line" in run.err


def test_the_same_session_twice(samples: Path, tmp_path: Path) -> None:
    path = samples / EXPERIMENT_2
    copied = shutil.copy(path, tmp_path / "other.jsonl")
    assert "the same session twice" in refused(3, "solve", path, copied)


def test_a_table_that_was_imported_twice(samples: Path, tmp_path: Path) -> None:
    first, again = tmp_path / "first.jsonl", tmp_path / "again.jsonl"
    for session in (first, again):
        glidecal(
            "import",
            samples / "tables" / f"{EXPERIMENT_2.removesuffix('.jsonl')}.csv",
            "-o",
            session,
        )
    assert f"the same readings twice, see {first}" in refused(3, "solve", first, again)


def test_a_session_beside_its_own_table(samples: Path, tmp_path: Path) -> None:
    """Before: its readings counted double."""
    measured = samples / "simulated_zero-max-min.jsonl"
    table, imported = tmp_path / "t.csv", tmp_path / "imported.jsonl"
    export = ("export", measured, "--table", "readings", "--format", "csv", "-o", table)
    assert glidecal(*export).status == 0
    assert glidecal("import", table, "-o", imported).status == 0
    for pair in ((measured, imported), (imported, measured)):
        message = refused(3, "solve", *pair)
        assert f"session {imported}: found the same readings twice, see {measured}" in message


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["run", "--protocol", "zero-mx-min", "--dry-run"], 2, "zero-max-min"),
        (["run", "--simulated", "--port", "a"], 2, "one of them"),
        (["run", "--port", "a", "--port", "a"], 2, "port a twice"),
        (["run", "--indicator", "sylvac:a@x", "--indicator", "sylvac:b@x"], 2, "do not fit leg"),
        (["run"], 2, "--indicator PROFILE:PORT"),
        (["run", "--simulated"], 2, "no terminal"),
        (["run", "--port", "a", "--headless"], 2, "--simulated or --motion"),
        (["run", "--dry-run", "--machine", "none.toml"], 3, "none.toml"),
        ([], 2, "no terminal"),
    ],
)
def test_wrong_use(arguments: list[str], status: int, message: str) -> None:
    assert message in refused(status, *arguments)


@pytest.mark.parametrize("arguments", [["solv"], ["solve"], ["solve", "x", "--subset", "all"]])
def test_wrong_command_line_is_status_2(arguments: list[str]) -> None:
    run = glidecal(*arguments)
    assert run.status == 2
    assert "Traceback" not in run.err


def test_run_headless_and_continue(tmp_path: Path) -> None:
    done = tmp_path / "s.jsonl"
    run = glidecal("run", "--simulated", "--headless", "-o", done, "--seed", "3")
    assert run.status == 0, run.err
    record = json.loads(glidecal("replay", done, "--json").out)
    lines = done.read_bytes().splitlines(keepends=True)
    done.write_bytes(b"".join(lines[:31]) + lines[31][:40])
    run = glidecal("run", "--continue", done, "--headless")
    assert run.status == 0, run.err
    again = json.loads(glidecal("replay", done, "--json").out)
    counting = [r for r in again["readings"] if not r["superseded"]]
    assert [(r["leg"], r["axis"], r["displacement_mm"], r["cycle"]) for r in counting] == [
        (r["leg"], r["axis"], r["displacement_mm"], r["cycle"]) for r in record["readings"]
    ]
    assert glidecal("validate", done).status == 0


def test_an_existing_session_is_not_overwritten(samples: Path, tmp_path: Path) -> None:
    session = shutil.copy(samples / EXPERIMENT_2, tmp_path / "s.jsonl")
    before = Path(session).read_bytes()
    assert "exists already" in refused(3, "simulate", "-o", session)
    assert Path(session).read_bytes() == before


def test_ports_lists_profiles_and_needs_no_port() -> None:
    run = glidecal("ports", "--json")
    document = json.loads(run.out)
    names = [p["name"] for p in document["profiles"]]
    assert {"mitutoyo-01a", "sylvac", "ascii-line"} <= set(names)
    assert all(p["verified"] and p["source"] for p in document["profiles"])
    profiles = glidecal("ports").out.split("Indicator profiles:")[1]
    assert max(map(len, profiles.splitlines())) <= 80


def verbs(command: object, *above: str) -> Iterator[tuple[str, ...]]:
    yield above
    for name, below in getattr(command, "commands", {}).items():
        yield from verbs(below, *above, name)


VERBS = list(verbs(get_command(cli)))


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_help_fits_80_columns_in_whole_sentences(
    verb: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    _, text, _ = run_here(*verb, "--help")
    usage, *lines = text.splitlines()
    assert usage.startswith("Usage: ")
    assert all(len(line) <= 80 for line in lines)
    several = "[SESSIONS]..."  # typer up to 0.25 shows arguments so
    assert not any(line.removesuffix(several).endswith("...") for line in lines)


def test_the_list_of_verbs_has_a_line_for_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    _, text, _ = run_here("--help")
    listed = text.partition("Commands:\n")[2].splitlines()
    assert len(listed) == len({name for name, *_ in VERBS[1:]})
    for name, *deeper in VERBS[1:]:
        (line,) = (line for line in text.splitlines() if line.split()[:1] == [name])
        assert line.endswith((".", "?"))
        assert not deeper or name == "indicator"
    assert "as .html, .pdf or .xml." in text


@pytest.mark.parametrize(
    ("words", "own_option", "other_option"),
    [
        ("postures orthoglide", "--budget", "--few"),
        ("postures hexaslide", "--few", "--budget"),
        ("simulate --machine=hexaslide", "--truth", "--effect"),
        ("simulate --machine linear-delta", "--effect", "--truth"),
        ("run --machine hexaslide", "--behind", "--printable-radius"),
        ("import --machine hexaslide", "--posture-file", "--distances"),
    ],
)
def test_help_beside_a_machine_shows_what_it_takes(
    words: str, own_option: str, other_option: str
) -> None:
    _, text, _ = run_here(*words.split(), "--help")
    assert own_option in text
    assert other_option not in text
    _, text, _ = run_here(words.split()[0], "--help")
    assert own_option in text
    assert other_option in text


MINE = """
schema = "glidecal.machine/1"
[[indicator]]
profile = "mitutoyo-01a"
port = "simulated"
axes = "yx"
serial_number = "4711"
certificate = "K-123"
certificate_date = 2026-01-15
[[indicator]]
profile = "sylvac"
port = "simulated"
axes = "zxy"
"""


def test_who_measured_when_how_warm_and_with_what_stands_with_the_result(tmp_path: Path) -> None:
    machine, session = tmp_path / "m.toml", tmp_path / "s.jsonl"
    machine.write_text(MINE, encoding="utf-8")
    arguments = ("--machine", machine, "--operator", "M. Muster", "--temperature", "21.5")
    assert glidecal("run", "--headless", *arguments, "-o", session).status == 0
    events = read_record(session).events
    assert isinstance(events[0], Opened)
    noted = tmp_path / "noted.jsonl"
    readings = [event for event in events if isinstance(event, Reading)]
    write_whole(noted, events[0], [*readings, Noted(text="window open"), Noted(text="window open")])
    begun = events[0].at
    text = " ".join(glidecal("solve", noted).out.split())
    assert (
        f"noted.jsonl: simulated {begun:%Y-%m-%d %H:%M} UTC by M. Muster at 21.5 °C; "
        "mitutoyo-01a (no. 4711, certificate K-123 of 2026-01-15), sylvac. Remark: window open"
    ) in text
    assert text.count("window open") == 1
    (measurement,) = solve(noted)["measured"]
    assert datetime.fromisoformat(measurement.pop("begun")) == begun
    first, second = measurement.pop("indicators")
    assert (first["profile"], first["serial_number"]) == ("mitutoyo-01a", "4711")
    assert (first["certificate"], first["certificate_date"]) == ("K-123", "2026-01-15")
    assert (second["profile"], second["certificate"]) == ("sylvac", None)
    assert measurement == {
        "origin": "simulated",
        "operator": "M. Muster",
        "temperature_c": 21.5,
        "notes": ["window open", "window open"],
    }


@pytest.mark.parametrize("wrong", ['"yesterday"', "2026", "2026-13-01"])
def test_a_certificate_has_a_date(tmp_path: Path, wrong: str) -> None:
    machine = tmp_path / "m.toml"
    machine.write_text(MINE.replace("2026-01-15", wrong), encoding="utf-8")
    arguments = ("run", "--headless", "--machine", machine, "-o", tmp_path / "s.jsonl")
    message = refused(3, *arguments)
    assert f"machine file {machine}" in message
    assert "certificate_date" in message or "TOML" in message or "line 9" in message


def test_an_option_that_does_not_fit_shows_the_value_and_what_is_allowed() -> None:
    """In the words of files: none of a library for programmers."""
    for option, value, words in (
        ("--seed", "-1", "must be at least 0 (found '-1')"),
        ("--seed", "x", "must be a whole number (found 'x')"),
        ("--temperature", "1000", "must be at most 100 (found '1000')"),
        ("--macro", "foo", "'foo' is not one of 'klipper',"),
    ):
        run = glidecal("run", "--simulated", option, value)
        assert (run.status, f"'{option}': {words}" in run.err) == (2, True), run.err


def test_a_seed_without_simulated_sessions_is_refused(samples: Path) -> None:
    message = refused(2, "solve", samples / "simulated_zero-max-min.jsonl", "--seed", "3")
    assert "--seed: found 3 without --monte-carlo" in message
